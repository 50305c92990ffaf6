"""The agent in a batch of environments: a policy, by Stable-Baselines3's ``predict``, and its memory."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np


class Policy(Protocol):
    """Anything that acts: a policy or a model of Stable-Baselines3 or sb3-contrib, recurrent or not."""

    @property
    def observation_space(self) -> Any:
        """What it observes, a flat box."""

    def predict(
        self,
        observation: np.ndarray,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """Actions for a batch of observations, and the memory to hand in with the next ones.

        :param observation: shape (num_envs, size)
        :param state: memory of the step before; None: there was none
        :param episode_start: where an episode begins, so that the memory is forgotten, shape (num_envs,), bool
        :param deterministic: the mean action instead of a sample
        """


class Actor:
    """A policy that plays a batch of environments by its deterministic actions, with a memory for each.

    :param policy: the policy
    :param num_envs: number of environments
    """

    def __init__(self, policy: Policy, num_envs: int) -> None:
        self.policy = policy
        self._memory: tuple[np.ndarray, ...] | None = None
        self._starts = np.ones(num_envs, dtype=bool)

    def restart(self, rows: np.ndarray | slice = slice(None)) -> None:
        """Forget what was seen in some environments, where new episodes begin; by default in all."""
        self._starts[rows] = True

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The actions for the present observations, shape (num_envs, joints).

        :param observation: shape (num_envs, size)
        """
        action, self._memory = self.policy.predict(observation, self._memory, self._starts, deterministic=True)
        self._starts = np.zeros(len(self._starts), dtype=bool)
        return action
