"""What happens to robots between the physics steps of a control step, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Events:
    """Vectors that reach robots within a control step: joint targets, or changes of a velocity."""

    at: np.ndarray
    """physics steps of the control step that come before it, shape (n,), int"""
    rows: np.ndarray
    """the environments, shape (n,), int"""
    values: np.ndarray
    """shape (n, size)"""

    def due(self, at: int) -> tuple[np.ndarray, np.ndarray]:
        """The environments and values of those that come after ``at`` physics steps."""
        now = self.at == at
        return self.rows[now], self.values[now]

    def later(self, row: int) -> Events:
        """Those of an environment that come after the first physics step, as events of environment 0."""
        chosen = (self.rows == row) & (self.at > 0)
        return Events(self.at[chosen], np.zeros(chosen.sum(), dtype=int), self.values[chosen])

    def at_once(self, at: int) -> Events:
        """Those that come after ``at`` physics steps, at once."""
        rows, values = self.due(at)
        return Events(np.zeros_like(rows), rows, values)


def no_events(size: int = 0) -> Events:
    """None, of vectors of a size."""
    return Events(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, size)))


NOTHING = no_events()
