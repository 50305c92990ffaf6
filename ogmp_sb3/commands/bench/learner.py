"""How fast the learner and a whole training are, against stock."""

from __future__ import annotations

import gc
import resource
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv

from ogmp_sb3.commands.bench.simulation import Numbers, median, seconds_of, stock_env
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.sb3.hyperparameters import PPOConfig, default_ppo
from ogmp_sb3.sb3.policy import policy_kwargs
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

FASTEST_CHUNK = 16  # steps: the fastest chunks on two cores


def bench_learner(task: TaskConfig, num_envs: int, repeats: int) -> Numbers:
    """``train()`` on the same rollout: stock, ours with stock's gradients, ours with chunks."""
    recipe = default_ppo()
    env = OgmpVecEnv(task, num_envs, seed=0)
    learners = {
        "stock": _learner(StockRecurrentPPO, env, recipe, None),
        "exact": _learner(RecurrentPPO, env, recipe, None),
        "chunked": _learner(RecurrentPPO, env, recipe, FASTEST_CHUNK),
    }
    seconds: dict[str, list[float]] = {name: [] for name in learners}
    for _ in range(repeats):
        for name, learner in learners.items():
            _, callback = learner._setup_learn(10**9, reset_num_timesteps=False)
            learner.collect_rollouts(env, callback, learner.rollout_buffer, learner.n_steps)
            seconds[name].append(seconds_of(learner.train))
    each = {name: median(values) for name, values in seconds.items()}
    samples = recipe.n_steps * num_envs
    return {
        "learner_exact_over_stock": each["stock"] / each["exact"],
        "learner_over_stock": each["stock"] / each["chunked"],
        **{f"{name}_samples_per_second": samples / value for name, value in each.items()},
    }


def _learner(kind: type[StockRecurrentPPO], env: VecEnv, recipe: PPOConfig, chunk_length: int | None) -> Any:
    settings = recipe.stock_settings()
    if kind is not StockRecurrentPPO:
        settings["chunk_length"] = chunk_length
    batch = env.batch if isinstance(env, OgmpVecEnv) else None
    size = env.observation_space.shape[0]  # type: ignore[index]
    scale = batch.observation_scale if batch is not None else np.ones(size)
    network = policy_kwargs(scale, recipe.lstm_hidden_size, recipe.n_lstm_layers, log_std_init=-2.5)
    if kind is StockRecurrentPPO:
        del network["optimizer_kwargs"]  # its own: Adam, not fused
    # No early stop, so that all do the recipe's epochs.
    settings["target_kl"] = None
    learner = kind("MlpLstmPolicy", env, seed=0, device="cpu", policy_kwargs=network, **settings)
    learner.set_logger(Logger(None, []))
    return learner


def bench_train(task: TaskConfig, num_envs: int, steps: int, repeats: int) -> Numbers:
    """Whole training against stock RecurrentPPO on a SubprocVecEnv of the same environment, same settings.

    :param steps: samples of one repeat, in whole rollouts; 0: four rollouts
    """
    recipe = default_ppo()
    rollout = recipe.n_steps * num_envs
    samples = max(steps or 4 * rollout, rollout) // rollout * rollout
    ours_env = OgmpVecEnv(task, num_envs, seed=0)
    ours = _learner(RecurrentPPO, ours_env, recipe, recipe.chunk_length)
    with closing(stock_env(SubprocVecEnv, task, num_envs)) as theirs:
        stock = _learner(StockRecurrentPPO, theirs, recipe, None)
        ours_rate, stock_rate = [], []
        for _ in range(repeats):
            ours_rate.append(samples / seconds_of(lambda: ours.learn(samples, reset_num_timesteps=False)))
            stock_rate.append(rollout / seconds_of(lambda: stock.learn(rollout, reset_num_timesteps=False)))
    return {
        "train_over_stock": median(ours_rate) / median(stock_rate),
        "samples_per_second": median(ours_rate),
        "stock_samples_per_second": median(stock_rate),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "memory_mb_per_env": _memory_per_env(task),
    }


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
