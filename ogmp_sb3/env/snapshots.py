"""Snapshots of an environment: copy the arrays that hold its state, and restore them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np


class Part(Protocol):
    """A part of an environment with a state of its own: arrays, one row for each environment, and plain data."""

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays themselves: what is written into them is in force."""

    def plain(self) -> dict[str, Any]:
        """What is no array, as plain data, by its key in a saved state."""

    def set_plain(self, plain: Mapping[str, Any]) -> None:
        """Put back what :meth:`plain` gave."""


def take(arrays: Mapping[str, np.ndarray], prefix: str = "") -> dict[str, np.ndarray]:
    """Copies of arrays, their names behind a prefix."""
    return {prefix + name: values.copy() for name, values in arrays.items()}


def put_back(arrays: Mapping[str, np.ndarray], saved: Mapping[str, np.ndarray], prefix: str = "") -> None:
    """Write what :func:`take` copied back into the arrays, one row of which is one environment.

    :raises ValueError: if anything is missing or has another shape
    """
    for name, values in arrays.items():
        copy = saved.get(prefix + name)
        if copy is None or copy.shape != values.shape:
            raise ValueError(
                f"the saved state does not fit this task and {len(values)} environments ({prefix + name})."
            )
        values[...] = copy


def pack(arrays: Sequence[np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Some rows of all arrays side by side, shape (n, numbers of a row)."""
    return np.concatenate([array[rows].reshape(len(rows), -1) for array in arrays], axis=1)


def unpack(arrays: Sequence[np.ndarray], rows: np.ndarray, packed: np.ndarray) -> None:
    """Write what :func:`pack` gave into rows of the arrays."""
    used = 0
    for array in arrays:
        size = int(np.prod(array.shape[1:]))
        array[rows] = packed[:, used : used + size].reshape(-1, *array.shape[1:])
        used += size


def restored(kind: Callable[..., Any], arguments: tuple[Any, ...], state: tuple[Any, ...]) -> Any:
    """What :mod:`copy` and :mod:`pickle` make again: a ``kind`` of these arguments, put back to a saved state."""
    made = kind(*arguments)
    made.set_state(*state)
    return made
