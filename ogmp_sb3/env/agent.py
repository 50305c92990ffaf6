"""The agent in a batch of environments: a policy, by Stable-Baselines3's ``predict``, and its memory."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from ogmp_sb3.config.messages import describe

# A matrix product rounds a single row otherwise than the same row among others, and its episode would take another way.
LEAST_ROWS = 2


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


class Loaded(Protocol):
    """A policy with what is known about it, e.g. a :class:`~ogmp_sb3.runs.policies.LoadedPolicy`."""

    @property
    def policy(self) -> Policy:
        """Its policy."""


AnyPolicy = Policy | Loaded
"""What can be played: a model of Stable-Baselines3 or sb3-contrib, a policy of theirs, or a loaded policy.

A model that was trained under ``VecNormalize`` is shown normalised observations if its environment still is one: load
it with ``PPO.load(file, env=VecNormalize.load(statistics, env))``.
"""


class Normalised:
    """A model whose observations are normalised first, as they were in its training.

    :param model: a model of Stable-Baselines3
    :param statistics: its ``VecNormalize``
    """

    def __init__(self, model: Any, statistics: Any) -> None:
        self.observation_space = model.observation_space
        self._model, self._statistics = model, statistics

    def predict(
        self,
        observation: np.ndarray,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """As of :class:`Policy`; the statistics do not change."""
        shown = self._statistics.normalize_obs(observation)
        return self._model.predict(shown, state, episode_start, deterministic)  # type: ignore[no-any-return]


def playable(policy: AnyPolicy, observation_size: int) -> Policy:
    """The policy in a model, a policy or a loaded policy, as it is to be played.

    :param observation_size: of the task that is to be played
    :raises TypeError: for anything that does not act
    :raises ValueError: if the policy observes another number of values
    """
    actor: Any = policy if hasattr(policy, "predict") else getattr(policy, "policy", None)
    if not hasattr(actor, "predict"):
        raise TypeError(
            f"a model, a policy or what load_policy returns is needed to play, found {describe(policy)}. "
            "A name or a path must be loaded first: load_policy('parkour')."
        )
    observed = getattr(actor, "observation_space", None)  # an object of one's own need not have one
    if observed is not None and observed.shape != (observation_size,):
        size = observed.shape[0] if observed.shape else 0
        raise ValueError(f"the task shows {observation_size} numbers, but the policy observes {size}.")
    statistics = actor.get_vec_normalize_env() if hasattr(actor, "get_vec_normalize_env") else None
    return actor if statistics is None else Normalised(actor, statistics)


class Actor:
    """A policy that plays a batch of environments by its deterministic actions, with a memory for each.

    :param policy: a model, a policy or a loaded policy
    :param num_envs: number of environments
    :param observation_size: of the task
    :raises ValueError: if the policy does not fit the task
    """

    def __init__(self, policy: AnyPolicy, num_envs: int, observation_size: int) -> None:
        self.policy = playable(policy, observation_size)
        self._memory: tuple[np.ndarray, ...] | None = None
        self._num_envs = num_envs
        self._starts = np.ones(max(num_envs, LEAST_ROWS), dtype=bool)

    def restart(self, rows: np.ndarray | slice = slice(None)) -> None:
        """Forget what was seen in some environments, where new episodes begin; by default in all."""
        self._starts[rows] = True

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The actions for the present observations, shape (num_envs, joints).

        :param observation: shape (num_envs, size)
        """
        if self._num_envs < LEAST_ROWS:
            observation = np.repeat(observation, LEAST_ROWS, axis=0)
        action, self._memory = self.policy.predict(observation, self._memory, self._starts, deterministic=True)
        self._starts = np.zeros(len(self._starts), dtype=bool)
        return action[: self._num_envs]
