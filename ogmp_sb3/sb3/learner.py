"""A learner as ``ogmp-train`` makes it: its network, exploration noise, hyper-parameters and learning rate."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any, TypeVar, overload

import numpy as np
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from stable_baselines3.common.vec_env import VecEnv

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.mirror import Mirrors, mirrors
from ogmp_sb3.sb3.hyperparameters import PPOConfig, default_ppo
from ogmp_sb3.sb3.policy import LstmPolicy, policy_kwargs
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO

K = TypeVar("K", bound=StockRecurrentPPO)


@overload
def make_model(
    env: VecEnv,
    ppo: PPOConfig | None = None,
    seed: int = 0,
    *,
    device: str = "cpu",
    policy: type[LstmPolicy] = LstmPolicy,
    **hyperparameters: float | list[int] | None,
) -> RecurrentPPO: ...


@overload
def make_model(
    env: VecEnv,
    ppo: PPOConfig | None = None,
    seed: int = 0,
    *,
    kind: type[K],
    device: str = "cpu",
    policy: type[LstmPolicy] = LstmPolicy,
    **hyperparameters: float | list[int] | None,
) -> K: ...


def make_model(
    env: VecEnv,
    ppo: PPOConfig | None = None,
    seed: int = 0,
    kind: Any = RecurrentPPO,
    device: str = "cpu",
    policy: type[LstmPolicy] = LstmPolicy,
    **hyperparameters: Any,
) -> Any:
    """A new recurrent policy and its learner.

    :param env: an :class:`~ogmp_sb3.sb3.vec_env.OgmpVecEnv`, wrapped or not
    :param ppo: hyper-parameters; None: those of ``ogmp-train``
    :param seed: of the networks
    :param kind: the learner's class: ours, or sb3-contrib's
    :param device: of the networks, as in Stable-Baselines3
    :param policy: class of the policy
    :param hyperparameters: replace some of ``ppo`` by name, e.g. ``learning_rate=1e-4, n_steps=32``; the names are
        the fields of :class:`~ogmp_sb3.sb3.hyperparameters.PPOConfig`
    :return: a ``kind``
    :raises KeyError: for an unknown hyper-parameter
    :raises TypeError: for a hyper-parameter of the wrong type
    :raises ValueError: for one that is out of range
    """
    ppo = ppo or default_ppo()
    if hyperparameters:
        ppo = read(PPOConfig, {**asdict(ppo), **hyperparameters}, Where("make_model"))
    batch: BatchEnv = env.get_attr("batch")[0]
    action = batch.task.action
    noise = float(np.log(action.noise / action.scale))
    ours = issubclass(kind, RecurrentPPO)
    network = policy_kwargs(
        batch.observation_scale,
        ppo.lstm_hidden_size,
        ppo.n_lstm_layers,
        noise,
        ppo.input_layers,
        ppo.critic_layers,
        batch.critic_observation().shape[1] if ours else 0,
    )
    settings = (
        {**ppo.settings(), "mirrors": _mirrors(batch) if ppo.symmetry else None} if ours else ppo.stock_settings()
    )
    model = kind(policy, env, seed=seed, device=device, policy_kwargs=network, **settings)
    if not ours:
        half_life = ppo.learning_rate_half_life or math.inf
        model.policy.log_std.requires_grad_(ppo.learn_noise)
        model.lr_schedule = lambda _: ppo.learning_rate * 0.5 ** (model.num_timesteps / half_life)
    return model


def _mirrors(batch: BatchEnv) -> Mirrors:
    """:raises ValueError: if the task has no mirror image"""
    try:
        return mirrors(batch)
    except ValueError as error:
        raise ValueError(f"{batch.task.file}: {str(error).rstrip('.')}; train with ppo.symmetry=false.") from None
