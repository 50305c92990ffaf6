"""How fast the simulation is, against bare physics and against SB3's own vectorisation."""

from __future__ import annotations

import gc
import multiprocessing
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.simulation import Simulation
from ogmp_sb3.runs.settings import thread_count
from ogmp_sb3.sb3.gym_env import OgmpEnv
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

Numbers = dict[str, float]


def bench_sim(task: TaskConfig, num_envs: int, steps: int, repeats: int) -> Numbers:
    """``OgmpVecEnv.step`` against bare physics, against SB3's own vectorisation, and by size.

    :param num_envs: of the comparison with bare physics
    :param steps: control steps of one repeat; every size takes about as many samples
    """
    recording = record(task, num_envs, steps)
    whole, bare = [], []
    for _ in range(repeats):
        whole.append(_time_recording(task, recording))
        bare.append(seconds_of(bare_replay(task, recording)[1]))
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
    """A run of a batch of environments: what went in, and the state after every reset."""

    actions: np.ndarray
    """shape (steps, num_envs, joints)"""
    resets: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    """after each step: rows, their simulation states, their terrain"""
    laid: list[tuple[np.ndarray, np.ndarray]]
    """after each step: rows whose track went on, their terrain"""


def _actions(task: TaskConfig, steps: int, num_envs: int) -> np.ndarray:
    """What an untrained policy does: the exploration noise."""
    size = (steps, num_envs, len(task.robot_config.joints))
    return (task.action.noise / task.action.scale * np.random.default_rng(0).standard_normal(size)).astype(np.float32)


def record(task: TaskConfig, num_envs: int, steps: int) -> Recording:
    """Run an untrained policy and write down what physics saw."""
    env = OgmpVecEnv(task, num_envs, seed=0)
    env.reset()
    recording = Recording(_actions(task, steps, num_envs), [], [])
    batch = env.batch
    before = batch.terrain.copy()
    for action in recording.actions:
        _, _, dones, _ = env.step(action)
        ended = np.flatnonzero(dones)
        recording.resets.append((ended, batch.sim.mj.state[ended].copy(), batch.terrain[ended].copy()))
        moved = np.flatnonzero((batch.terrain != before).any(axis=(1, 2)) & ~dones)
        recording.laid.append((moved, batch.terrain[moved].copy()))
        before = batch.terrain.copy()
    return recording


def _time_recording(task: TaskConfig, recording: Recording) -> float:
    env = OgmpVecEnv(task, recording.actions.shape[1], seed=0)
    env.reset()
    return seconds_of(lambda: [env.step(action) for action in recording.actions])


def bare_replay(task: TaskConfig, recording: Recording) -> tuple[Simulation, Callable[[], None]]:
    """The same physics and nothing else: a simulation, and what replays the recorded controls, resets and terrain."""
    reference = BatchEnv(task, recording.actions.shape[1], seed=0)
    reference.reset()
    every = np.arange(reference.num_envs)
    sim = Simulation(task.robot_config, len(every), task.physics_dt, task.track.boxes, 0)
    sim.mj.state[:] = reference.sim.mj.state
    sim.set_terrain(every, reference.terrain)
    nominal = np.array(task.robot_config.nominal_joints)
    targets = nominal + task.action.scale * np.clip(recording.actions, -1.0, 1.0)

    def replay() -> None:
        for target, (rows, states, boxes), (moved, track) in zip(
            targets, recording.resets, recording.laid, strict=True
        ):
            sim.set_targets(target)
            sim.mj.step(None, task.substeps)
            for changed, ground in ((moved, track), (rows, boxes)):
                if len(changed):
                    sim.set_terrain(changed, ground)
            sim.mj.state[rows] = states

    return sim, replay


def _shares(task: TaskConfig, recording: Recording) -> Numbers:
    """Shares of the time of a step, by wrapping the parts with a clock."""
    env = OgmpVecEnv(task, recording.actions.shape[1], seed=0)
    env.reset()
    spent: Numbers = {}

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*args: Any, **kwargs: Any) -> Any:
            begin = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                spent[name] = spent.get(name, 0.0) + time.perf_counter() - begin

        return wrapped

    batch: Any = env.batch
    batch.sim.step = timed("physics", batch.sim.step)
    batch.guide.query = timed("oracle", batch.guide.query)
    batch._observe = timed("observation", batch._observe)
    batch.reset = timed("reset", batch.reset)
    for name, term in batch._rewards.items():
        batch._rewards[name] = timed("reward", term)
    total = seconds_of(lambda: [env.step(action) for action in recording.actions])
    return {f"share_{name}": seconds / total for name, seconds in sorted(spent.items())}


def _throughput(task: TaskConfig, num_envs: int, steps: int, threads: int) -> float:
    env = OgmpVecEnv(task, num_envs, seed=0, threads=threads)
    env.reset()
    actions = _actions(task, steps, num_envs)
    return num_envs * steps / seconds_of(lambda: [env.step(action) for action in actions])


def stock_env(kind: Callable[..., VecEnv], task: TaskConfig, number: int) -> VecEnv:
    """SB3's own vectorisation of single environments."""
    # Imported once, by the server that all workers are forked from: 64 imports of PyTorch take minutes on two cores.
    multiprocessing.set_forkserver_preload(["ogmp_sb3.sb3.vec_env"])
    makers: Any = [partial(OgmpEnv, task) for _ in range(number)]
    return kind(makers)


def _time_stock(kind: Callable[..., VecEnv], task: TaskConfig, number: int, steps: int) -> float:
    actions = _actions(task, steps, number)
    with closing(stock_env(kind, task, number)) as env:
        env.reset()
        return seconds_of(lambda: [env.step(action) for action in actions])


def seconds_of(body: Callable[[], Any]) -> float:
    """How long something takes, s."""
    gc.collect()
    begin = time.perf_counter()
    body()
    return time.perf_counter() - begin


def median(values: list[float]) -> float:
    """The middle of several measurements."""
    return float(np.median(values))
