"""Grids over two parameters of one mode, in and out of the range that was trained on (paper, fig:mpt)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ogmp_sb3.course import room
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.ranges import Range
from ogmp_sb3.registry import did_you_mean
from ogmp_sb3.schema import GREATEST

POINTS = 7  # of an axis, if not given
MAX_POINTS = 100  # of an axis


@dataclass(frozen=True)
class Grid:
    """Values of two parameters of one mode."""

    mode: str
    """name of the mode"""
    axes: tuple[str, str]
    """the two parameters"""
    values: tuple[np.ndarray, np.ndarray]
    """their values, each of shape (n,)"""
    trained: dict[str, list[float]]
    """the range of each parameter in training"""

    @property
    def cells(self) -> list[dict[str, float]]:
        """Every combination, the second parameter running faster."""
        first, second = self.axes
        return [{first: float(a), second: float(b)} for a in self.values[0] for b in self.values[1]]

    def as_data(self, metrics: list[dict[str, Any]]) -> dict[str, Any]:
        """Plain data for ``metrics.json``: the grid with the metrics of each cell, in the order of :attr:`cells`."""
        cells = [{**cell, "metrics": found} for cell, found in zip(self.cells, metrics, strict=True)]
        return {"mode": self.mode, "axes": list(self.axes), "trained": self.trained, "cells": cells}


def read_grid(text: str, task: TaskConfig, points: int = POINTS) -> Grid:
    """Read ``jump.w,jump.h`` or ``jump.w:0.1:0.8:8,jump.h``.

    :param points: of an axis that does not say how many; it spans half a range beyond both ends, and no less than
        half the least value
    :raises ValueError: if it does not have this form
    :raises KeyError: for an unknown mode or parameter
    """
    axes = [_axis(part, task, points) for part in text.split(",")]
    if len(axes) != 2 or axes[0][0] != axes[1][0]:
        raise ValueError(f"'grid' needs two parameters of one mode, e.g. jump.w,jump.h; found '{text}'.")
    (mode, first, first_values), (_, second, second_values) = axes
    ranges = task.mode_ranges[mode]
    trained = {key: [ranges[key].low, ranges[key].high] for key in (first, second)}
    return Grid(mode, (first, second), (first_values, second_values), trained)


def _axis(text: str, task: TaskConfig, points: int) -> tuple[str, str, np.ndarray]:
    """Mode, parameter and values of one axis."""
    name, *limits = text.split(":")
    mode, _, parameter = name.partition(".")
    if mode not in task.mode_ranges:
        raise KeyError(f"grid: unknown mode '{mode}'{did_you_mean(mode, task.mode_ranges)}")
    ranges = task.mode_ranges[mode]
    if parameter not in ranges or ranges[parameter].words:
        numbers = [key for key, range_ in ranges.items() if not range_.words]
        raise KeyError(f"grid: mode '{mode}' has no number '{parameter}'{did_you_mean(parameter, numbers)}")
    range_ = ranges[parameter]
    try:
        low, high, points = float(limits[0]), float(limits[1]), int(limits[2])
    except IndexError:
        if limits:
            raise ValueError(f"grid: '{text}' must be mode.parameter or mode.parameter:low:high:points.") from None
        low, high = range_.beyond()
    except ValueError:
        raise ValueError(f"grid: '{text}' must be mode.parameter or mode.parameter:low:high:points.") from None
    if not (0.0 <= low <= high <= GREATEST and 1 <= points <= MAX_POINTS):
        raise ValueError(f"grid: '{text}' needs 0 <= low <= high and 1 to {MAX_POINTS} points.")
    return mode, parameter, np.round(np.linspace(low, high, points), 4)


def default_grids(task: TaskConfig, points: int = POINTS) -> list[Grid]:
    """A grid for every mode with two ranges: over the first two."""
    grids = []
    for mode, ranges in task.mode_ranges.items():
        varied = [key for key, range_ in ranges.items() if range_.high > range_.low]
        if len(varied) >= 2:
            grids.append(read_grid(f"{mode}.{varied[0]},{mode}.{varied[1]}", task, points))
    return grids


def cell_task(task: TaskConfig, mode: str, values: dict[str, float]) -> TaskConfig:
    """The task with some parameters of a mode fixed, and no other mode where modes follow each other at random.

    There is room for all the terrain, however short the mode is then.
    """
    ranges = {**task.mode_ranges[mode], **{key: Range(value, value) for key, value in values.items()}}
    weights = {name: float(name == mode) for name in task.mode_ranges}
    cell = replace(task, modes={**task.modes, mode: ranges}, sampling=replace(task.sampling, weights=weights))
    return replace(cell, track=replace(task.track, boxes=max(task.track.boxes, room(cell)[0])))
