"""How fast the simulation is, against bare physics and against SB3's own vectorisation."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from ogmp_sb3.commands.bench.timing import Numbers, PartClock, median, seconds_of
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.simulation import Simulation
from ogmp_sb3.runs.settings import thread_count
from ogmp_sb3.sb3.gym_env import OgmpEnv
from ogmp_sb3.sb3.policy import LstmPolicy
from ogmp_sb3.sb3.vec_env import OgmpVecEnv


def bench_sim(task: TaskConfig, num_envs: int, steps: int, repeats: int) -> Numbers:
    """``OgmpVecEnv.step`` against bare physics, against SB3's own vectorisation, and by size.

    :param num_envs: of the comparison with bare physics
    :param steps: control steps of one repeat; every size takes about as many samples
    """
    recording = record(task, num_envs, steps)
    _, replay = bare_replay(task, recording)
    whole, bare = [], []
    for _ in range(repeats):
        whole.append(_time_recording(task, recording))
        bare.append(seconds_of(lambda: list(replay())))
    numbers = {
        "sim_over_bare_physics": median(bare) / median(whole),
        "steps_per_second": num_envs * steps / median(whole),
        "bare_physics_steps_per_second": num_envs * steps / median(bare),
    }
    numbers |= _shares(task, recording)
    cores = thread_count("auto")
    for name, kind in (("dummy_vec_env", DummyVecEnv), ("subproc_vec_env", SubprocVecEnv)):
        number = 4 * cores
        seconds = _time_stock(kind, task, number, max(steps // 4, 10))
        numbers[f"{name}_steps_per_second"] = number * max(steps // 4, 10) / seconds
    for number in (1, 16, 64, 256, 1024):
        numbers[f"steps_per_second_{number}_envs"] = _throughput(task, number, max(10, num_envs * steps // number), 0)
    for threads in range(1, cores + 1):
        numbers[f"steps_per_second_{threads}_threads"] = _throughput(task, num_envs, steps, threads)
    return numbers


@dataclass(frozen=True)
class Recording:
    """A run of a batch of environments: what went in, and the state at its begin and after every reset."""

    states: np.ndarray
    """simulation states at the begin, shape (num_envs, size)"""
    terrain: np.ndarray
    """at the begin, shape (num_envs, boxes, 5)"""
    actions: np.ndarray
    """shape (steps, num_envs, joints)"""
    resets: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    """after each step: rows, their simulation states, their terrain"""
    laid: list[tuple[np.ndarray, np.ndarray]]
    """after each step: rows whose track went on, their terrain"""

    @property
    def endings(self) -> float:
        """Share of the samples that ended an episode."""
        return sum(len(rows) for rows, _, _ in self.resets) / self.actions[..., 0].size


def untrained_actions(task: TaskConfig, steps: int, num_envs: int) -> np.ndarray:
    """What an untrained policy does: the exploration noise."""
    size = (steps, num_envs, len(task.robot_config.joints))
    return (task.action.noise / task.action.scale * np.random.default_rng(0).standard_normal(size)).astype(np.float32)


def record(task: TaskConfig, num_envs: int, steps: int, policy: LstmPolicy | None = None) -> Recording:
    """Run a policy with its exploration noise, and write down what physics saw.

    :param policy: None: an untrained one
    """
    env = OgmpVecEnv(task, num_envs, seed=0)
    observation: Any = env.reset()
    memory, starts = None, np.ones(num_envs, dtype=bool)
    batch = env.batch
    actions = untrained_actions(task, steps, num_envs)
    recording = Recording(batch.sim.mj.state.copy(), batch.terrain.copy(), actions, [], [])
    before = recording.terrain
    for action in recording.actions:
        if policy is not None:
            action[:], memory = policy.predict(observation, memory, starts)
        observation, _, starts, _ = env.step(action)
        ended = np.flatnonzero(starts)
        recording.resets.append((ended, batch.sim.mj.state[ended].copy(), batch.terrain[ended].copy()))
        moved = np.flatnonzero((batch.terrain != before).any(axis=(1, 2)) & ~starts)
        recording.laid.append((moved, batch.terrain[moved].copy()))
        before = batch.terrain.copy()
    return recording


def _time_recording(task: TaskConfig, recording: Recording) -> float:
    env = OgmpVecEnv(task, recording.actions.shape[1], seed=0)
    env.reset()
    return seconds_of(lambda: [env.step(action) for action in recording.actions])


def bare_replay(
    task: TaskConfig, recording: Recording, threads: int = 0
) -> tuple[Simulation, Callable[[], Iterator[None]]]:
    """The same physics and nothing else.

    :return: a simulation, and what replays the recorded controls, resets and terrain in it, step by step
    """
    every = np.arange(recording.actions.shape[1])
    sim = Simulation(task.robot_config, len(every), task.physics_dt, task.track.boxes, threads)
    nominal = np.array(task.robot_config.nominal_joints)
    targets = nominal + task.action.scale * np.clip(recording.actions, -1.0, 1.0)

    def replay() -> Iterator[None]:
        sim.mj.state[:] = recording.states
        sim.set_terrain(every, recording.terrain)
        for target, (rows, states, boxes), (moved, track) in zip(
            targets, recording.resets, recording.laid, strict=True
        ):
            sim.set_targets(target)
            sim.mj.step(None, task.substeps)
            for changed, ground in ((moved, track), (rows, boxes)):
                if len(changed):
                    sim.set_terrain(changed, ground)
            sim.mj.state[rows] = states
            yield

    return sim, replay


def _shares(task: TaskConfig, recording: Recording) -> Numbers:
    """Shares of the time of a step, by wrapping the parts with a clock."""
    env = OgmpVecEnv(task, recording.actions.shape[1], seed=0)
    env.reset()
    batch, clock = cast(Any, env.batch), PartClock()
    batch.sim.step = clock.timed("physics", batch.sim.step)
    batch.guide.query = clock.timed("oracle", batch.guide.query)
    batch.observer.policy = clock.timed("observation", batch.observer.policy)
    batch.reset = clock.timed("reset", batch.reset)
    for name, term in batch._rewards.items():
        batch._rewards[name] = clock.timed("reward", term)
    total = seconds_of(lambda: [env.step(action) for action in recording.actions])
    return {f"share_{name}": seconds / total for name, seconds in sorted(clock.seconds.items())}


def _throughput(task: TaskConfig, num_envs: int, steps: int, threads: int) -> float:
    env = OgmpVecEnv(task, num_envs, seed=0, threads=threads)
    env.reset()
    actions = untrained_actions(task, steps, num_envs)
    return num_envs * steps / seconds_of(lambda: [env.step(action) for action in actions])


def stock_env(kind: Callable[..., VecEnv], task: TaskConfig, number: int) -> VecEnv:
    """SB3's own vectorisation of single environments."""
    # Imported once, by the server that all workers are forked from: 64 imports of PyTorch take minutes on two cores.
    multiprocessing.set_forkserver_preload(["ogmp_sb3.sb3.vec_env"])
    makers: Any = [partial(OgmpEnv, task) for _ in range(number)]
    return kind(makers)


def _time_stock(kind: Callable[..., VecEnv], task: TaskConfig, number: int, steps: int) -> float:
    actions = untrained_actions(task, steps, number)
    with closing(stock_env(kind, task, number)) as env:
        env.reset()
        return seconds_of(lambda: [env.step(action) for action in actions])
