"""How fast the learner is, against stock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch as th
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv

from ogmp_sb3.commands.bench.timing import Numbers, median, seconds_of
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import playable
from ogmp_sb3.sb3.hyperparameters import PPOConfig
from ogmp_sb3.sb3.learner import make_model
from ogmp_sb3.sb3.policy import LstmPolicy
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

FASTEST_CHUNK = 16  # steps: the fastest chunks on two cores


def bench_learner(task: TaskConfig, num_envs: int, repeats: int, recipe: PPOConfig) -> Numbers:
    """``train()`` on the same rollout: stock, ours with stock's gradients, ours with chunks."""
    env = OgmpVecEnv(task, num_envs, seed=0)
    learners = {
        "stock": stock_learner(env, recipe),
        "exact": learner(env, replace(recipe, chunk_length=None)),
        "chunked": learner(env, replace(recipe, chunk_length=FASTEST_CHUNK)),
    }
    seconds: dict[str, list[float]] = {name: [] for name in learners}
    for _ in range(repeats):
        for name, model in learners.items():
            seconds[name].append(seconds_of(update(model)))
    each = {name: median(values) for name, values in seconds.items()}
    samples = recipe.n_steps * num_envs
    return {
        "learner_exact_over_stock": each["stock"] / each["exact"],
        "learner_over_stock": each["stock"] / each["chunked"],
        **{f"{name}_samples_per_second": samples / value for name, value in each.items()},
    }


def learner(env: VecEnv, recipe: PPOConfig, policy: LstmPolicy | None = None) -> RecurrentPPO:
    """Ours, without the early stop, so that all do the recipe's epochs.

    :param policy: whose weights to go on from; None: none
    :raises ValueError: if the policy does not fit the environments or the recipe's networks
    """
    model = make_model(env, replace(recipe, target_kl=None))
    _prepare(model, policy)
    return model


class SteppedPolicy(LstmPolicy):
    """The same network, whose LSTM steps through time as sb3-contrib's does."""

    _process_sequence = staticmethod(RecurrentActorCriticPolicy._process_sequence)  # type: ignore[assignment]


def stock_learner(env: VecEnv, recipe: PPOConfig, policy: LstmPolicy | None = None) -> StockRecurrentPPO:
    """sb3-contrib's with the same settings, and its own optimiser: Adam, not fused."""
    model = make_model(env, replace(recipe, target_kl=None), kind=StockRecurrentPPO, policy=SteppedPolicy)
    model.policy.optimizer = th.optim.Adam(model.policy.parameters(), lr=recipe.learning_rate, eps=1e-5)
    _prepare(model, policy)
    return model


def _prepare(model: StockRecurrentPPO, policy: LstmPolicy | None) -> None:
    if policy is not None:
        playable(policy, model.observation_space.shape[0])  # type: ignore[index]
        try:
            model.policy.load_state_dict(policy.state_dict())
        except RuntimeError as error:
            reason = " ".join(str(error).split())[:200]
            raise ValueError(f"the policy's networks do not fit the recipe and this task ({reason}).") from None
    model.set_logger(Logger(None, []))


def update(model: Any) -> Callable[[], None]:
    """Collect a rollout; what updates the networks from it."""
    _, callback = model._setup_learn(10**9, reset_num_timesteps=False)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, model.n_steps)
    train: Callable[[], None] = model.train
    return train
