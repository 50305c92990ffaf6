"""Domain randomisation: disturbances that are drawn anew for every episode of every environment.

What is drawn from what a task declares. Nothing here knows the simulator:
:class:`~ogmp_sb3.env.simulation.Simulation` changes bodies, contacts and servos, and
:class:`~ogmp_sb3.env.batch_env.BatchEnv` passes actions and observations through.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.variation import RandomisationConfig

NOISY = ("proprioception",)  # observation terms that sensors measure
NONE_DUE = (np.zeros(0, dtype=int), np.zeros((0, 2)))


class Disturbances:
    """What was drawn for every environment.

    The generators are apart from those of the tracks, so that tracks are the same with and without disturbances.

    :param config: the disturbances in use; None for none
    :param num_envs: number of environments
    :param nominal: joint targets before the first action, shape (joints,), rad
    :param control_dt: control step, s
    """

    def __init__(
        self, config: RandomisationConfig | None, num_envs: int, nominal: np.ndarray, control_dt: float
    ) -> None:
        self.config = config = config or RandomisationConfig()
        self._rng = [np.random.default_rng() for _ in range(num_envs)]
        self._ranges = {name: value for name, value in vars(config).items() if isinstance(value, Range)}
        self._arrays = {name: np.zeros(num_envs) for name in self._ranges}
        self._nominal = nominal
        if config.latency is not None:
            shape = (num_envs, int(config.latency.high) + 1, len(nominal))
            self._arrays["targets"] = np.broadcast_to(nominal, shape).copy()  # newest first
        if config.push is not None:
            self._push_steps = max(round(config.push.every / control_dt), 1)
            self._arrays["first_push"] = np.zeros(num_envs)

    def seed_row(self, row: int, rng: np.random.Generator) -> None:
        """Give an environment a generator spawned from its own one."""
        self._rng[row] = rng.spawn(1)[0]

    def begin(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Draw anew for the next episodes of some environments; returns what :meth:`robots` does."""
        arrays = self._arrays
        for row in rows:
            rng = self._rng[row]
            for name, range_ in self._ranges.items():
                if name == "latency":
                    arrays[name][row] = rng.integers(int(range_.low), int(range_.high), endpoint=True)
                else:
                    arrays[name][row] = rng.uniform(range_.low, range_.high)
            if self.config.push is not None:
                arrays["first_push"][row] = rng.integers(self._push_steps)
        if self.config.latency is not None:
            arrays["targets"][rows] = self._nominal
        return self.robots(rows)

    def robots(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """What :meth:`~ogmp_sb3.env.simulation.Simulation.vary` is to change in some environments."""
        return {name: self._arrays[name][rows] for name in ("mass", "friction", "gains") if name in self._arrays}

    def delayed(self, targets: np.ndarray) -> np.ndarray:
        """The joint targets that reach the servos now, shape (num_envs, joints)."""
        if self.config.latency is None:
            return targets
        held = self._arrays["targets"]
        held[:, 1:] = held[:, :-1].copy()
        held[:, 0] = targets
        due: np.ndarray = held[np.arange(len(held)), self._arrays["latency"].astype(int)]
        return due

    def kicks(self, step_count: np.ndarray, rows: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Pushes of this control step.

        :param step_count: control steps of the episodes so far, shape (num_envs,), int
        :param rows: environments that are stepped, or None for all
        :return: environments, shape (n,), int, and changes of their horizontal velocity, shape (n, 2), m/s
        """
        push = self.config.push
        if push is None:
            return NONE_DUE
        rows = np.arange(len(step_count)) if rows is None else rows
        due = rows[(step_count[rows] - self._arrays["first_push"][rows]) % self._push_steps == 0]
        kicks = np.zeros((len(due), 2))
        for i, row in enumerate(due):
            angle = self._rng[row].uniform(0.0, 2.0 * np.pi)
            speed = self._rng[row].uniform(push.speed.low, push.speed.high)
            kicks[i] = speed * np.cos(angle), speed * np.sin(angle)
        return due, kicks

    def measured(self, name: str, value: np.ndarray, scale: np.ndarray, rows: np.ndarray | None) -> np.ndarray:
        """An observation term with sensor noise.

        :param name: of the term; only :data:`NOISY` ones are disturbed
        :param value: shape (n, size)
        :param scale: typical size of each component, shape (size,)
        :param rows: the environments, shape (n,), int, or None for all
        """
        if self.config.sensor_noise is None or name not in NOISY:
            return value
        rows = np.arange(len(value)) if rows is None else rows
        # One generator for each environment, so that its noise does not depend on how many others there are.
        noise = np.stack([self._rng[row].standard_normal(len(scale)) for row in rows])
        measured: np.ndarray = value + self._arrays["sensor_noise"][rows, None] * scale * noise
        return measured

    def arrays(self) -> dict[str, np.ndarray]:
        """All that was drawn; empty if no disturbance is in use."""
        return self._arrays

    def plain(self) -> dict[str, Any]:
        """The generators, if any disturbance is in use."""
        return {"disturbances": [rng.bit_generator.state for rng in self._rng]} if self._arrays else {}

    def set_plain(self, plain: Mapping[str, Any]) -> None:
        """Put back what :meth:`plain` gave."""
        for rng, state in zip(self._rng if self._arrays else (), plain.get("disturbances", ()), strict=True):
            rng.bit_generator.state = state
