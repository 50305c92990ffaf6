"""How fast a whole training is: against bare physics, against stock, and what its time goes into."""

from __future__ import annotations

import gc
import resource
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from stable_baselines3.common.vec_env import SubprocVecEnv

from ogmp_sb3.commands.bench.learner import learner, stock_learner
from ogmp_sb3.commands.bench.simulation import bare_replay, record, stock_env
from ogmp_sb3.commands.bench.timing import Numbers, PartClock, median, seconds_of
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.runs.settings import thread_count
from ogmp_sb3.sb3.hyperparameters import PPOConfig
from ogmp_sb3.sb3.policy import LstmPolicy
from ogmp_sb3.sb3.threads import torch_threads
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

BARE_DT = 0.002  # s: physics step of the bare physics, whatever the training's own is
PARTS = ("physics", "environment", "inference", "learner")


class Training:
    """A training whose parts have a clock.

    :param task: the task
    :param num_envs: number of environments
    :param recipe: hyper-parameters
    :param policy: whose weights to go on from; None: an untrained one
    :param threads: of physics and of the networks, 0 for one per CPU
    """

    def __init__(
        self, task: TaskConfig, num_envs: int, recipe: PPOConfig, policy: LstmPolicy | None = None, threads: int = 0
    ) -> None:
        self.threads = threads or thread_count("auto")
        env, self.recipe = OgmpVecEnv(task, num_envs, seed=0, threads=threads), recipe_for(policy, recipe)
        self.model, self._clock = learner(env, self.recipe, policy), PartClock()
        self.rollout = self.recipe.n_steps * num_envs
        parts, model = cast(Any, env), cast(Any, self.model)
        parts.batch.sim.step = self._clock.timed("physics", parts.batch.sim.step)
        parts.step_wait = self._clock.timed("step", parts.step_wait)
        model.train = self._clock.timed("learner", model.train)

    def run(self, samples: int) -> Numbers:
        """Train on; how long each of :data:`PARTS` took, s.

        :param samples: whole rollouts
        """
        self._clock.seconds.clear()
        with torch_threads(self.threads):
            total = seconds_of(lambda: self.model.learn(samples, reset_num_timesteps=False))
        spent = self._clock.seconds
        return {
            "physics": spent["physics"],
            "environment": spent["step"] - spent["physics"],
            "inference": total - spent["step"] - spent["learner"],
            "learner": spent["learner"],
        }


def recipe_for(policy: LstmPolicy | None, recipe: PPOConfig) -> PPOConfig:
    """A recipe, its networks as large as those of a policy that it goes on from."""
    if policy is None:
        return recipe
    return replace(
        recipe,
        lstm_hidden_size=policy.lstm_actor.hidden_size,
        n_lstm_layers=policy.lstm_actor.num_layers,
        input_layers=policy.input_layers,
        critic_layers=policy.critic_layers,
    )


def trained_task(task: TaskConfig, policy: LstmPolicy | None) -> TaskConfig:
    """The task that a training goes on with: for a trained policy, at the end of its curriculum."""
    return task if policy is None else replace(task, curriculum=None)


def at_bare_dt(task: TaskConfig) -> TaskConfig:
    """The same task at a physics step of 2 ms, or the nearest that divides its control step."""
    return replace(task, physics_dt=task.control_dt / max(1, round(task.control_dt / BARE_DT)))


def bench_train(
    task: TaskConfig,
    num_envs: int,
    steps: int,
    repeats: int,
    recipe: PPOConfig,
    policy: LstmPolicy | None = None,
    stock: bool = True,
) -> Numbers:
    """Whole training, against bare physics of 2 ms and against stock.

    :param steps: samples of one repeat, in whole rollouts, at least one
    :param recipe: hyper-parameters
    :param policy: whose training goes on; None: an untrained one
    :param stock: also measure sb3-contrib's RecurrentPPO on a SubprocVecEnv of the same environment, same settings
    """
    task = trained_task(task, policy)
    training = Training(task, num_envs, recipe, policy)
    rollout = training.rollout
    samples = max(steps, rollout) // rollout * rollout
    bare_task = at_bare_dt(task)
    recording = record(bare_task, num_envs, training.recipe.n_steps, policy)
    _, replay = bare_replay(bare_task, recording)
    training.run(rollout)  # what is made once, is
    parts: list[Numbers] = []
    bare = []
    for _ in range(repeats):
        parts.append(training.run(samples))
        bare.append(rollout / seconds_of(lambda: list(replay())))
    ours = [samples / sum(part.values()) for part in parts]
    numbers = {
        "training_over_bare_physics": median([a / b for a, b in zip(ours, bare, strict=True)]),
        "samples_per_second": median(ours),
        "bare_physics_steps_per_second": median(bare),
        **shares(parts),
        "steps_that_end_an_episode": recording.endings,
    }
    if stock:
        rate = _stock_rate(task, num_envs, training.recipe, policy)
        numbers |= {"train_over_stock": median(ours) / rate, "stock_samples_per_second": rate}
    return {
        **numbers,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "memory_mb_per_env": _memory_per_env(task),
    }


def shares(repeats: list[Numbers]) -> Numbers:
    """Medians of the parts' shares of the time of each repeat."""
    return {f"share_{part}": median([one[part] / sum(one.values()) for one in repeats]) for part in PARTS}


def _stock_rate(task: TaskConfig, num_envs: int, recipe: PPOConfig, policy: LstmPolicy | None) -> float:
    """Samples/s of stock, in one rollout after another one.

    The networks have one thread: beside the processes of the environments, several wait for each other.
    """
    with torch_threads(1), closing(stock_env(SubprocVecEnv, task, num_envs)) as env:
        model = stock_learner(env, recipe, policy)
        rollout = model.n_steps * num_envs
        model.learn(rollout)
        return rollout / seconds_of(lambda: model.learn(rollout, reset_num_timesteps=False))


def _memory_per_env(task: TaskConfig) -> float:
    """Growth of the resident size from 64 to 1,088 environments, MB each."""

    def resident() -> float:
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20

    small = OgmpVecEnv(task, 64, seed=0)
    before = resident()
    large = OgmpVecEnv(task, 1024, seed=0)
    large.reset()
    grown = resident() - before
    del small, large
    return grown / 1024
