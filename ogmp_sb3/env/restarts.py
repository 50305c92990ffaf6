"""Restarts: short training episodes that begin shortly before earlier ones went wrong.

A policy that masters nearly all of a track learns little from more of it: what it still gets wrong comes too seldom.
So an environment remembers the moments before its falls and begins some of its episodes there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ogmp_sb3.config.variation import MOST_WAITING, REMEMBER_EVERY, RestartConfig


class Restarts:
    """What every environment remembers: its last moments, and those that wait to be begun from.

    A moment is a vector that only its owner understands, with the modes laid until then as plain data.

    :param config: what the task declares; None: nothing is remembered
    :param num_envs: number of environments
    :param size: numbers of a moment
    """

    def __init__(self, config: RestartConfig | None, num_envs: int, size: int) -> None:
        self.config = config
        slots, queue = (0, 0) if config is None else (int(config.before.high) // REMEMBER_EVERY + 2, MOST_WAITING)
        self._past = np.zeros((num_envs, slots, size))
        self._past_modes = np.zeros((num_envs, slots), dtype=int)  # how many were laid
        self._queue = np.zeros((num_envs, queue, size))
        self._waiting: list[list[Any]] = [[] for _ in range(num_envs)]  # modes of the queue, oldest first
        self._rng = [np.random.default_rng() for _ in range(num_envs)]

    def seed_row(self, row: int, rng: np.random.Generator) -> None:
        """Give an environment a generator spawned from its own one, and forget what it remembers."""
        self._rng[row] = rng.spawn(1)[0]
        self._waiting[row] = []

    def due(self, step_count: np.ndarray) -> np.ndarray:
        """Environments whose moment is to be remembered now, shape (n,), int.

        :param step_count: control steps of the episodes so far, shape (num_envs,), int
        """
        return np.flatnonzero(step_count % REMEMBER_EVERY == 0) if self.config else np.zeros(0, dtype=int)

    def remember(self, rows: np.ndarray, steps: np.ndarray, moments: np.ndarray, modes: np.ndarray) -> None:
        """Keep the present moments of some environments, over the oldest.

        :param rows: shape (n,), int
        :param steps: control steps of their episodes, shape (n,), int
        :param moments: shape (n, size)
        :param modes: how many modes were laid, shape (n,), int
        """
        self._past[rows, self._slot(steps)] = moments
        self._past_modes[rows, self._slot(steps)] = modes

    def fallen(self, row: int, steps: int, modes: list[Any]) -> None:
        """An episode that began at a start went wrong: let moments before that wait.

        :param row: the environment
        :param steps: control steps of the episode
        :param modes: of the episode so far
        """
        config = self.config
        assert config is not None
        for _ in range(config.per_fall):
            before = self._rng[row].uniform(config.before.low, config.before.high)
            moment = int((steps - before) // REMEMBER_EVERY * REMEMBER_EVERY)
            if moment < REMEMBER_EVERY:
                continue
            waiting = self._waiting[row]
            if len(waiting) == MOST_WAITING:
                waiting.pop(0)
                self._queue[row, :-1] = self._queue[row, 1:].copy()
            slot = self._slot(moment)
            self._queue[row, len(waiting)] = self._past[row, slot]
            waiting.append(modes[: self._past_modes[row, slot]])

    def take(self, row: int) -> tuple[np.ndarray, list[Any]] | None:
        """The moment an environment begins its next episode from, with its modes; None: at the start of a track."""
        if self.config is None or not self._waiting[row] or self._rng[row].random() >= self.config.fraction:
            return None
        moment = self._queue[row, 0].copy()
        self._queue[row, :-1] = self._queue[row, 1:].copy()
        return moment, self._waiting[row].pop(0)

    def arrays(self) -> dict[str, np.ndarray]:
        """The moments that are remembered and that wait; empty where nothing is remembered."""
        if self.config is None:
            return {}
        return {"past": self._past, "past_modes": self._past_modes, "queue": self._queue}

    def plain(self) -> dict[str, Any]:
        """The generators, and the modes of the moments that wait."""
        if self.config is None:
            return {}
        generators = [rng.bit_generator.state for rng in self._rng]
        return {"restarts": [generators, [list(modes) for modes in self._waiting]]}

    def set_plain(self, plain: Mapping[str, Any]) -> None:
        """Put back what :meth:`plain` gave."""
        if self.config is None:
            return
        generators, waiting = plain["restarts"]
        self._waiting = [list(modes) for modes in waiting]
        for rng, state in zip(self._rng, generators, strict=True):
            rng.bit_generator.state = state

    def _slot(self, steps: Any) -> Any:
        return steps // REMEMBER_EVERY % self._past.shape[1]
