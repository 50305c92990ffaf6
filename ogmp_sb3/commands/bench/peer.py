"""The update of our learner against rsl_rl's, on rollouts of one shape: ``ogmp-bench learner peer=rsl_rl``."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch as th
from torch import nn

from ogmp_sb3.commands.bench.learner import learner, update
from ogmp_sb3.commands.bench.random_env import RandomEnv
from ogmp_sb3.commands.bench.timing import Numbers, cpu_seconds_of, median
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.sb3.hyperparameters import PPOConfig
from ogmp_sb3.sb3.threads import torch_threads

ENDINGS = (0.05, 0.005)  # shares of the steps that end an episode: of early training, and of a good policy
INSTALL = "pip install rsl-rl-lib"


def check_installed() -> None:
    """:raises ValueError: if rsl_rl is missing, or too old to have what is compared"""
    if any(importlib.util.find_spec(name) is None for name in ("rsl_rl", "tensordict")):
        raise ValueError(f"'peer=rsl_rl' needs rsl_rl, which is not installed: {INSTALL}.")
    if importlib.util.find_spec("rsl_rl.models") is None:
        raise ValueError(f"'peer=rsl_rl' needs rsl_rl 5 or later, found an older one: {INSTALL} --upgrade.")


def bench_peer(task: TaskConfig, num_envs: int, repeats: int, recipe: PPOConfig) -> Numbers:
    """Update by a recipe, ours and rsl_rl's: LSTMs, samples, epochs and minibatches of the same size.

    Observations, rewards and the ends of episodes are random and the same for both. Each has one thread, and what
    counts is CPU time.

    :raises ValueError: if rsl_rl is missing, or cannot divide the environments among the minibatches
    """
    check_installed()
    recipe = replace(recipe, chunk_length=None, input_layers=(), critic_layers=None, symmetry=False)  # what both have
    samples = recipe.n_steps * num_envs
    numbers: Numbers = {}
    with torch_threads(1):
        for endings in ENDINGS:
            ours = learner(RandomEnv(task, num_envs, endings), recipe)
            theirs = RslRl(RandomEnv(task, num_envs, endings), recipe)
            seconds: tuple[list[float], list[float]] = ([], [])
            for _ in range(repeats):
                seconds[0].append(cpu_seconds_of(update(ours)))
                seconds[1].append(cpu_seconds_of(theirs.update()))
            label = f"at_{100 * endings:g}_percent"
            ratio = median([b / a for a, b in zip(*seconds, strict=True)])
            numbers[f"learner_over_rsl_rl_{label}"] = ratio
            numbers[f"samples_per_second_{label}"] = samples / median(seconds[0])
            numbers[f"rsl_rl_samples_per_second_{label}"] = samples / median(seconds[1])
    return numbers


class RslRl:
    """rsl_rl's PPO with recurrent models of a recipe's size: LSTMs with a linear layer behind, and a normaliser.

    :param env: what it collects rollouts from
    :param recipe: sizes, epochs and minibatches
    :raises ValueError: if the environments cannot be divided among the minibatches
    """

    def __init__(self, env: RandomEnv, recipe: PPOConfig) -> None:
        from rsl_rl.algorithms import PPO
        from rsl_rl.models import RNNModel
        from rsl_rl.storage import RolloutStorage

        self._env, self._steps = env, recipe.n_steps
        batches = max(1, round(recipe.n_steps * env.num_envs / recipe.batch_size))
        if env.num_envs % batches:
            raise ValueError(
                f"rsl_rl makes its {batches} minibatches of whole environments: 'num_envs' must be a multiple of "
                f"{batches}, found {env.num_envs}."
            )
        self._observation = self._seen(env.reset())
        size = {"rnn_type": "lstm", "rnn_hidden_dim": recipe.lstm_hidden_size, "rnn_num_layers": recipe.n_lstm_layers}
        noise = {"class_name": "GaussianDistribution", "init_std": 0.1, "learn_std": recipe.learn_noise}
        common = {**size, "obs_normalization": True, "hidden_dims": [1]}
        groups = {"actor": ["policy"], "critic": ["policy"]}
        actions = env.batch.action_size
        actor = RNNModel(self._observation, groups, "actor", actions, distribution_cfg=noise, **common)
        critic = RNNModel(self._observation, groups, "critic", 1, **common)
        # Its MLP has one hidden layer at least; ours has none.
        actor.mlp, critic.mlp = (nn.Linear(recipe.lstm_hidden_size, outputs) for outputs in (actions, 1))
        storage = RolloutStorage("rl", env.num_envs, recipe.n_steps, self._observation, [actions])
        self._ppo = PPO(
            actor,
            critic,
            storage,
            num_learning_epochs=recipe.n_epochs,
            num_mini_batches=batches,
            clip_param=recipe.clip_range,
            gamma=recipe.gamma,
            lam=recipe.gae_lambda,
            value_loss_coef=recipe.vf_coef,
            entropy_coef=recipe.ent_coef,
            learning_rate=recipe.learning_rate,
            max_grad_norm=recipe.max_grad_norm,
            use_clipped_value_loss=False,
            schedule="fixed",
            normalize_advantage_per_mini_batch=True,
        )
        self._ppo.train_mode()
        self._collect()  # the first rollout has no memory to begin with

    def _seen(self, observation: np.ndarray) -> Any:
        from tensordict import TensorDict

        return TensorDict({"policy": th.as_tensor(observation)}, batch_size=[len(observation)])

    @th.inference_mode()
    def _collect(self) -> None:
        self._ppo.storage.clear()
        for _ in range(self._steps):
            actions = self._ppo.act(self._observation)
            self._env.step_async(actions.numpy())
            observation, rewards, dones, _ = self._env.step_wait()
            self._observation = self._seen(observation)
            self._ppo.process_env_step(self._observation, th.as_tensor(rewards), th.as_tensor(dones), {})
        self._ppo.compute_returns(self._observation)

    def update(self) -> Callable[[], Any]:
        """Collect a rollout; what updates the networks from it."""
        self._collect()
        update: Callable[[], Any] = self._ppo.update
        return update
