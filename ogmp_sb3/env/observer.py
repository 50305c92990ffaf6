"""What policy and critic see: the task's observation terms, one behind the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.observations import CLIP, Part, Signal
from ogmp_sb3.env.terms import Term, bind
from ogmp_sb3.env.view import EnvView

Sensors = Callable[[np.ndarray], np.ndarray]
CRITIC_CLIP = 10.0  # what only the critic sees is clipped to this many typical sizes


class Observer:
    """The observation terms of a task.

    :param task: the task
    """

    def __init__(self, task: TaskConfig) -> None:
        self._of_policy = bind(registry.observations, task.observations)
        self._of_critic = bind(registry.observations, task.critic_observations)

    @property
    def critic_sees_more(self) -> bool:
        """Whether there are terms for the critic alone."""
        return bool(self._of_critic)

    def scale(self, view: EnvView) -> np.ndarray:
        """Typical sizes of what the policy sees, shape (size,)."""
        return np.concatenate([signal.scale for signal in _signals(self._of_policy, view).values()])

    def parts(self, view: EnvView) -> list[Part]:
        """What the policy sees, in order."""
        signals = _signals(self._of_policy, view)
        return [part for name, signal in signals.items() for part in signal.parts_of(name)]

    def policy(self, view: EnvView, sensors: Sensors | None = None) -> np.ndarray:
        """What the policy sees of some environments, shape (n, size), float32.

        :param view: of these environments
        :param sensors: what they make of it; None: it is seen as it is
        """
        signals = _signals(self._of_policy, view).values()
        values = np.concatenate([signal.value for signal in signals], axis=1)
        limit = CLIP * np.concatenate([signal.scale for signal in signals])
        return _finite(np.clip(values if sensors is None else sensors(values), -limit, limit))

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
