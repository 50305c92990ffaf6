"""Task variants: which mode comes next, and with which parameters (paper: Psi_T = Psi_M^N)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ogmp_sb3.config import ModeRanges, Range, TaskConfig
from ogmp_sb3.modes import Segment
from ogmp_sb3.registry import modes


@dataclass(frozen=True)
class ModeCall:
    """A mode and its parameters."""

    name: str
    """registered name"""
    parameters: dict[str, float | str]
    """parameter values"""

    def segment(self) -> Segment:
        """What the mode asks for."""
        return modes.get(self.name)(**self.parameters)  # type: ignore[no-any-return]


def sample_mode(task: TaskConfig, rng: np.random.Generator, index: int, level: float = 1.0) -> ModeCall:
    """Draw the mode at a place in the sequence of a task variant.

    :param task: the task
    :param rng: the environment's generator
    :param index: how many modes came before
    :param level: curriculum level, 0 to 1
    """
    if task.sampling.order == "random":
        names = list(task.mode_ranges)
        weights = np.array([mode_weight(task, name, level) for name in names])
        name = names[int(np.searchsorted(np.cumsum(weights) / weights.sum(), rng.random(), side="right"))]
    else:
        sequence = task.sampling.sequence
        repeated = index % len(sequence) if task.sampling.repeat == "all" else min(index, len(sequence) - 1)
        name = sequence[repeated]
    ranges = mode_ranges(task, name, level)
    return ModeCall(name, {key: _draw(range_, rng) for key, range_ in ranges.items()})


def mode_weight(task: TaskConfig, name: str, level: float) -> float:
    """Relative frequency of a mode at a curriculum level."""
    full = task.sampling.weights.get(name, 1.0)
    if task.curriculum is None:
        return full
    start = task.curriculum.weights.get(name, full)
    return start + level * (full - start)


def mode_ranges(task: TaskConfig, name: str, level: float) -> dict[str, Range]:
    """Parameter ranges of a mode at a curriculum level."""
    full = task.mode_ranges[name]
    if task.curriculum is None:
        return full
    start = task.curriculum.modes.get(name, {})
    return {key: start.get(key, range_).towards(range_, level) for key, range_ in full.items()}


def corner_segments(ranges: ModeRanges) -> Iterator[Segment]:
    """The segments of every mode at the extremes of its parameters."""
    for name, parameters in ranges.items():
        for values in itertools.product(*(r.corners() for r in parameters.values())):
            yield ModeCall(name, dict(zip(parameters, values, strict=True))).segment()


def _draw(range_: Range, rng: np.random.Generator) -> float | str:
    if range_.words:
        return range_.words[int(rng.integers(len(range_.words)))]
    return float(rng.uniform(range_.low, range_.high)) if range_.high > range_.low else range_.low
