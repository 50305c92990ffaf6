"""The weakest point of a policy: many draws from the box of all disturbances at once, and the worst of them again.

One disturbance at a time (:mod:`ogmp_sb3.evaluation.robustness`) does not show what several do together. Here the
points fill the box evenly (a scrambled Sobol sequence); a few tracks each tell which are bad, and the worst ones are
played again on other tracks, so that how bad they are is not told by the tracks that they were chosen for.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ogmp_sb3.config import registry
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.task import RandomisationTerms, TaskConfig
from ogmp_sb3.evaluation.analysis import Report, Request
from ogmp_sb3.evaluation.copies import distinct
from ogmp_sb3.evaluation.episodes import Progress, play_sets
from ogmp_sb3.evaluation.metrics import no_fall_fraction
from ogmp_sb3.evaluation.statistics import Estimate, as_text, estimate

POINTS = 256  # of the box
POINT_EPISODES = 4  # of each, if the user does not say
WORST = 8  # of them are played again
AGAIN = 8  # times as many episodes


@dataclass(frozen=True)
class Axis:
    """One side of the box."""

    term: str
    """name of the randomisation term"""
    parameter: str
    """name of its parameter"""
    low: float
    """least value"""
    high: float
    """greatest value"""

    @property
    def name(self) -> str:
        """As in the task file."""
        return f"{self.term}.{self.parameter}"


def box(task: TaskConfig) -> list[Axis]:
    """The ranges of a task's disturbances.

    :param task: as in training
    :raises ValueError: if there is none
    """
    axes = [
        Axis(term, parameter, range_.low, range_.high)
        for term, ranges in task.randomised.items()
        for parameter, range_ in ranges.items()
        if range_.high > range_.low and parameter not in registry.randomisations.not_sizes(term)
    ]
    if not axes:
        raise ValueError(
            f"{task.file}: 'worst_case' looks through the ranges of 'randomisation', and there is none; give some, "
            "e.g. randomisation.friction.coefficient=[0.4,1.2] randomisation.action_delay.delay=[0,0.03]."
        )
    return axes


def disturbed(task: TaskConfig, axes: list[Axis], values: Iterable[float]) -> RandomisationTerms:
    """The disturbances at a point of the box; what is no range stays as the task has it.

    :param values: one for each axis
    """
    point = {term: dict(ranges) for term, ranges in task.randomised.items()}
    for axis, value in zip(axes, values, strict=True):
        point[axis.term][axis.parameter] = Range(float(value), float(value))
    return dict(point)


def count_points(request: Request) -> int:
    """How many sets of episodes are played."""
    box(request.training_task)
    return POINTS + WORST * AGAIN


def measure_worst_case(request: Request, progress: Progress) -> Report:
    """Find the weakest points: ``axes``, ``points`` with the share of tracks without a fall, and ``worst``.

    ``worst`` is told on other tracks, the weakest first. ``influence`` is the rank correlation of each axis with the
    share without a fall (Spearman's), over all points.
    """
    from scipy.stats import qmc, spearmanr

    axes = box(request.training_task)
    unit = qmc.Sobol(len(axes), seed=request.seed).random(POINTS)
    values = qmc.scale(unit, [axis.low for axis in axes], [axis.high for axis in axes])
    first = [share.mean for share in _shares(request, axes, values, request.episodes, request.seed, progress)]
    chosen = np.argsort(first, kind="stable")[:WORST]
    others = request.seed + request.episodes
    again = _shares(request, axes, values[chosen], AGAIN * request.episodes, others, progress)
    order = np.argsort([share.mean for share in again], kind="stable")
    correlated = len(set(first)) > 1
    return {
        "axes": [{"name": axis.name, "range": [axis.low, axis.high]} for axis in axes],
        "points": [
            {"values": row.tolist(), "no_fall_fraction": share} for row, share in zip(values, first, strict=True)
        ],
        "worst": [{"values": values[chosen[i]].tolist(), "no_fall_fraction": again[i].as_data()} for i in order],
        "influence": [float(spearmanr(column, first)[0]) if correlated else 0.0 for column in values.T],
        "no_fall_fraction": estimate(first).as_data(),
    }


def _shares(
    request: Request, axes: list[Axis], values: np.ndarray, episodes: int, seed: int, progress: Progress
) -> list[Estimate]:
    """The share of episodes without a fall at some points."""
    tasks = [replace(request.task, randomisation=disturbed(request.training_task, axes, row)) for row in values]
    played = play_sets(request.policy, tasks, episodes, seed, request.max_distance, progress)
    return [estimate(no_fall_fraction(record) for record in distinct(records)) for records in played]


def worst_case_rows(report: Report) -> list[dict[str, Any]]:
    """One row for each point, those that were played again first.

    :param report: of :func:`measure_worst_case`
    """
    names = [axis["name"] for axis in report["axes"]]
    rows: list[dict[str, Any]] = []
    for again, points in ((True, report["worst"]), (False, report["points"])):
        for point in points:
            share = point["no_fall_fraction"]
            mean = share["mean"] if again else share
            rows.append({**dict(zip(names, point["values"], strict=True)), "again": again, "no_fall_fraction": mean})
    return rows


def worst_case_tables(report: Report) -> Group:
    """What :func:`measure_worst_case` found, as Rich prints it."""
    weakest = report["worst"][0]
    share = Estimate.from_data(weakest["no_fall_fraction"])
    table = Table(title="the weakest point", title_justify="left")
    for column in ("disturbance", "range", "there", "influence"):
        table.add_column(column, justify="left" if column == "disturbance" else "right")
    for axis, value, influence in zip(report["axes"], weakest["values"], report["influence"], strict=True):
        table.add_row(axis["name"], as_text(axis["range"], 3, " .. "), as_text([value]), f"{influence:+.2f}")
    interval = as_text([share.low, share.high], 3, " .. ")
    text = (
        f"Without a fall there: {share.mean:.3f} ({interval}, n = {share.n}); over the whole box "
        f"{report['no_fall_fraction']['mean']:.3f} ({len(report['points'])} points). Influence: rank correlation with "
        "falling less; negative where more of it makes the robot fall."
    )
    return Group(table, Text(text))
