"""Grids over two parameters of one mode, in and out of the range that was trained on (paper, fig:mpt)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.strict import GREATEST
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import AnyPolicy
from ogmp_sb3.evaluation.analysis import Report, Request
from ogmp_sb3.evaluation.copies import copies_in_sets_text, distinct
from ogmp_sb3.evaluation.episodes import Progress, play_sets
from ogmp_sb3.evaluation.evaluate import estimates
from ogmp_sb3.evaluation.statistics import Estimates, estimates_as_data
from ogmp_sb3.guidance.course import extent

CELLS = 8  # along an axis, if not given: two on either side of the training range, four in it
MAX_CELLS = 100  # along an axis
CELL_EPISODES = 10  # of each cell, if not given

ModeCell = tuple[str, dict[str, Range]]  # a mode, and the ranges of its parameters in one of the cells


@dataclass(frozen=True)
class Grid:
    """Cells over two parameters of one mode."""

    mode: str
    """name of the mode"""
    axes: tuple[str, str]
    """the two parameters"""
    edges: tuple[np.ndarray, np.ndarray]
    """the borders between cells along each axis, of shape (cells + 1,)"""
    trained: dict[str, list[float]]
    """the range of each parameter in training; empty if there was no such parameter"""

    @property
    def cells(self) -> list[dict[str, Range]]:
        """The ranges of the two parameters in every cell, the second parameter running faster."""
        first, second = ([Range(*pair) for pair in itertools.pairwise(edges.tolist())] for edges in self.edges)
        return [dict(zip(self.axes, ranges, strict=True)) for ranges in itertools.product(first, second)]

    def as_data(self, metrics: list[dict[str, Any]]) -> dict[str, Any]:
        """Plain data for ``grid.json``: the grid with the metrics of each cell.

        :param metrics: of each cell, as plain data, in the order of :attr:`cells`
        """
        cells = [{**limits(cell), "metrics": data} for cell, data in zip(self.cells, metrics, strict=True)]
        return {"mode": self.mode, "axes": list(self.axes), "trained": self.trained, "cells": cells}


def limits(cell: dict[str, Range]) -> dict[str, list[float]]:
    """A cell as plain data: the ends of each range."""
    return {key: [range_.low, range_.high] for key, range_ in cell.items()}


def read_grid(text: str, task: TaskConfig, trained: TaskConfig, cells: int = CELLS) -> Grid:
    """Read ``jump.w,jump.h`` or ``jump.w:0.1:0.8:8,jump.h``.

    :param task: the task of the test, whose ranges the axes span
    :param trained: the task as it was in training
    :param cells: along an axis that does not say how many; it spans half a range beyond both ends, and no less than
        half the least value
    :raises ValueError: if it does not have this form
    :raises KeyError: for an unknown mode or parameter
    """
    axes = [_axis(part, task, cells) for part in text.split(",")]
    if len(axes) != 2 or axes[0][0] != axes[1][0] or axes[0][1] == axes[1][1]:
        raise ValueError(f"'grid' needs two parameters of one mode, e.g. jump.w,jump.h; found '{text}'.")
    (mode, first, first_edges), (_, second, second_edges) = axes
    if not {first, second} <= set(free_parameters(task, mode)):
        raise ValueError(
            f"'grid': where '{mode}' comes, if at all, the sequence of modes says what its parameters are."
        )
    ranges = trained.mode_ranges.get(mode, {})
    known = {first, second} <= ranges.keys()
    spans = limits({key: ranges[key] for key in (first, second)}) if known else {}
    return Grid(mode, (first, second), (first_edges, second_edges), spans)


def _axis(text: str, task: TaskConfig, cells: int) -> tuple[str, str, np.ndarray]:
    """Mode, parameter and the borders between cells of one axis."""
    name, *numbers = text.split(":")
    mode, _, parameter = name.partition(".")
    if mode not in task.mode_ranges:
        raise KeyError(f"grid: unknown mode '{mode}'{did_you_mean(mode, task.mode_ranges)}")
    ranges = task.mode_ranges[mode]
    if parameter not in ranges or ranges[parameter].words:
        varied = [key for key, range_ in ranges.items() if not range_.words]
        raise KeyError(f"grid: mode '{mode}' has no number '{parameter}'{did_you_mean(parameter, varied)}")
    range_ = ranges[parameter]
    try:
        low, high, cells = float(numbers[0]), float(numbers[1]), int(numbers[2])
    except IndexError:
        if numbers:
            raise ValueError(f"grid: '{text}' must be mode.parameter or mode.parameter:low:high:cells.") from None
        low, high = range_.beyond()
    except ValueError:
        raise ValueError(f"grid: '{text}' must be mode.parameter or mode.parameter:low:high:cells.") from None
    if not (0.0 <= low < high <= GREATEST and 1 <= cells <= MAX_CELLS):
        raise ValueError(f"grid: '{text}' needs 0 <= low < high and 1 to {MAX_CELLS} cells.")
    return mode, parameter, np.round(np.linspace(low, high, cells + 1), 6)


def free_parameters(task: TaskConfig, mode: str) -> list[str]:
    """The parameters of a mode that its ranges decide on: none if it never comes, and none that a sequence gives."""
    entries = [entry for entry in task.sampling.sequence if entry.mode == mode]
    if task.sampling.order == "sequence" and not entries:
        return []
    return [key for key in task.mode_ranges[mode] if not any(key in entry.ranges for entry in entries)]


def default_grids(task: TaskConfig, trained: TaskConfig, cells: int = CELLS) -> list[Grid]:
    """A grid for every mode with two ranges: over the first two.

    The parameters are those of :func:`read_grid`, and so are the errors.

    :return: none for a task without such a mode
    """
    grids = []
    for mode, ranges in task.mode_ranges.items():
        varied = [key for key in free_parameters(task, mode) if ranges[key].high > ranges[key].low]
        if len(varied) >= 2:
            grids.append(read_grid(f"{mode}.{varied[0]},{mode}.{varied[1]}", task, trained, cells))
    return grids


def cell_task(task: TaskConfig, mode: str, cell: dict[str, Range]) -> TaskConfig:
    """The task with other ranges of a mode's parameters, and no other mode where modes follow each other at random.

    There is room for all the terrain, however short the mode is then.

    :param mode: one of the task's
    :param cell: parameter -> range, one of :attr:`Grid.cells`
    """
    ranges = {**task.mode_ranges[mode], **cell}
    weights = {name: float(name == mode) for name in task.mode_ranges}
    task = replace(task, modes={**task.modes, mode: ranges}, sampling=replace(task.sampling, weights=weights))
    return replace(task, track=replace(task.track, boxes=max(task.track.boxes, extent(task).boxes)))


def evaluate_cells(
    policy: AnyPolicy,
    task: TaskConfig,
    cells: Sequence[ModeCell],
    episodes: int,
    seed: int,
    progress: Progress | None = None,
) -> Iterator[Estimates]:
    """The metrics of cells, each on tracks of that cell alone, over episodes that are no copies of others.

    :param task: under the protocol wanted
    :param cells: of one grid or of several
    :param episodes: of each cell; the rest as for :func:`~ogmp_sb3.evaluation.episodes.play_episodes`
    :return: of each cell in order, as soon as it is known
    """
    tasks = [cell_task(task, mode, cell) for mode, cell in cells]
    played = play_sets(policy, tasks, episodes, seed, progress=progress)
    for cell_of, records in zip(tasks, played, strict=True):
        yield estimates(cell_of, distinct(records))


def requested_grid(request: Request) -> Grid:
    """The grid that ``grid=jump.w,jump.h`` asks for; the errors are those of :func:`read_grid`."""
    return read_grid(request.value, request.task, request.trained_task)


def count_cells(request: Request) -> int:
    """How many sets of episodes a grid takes."""
    return len(requested_grid(request).cells)


def measure_grid(request: Request, progress: Progress) -> Report:
    """The metrics of every cell: ``grid``, see :meth:`Grid.as_data`."""
    grid = requested_grid(request)
    policy, task, episodes, seed = request.policy, request.task, request.episodes, request.seed
    metrics = evaluate_cells(policy, task, [(grid.mode, cell) for cell in grid.cells], episodes, seed, progress)
    return {"grid": grid.as_data(list(map(estimates_as_data, metrics)))}


def grid_copies_text(grid: dict[str, Any], episodes: int) -> str:
    """A sentence on episodes that are copies of others; empty if there are none.

    :param grid: of :meth:`Grid.as_data`
    :param episodes: that were played in each cell
    """
    return copies_in_sets_text((cell["metrics"]["true_objective"]["n"] for cell in grid["cells"]), episodes, "cells")
