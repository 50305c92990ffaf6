"""What policy and critic see: the task's observation terms, one behind the other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.disturbances import Disturbances
from ogmp_sb3.env.observations import CLIP, Signal
from ogmp_sb3.env.terms import Term, bind
from ogmp_sb3.env.view import EnvView

CRITIC_CLIP = 10.0  # what only the critic sees is clipped to this many typical sizes


class Observer:
    """The observation terms of a task.

    :param task: the task
    :param disturbances: whose sensor noise the policy sees
    """

    def __init__(self, task: TaskConfig, disturbances: Disturbances) -> None:
        self._disturbances = disturbances
        self._of_policy = bind(registry.observations, task.observations)
        self._of_critic = bind(registry.observations, task.critic_observations)

    @property
    def critic_sees_more(self) -> bool:
        """Whether there are terms for the critic alone."""
        return bool(self._of_critic)

    def scale(self, view: EnvView) -> np.ndarray:
        """Typical sizes of what the policy sees, shape (size,)."""
        return np.concatenate([signal.scale for signal in _signals(self._of_policy, view).values()])

    def policy(self, view: EnvView, rows: np.ndarray | None = None) -> np.ndarray:
        """What the policy sees of some environments, as their sensors give it, shape (n, size), float32.

        :param view: of these environments
        :param rows: which they are, shape (n,), int; None: all
        """
        values, scales = [], []
        for name, signal in _signals(self._of_policy, view).items():
            values.append(self._disturbances.measured(name, signal.value, signal.scale, rows))
            scales.append(signal.scale)
        limit = CLIP * np.concatenate(scales)
        return _finite(np.clip(np.concatenate(values, axis=1), -limit, limit))

    def critic(self, view: EnvView) -> np.ndarray:
        """What only the critic sees, if it does, exactly and in typical sizes, shape (n, size), float32."""
        values = [signal.value / signal.scale for signal in _signals(self._of_critic, view).values()]
        return _finite(np.clip(np.concatenate(values, axis=1), -CRITIC_CLIP, CRITIC_CLIP))


def _signals(terms: Mapping[str, Term], view: EnvView) -> dict[str, Signal]:
    return {name: term(view) for name, term in terms.items()}


def _finite(values: np.ndarray) -> np.ndarray:
    """Without the numbers of a simulation that has become unstable."""
    observation: np.ndarray = values.astype(np.float32)
    observation[~np.isfinite(observation)] = 0.0
    return observation
