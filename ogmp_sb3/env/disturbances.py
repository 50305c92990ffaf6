"""Domain randomisation: disturbances that are drawn anew for every episode of every environment.

What is drawn from what a task declares. Nothing here knows the simulator:
:class:`~ogmp_sb3.env.simulation.Simulation` changes bodies, contacts and servos, and
:class:`~ogmp_sb3.env.batch_env.BatchEnv` passes actions and observations through.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.variation import RandomisationConfig
from ogmp_sb3.env.events import Events, no_events

NOISY = ("proprioception",)  # observation terms that sensors measure
NO_KICKS = no_events(2)
NOT_SENT = np.inf  # no target is
ROBOT = ("mass", "friction", "gains")  # what changes the robot itself
AS_IT_IS = np.nan  # of a robot that is not changed, beside others that are


class Disturbances:
    """What was drawn for every environment.

    The generators are apart from those of the tracks, so that tracks are the same with and without disturbances.

    :param configs: the disturbances in use in each environment; None for none
    :param joints: number of joint targets
    :param physics_dt: physics step, s; times are rounded to it
    :param substeps: physics steps of a control step
    """

    def __init__(
        self, configs: Sequence[RandomisationConfig | None], joints: int, physics_dt: float, substeps: int
    ) -> None:
        self._physics_dt, self._substeps = physics_dt, substeps
        num_envs, in_use = len(configs), [config or RandomisationConfig() for config in configs]
        self._rng = [np.random.default_rng() for _ in range(num_envs)]
        self._ranges = [
            {name: value for name, value in vars(config).items() if isinstance(value, Range)} for config in in_use
        ]
        self._pushes = [config.push for config in in_use]
        self._noisy = np.array([config.sensor_noise is not None for config in in_use])
        drawn = dict.fromkeys(name for ranges in self._ranges for name in ranges)
        self._arrays = {name: np.full(num_envs, AS_IT_IS if name in ROBOT else 0.0) for name in drawn}
        latencies = [ranges["latency"].high for ranges in self._ranges if "latency" in ranges]
        if latencies:
            shape = (num_envs, int(self._physics_steps(max(latencies))) // substeps + 1, joints)
            self._arrays["targets"] = np.full(shape, NOT_SENT)  # newest first
        if any(self._pushes):
            every = [0.0 if push is None else push.every for push in self._pushes]
            self._push_steps = self._physics_steps(every)  # 0: none
            self._arrays["first_push"] = np.zeros(num_envs)  # physics steps from the start of an episode

    def seed_row(self, row: int, rng: np.random.Generator) -> None:
        """Give an environment a generator spawned from its own one."""
        self._rng[row] = rng.spawn(1)[0]

    def begin(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Draw anew for the next episodes of some environments; returns what :meth:`robots` does."""
        arrays = self._arrays
        for row in rows:
            rng = self._rng[row]
            for name, range_ in self._ranges[row].items():
                arrays[name][row] = rng.uniform(range_.low, range_.high)
            if self._pushes[row] is not None:
                arrays["first_push"][row] = rng.integers(self._push_steps[row])
        if "targets" in arrays:
            arrays["targets"][rows] = NOT_SENT
        return self.robots(rows)

    def robots(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """What :meth:`~ogmp_sb3.env.simulation.Simulation.vary` is to change in some environments.

        :return: by name, shape (n,); nan where it stays as it is
        """
        return {name: self._arrays[name][rows] for name in ROBOT if name in self._arrays}

    def arrivals(self, targets: np.ndarray, rows: np.ndarray | None) -> Events:
        """The joint targets that reach the servos in this control step, rad; they keep those that they have until then.

        :param targets: what is sent at its start, shape (num_envs, joints), rad
        :param rows: environments that are stepped, or None for all
        """
        every = np.arange(len(targets))
        if "targets" not in self._arrays:
            return Events(np.zeros_like(every), every, targets)
        sent = self._arrays["targets"]
        sent[:, 1:] = sent[:, :-1].copy()
        sent[:, 0] = targets
        rows = every if rows is None else rows
        steps_ago, at = np.divmod(self._physics_steps(self._arrays["latency"][rows]), self._substeps)
        arriving = sent[rows, steps_ago]
        real = arriving[:, 0] != NOT_SENT
        return Events(at[real], rows[real], arriving[real])

    def kicks(self, step_count: np.ndarray, rows: np.ndarray | None) -> Events:
        """Pushes of this control step: changes of horizontal velocities, m/s.

        :param step_count: control steps of the episodes so far, shape (num_envs,), int
        :param rows: environments that are stepped, or None for all
        """
        if "first_push" not in self._arrays:
            return NO_KICKS
        rows = np.arange(len(step_count)) if rows is None else rows
        rows = rows[self._push_steps[rows] > 0]
        first, every = self._arrays["first_push"][rows].astype(int), self._push_steps[rows]
        next_at = (first - step_count[rows] * self._substeps) % every
        kicks = [
            (at, rows[i], self._kick(rows[i]))
            for i in np.flatnonzero(next_at < self._substeps)
            for at in range(next_at[i], self._substeps, every[i])
        ]
        if not kicks:
            return NO_KICKS
        return Events(*map(np.array, zip(*kicks, strict=True)))

    def _kick(self, row: int) -> tuple[float, float]:
        """A change of velocity in a random direction, m/s."""
        push = self._pushes[row]
        assert push is not None
        angle = self._rng[row].uniform(0.0, 2.0 * np.pi)
        speed = self._rng[row].uniform(push.speed.low, push.speed.high)
        return speed * np.cos(angle), speed * np.sin(angle)

    def under_way(self) -> list[np.ndarray]:
        """The arrays of the targets that were sent and the latencies after which they arrive."""
        return [self._arrays[name] for name in ("latency", "targets") if name in self._arrays]

    def _physics_steps(self, seconds: Any) -> Any:
        return np.rint(np.asarray(seconds) / self._physics_dt).astype(int)

    def measured(self, name: str, value: np.ndarray, scale: np.ndarray, rows: np.ndarray | None) -> np.ndarray:
        """An observation term with sensor noise.

        :param name: of the term; only :data:`NOISY` ones are disturbed
        :param value: shape (n, size)
        :param scale: typical size of each component, shape (size,)
        :param rows: the environments, shape (n,), int, or None for all
        """
        if "sensor_noise" not in self._arrays or name not in NOISY:
            return value
        rows = np.arange(len(value)) if rows is None else rows
        noisy = self._noisy[rows]
        # One generator for each environment, so that its noise does not depend on how many others there are.
        noise = np.reshape([self._rng[row].standard_normal(len(scale)) for row in rows[noisy]], (-1, len(scale)))
        measured = value.copy()
        measured[noisy] += self._arrays["sensor_noise"][rows[noisy], None] * scale * noise
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
