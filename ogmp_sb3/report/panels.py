"""The jobs of a sweep, grouped for pictures: panels of lines, and a line for the runs that differ in the seed alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ogmp_sb3.evaluation.statistics import estimate
from ogmp_sb3.runs.logs import STEP_COLUMN
from ogmp_sb3.runs.multirun import SEED, setting, swept_keys
from ogmp_sb3.runs.run_directory import Run

FIRST_CHOICE = ("rho", "horizon")  # what lines differ in, if it was swept


@dataclass(frozen=True)
class Line:
    """Runs that differ in nothing but the seed."""

    value: Any
    """of the key that the lines of a panel differ in; where that is the seed, all of them"""
    runs: list[Run]
    """one for each seed"""

    @property
    def seeds(self) -> list[str]:
        """The seeds of the runs."""
        return [shown(setting(run, SEED)) for run in self.runs]


@dataclass(frozen=True)
class Panel:
    """Lines that differ in one key."""

    title: str
    """the values of all other keys; empty if there are none"""
    lines: list[Line]
    """numbers by size, then words in the order of the command line, then null: no bound is the widest"""


@dataclass(frozen=True)
class Sweep:
    """The jobs of a sweep, grouped."""

    jobs: list[Run]
    """all of them"""
    keys: list[str]
    """the keys they differ in"""
    line_key: str
    """the key that the lines of a panel differ in"""
    panels: list[Panel]
    """one for each combination of the other keys but the seed"""


def sweep_of(jobs: list[Run]) -> Sweep:
    """Group the jobs of a sweep; jobs that were never started have no line, and the same training counts once.

    Lines differ in rho, else in the horizon, else in the first key with numbers, else in the first key. Jobs that
    differ in the seed alone are one line.
    """
    keys = swept_keys(jobs)
    grouping = [key for key in keys if key != SEED]
    numeric = [key for key in grouping if all(_is_number(setting(job, key)) for job in jobs)]
    line_key = next(iter([*(k for k in FIRST_CHOICE if k in grouping), *numeric, *grouping]), SEED)
    others = [key for key in grouping if key != line_key]
    groups: dict[str, dict[str, Line]] = {}
    seeds = ", ".join(dict.fromkeys(shown(setting(job, SEED)) for job in jobs if job.config))
    for job in jobs:
        if not job.config:
            continue
        lines = groups.setdefault(label_of(job, others), {})
        value = setting(job, line_key) if grouping else seeds
        line = lines.setdefault(str(value), Line(value, []))
        if job.fingerprint not in {other.fingerprint for other in line.runs}:
            line.runs.append(job)
    panels = [
        Panel(title, sorted(lines.values(), key=lambda line: _order(line.value))) for title, lines in groups.items()
    ]
    return Sweep(jobs, keys, line_key, panels)


def label_of(job: Run, keys: list[str]) -> str:
    """The values of some keys of a job: ``oracle=lqr, rho=0.3``."""
    return ", ".join(f"{key}={shown(setting(job, key))}" for key in keys)


def shown(value: Any) -> str:
    """A value as it is written on a command line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {shown(inner)}" for key, inner in value.items()) + "}"
    return "null" if value is None else str(value)


def brief(value: Any) -> str:
    """A value as a label in a picture; a mapping by its changes (``no clock, no height_scan``)."""
    if not isinstance(value, dict):
        return shown(value)
    changes = (f"no {key}" if inner is None else f"{key}: {brief(inner)}" for key, inner in value.items())
    return ", ".join(changes) or "unchanged"


def jobs_along(key: str, jobs: list[Run], keys: list[str], score: Callable[[Run], Sequence[float]]) -> list[Run]:
    """Jobs that differ in one key alone, one for each of its values.

    Of all such groups it is the largest, and of equally large ones that with the best mean score.

    :param key: the key they differ in
    :param jobs: the jobs to choose from
    :param keys: the keys that these differ in
    :param score: of a job; its first number counts first
    """
    others = [other for other in keys if other != key]
    groups: dict[str, dict[str, Run]] = {}
    for job in jobs:
        groups.setdefault(label_of(job, others), {}).setdefault(shown(setting(job, key)), job)
    candidates = [list(group.values()) for group in groups.values()]
    best = max(candidates, key=lambda group: (len(group), *np.mean([score(job) for job in group], axis=0)), default=[])
    return sorted(best, key=lambda job: _order(setting(job, key)))


def mean_curve(runs: list[Run], column: str) -> dict[str, np.ndarray]:
    """A column of the logs over samples: its mean over the runs, which differ in the seed, and the interval of that.

    :param runs: one run gives its rows as they are; several are compared at the rows of the longest, at each those
        that have got so far
    :return: ``samples``; ``seeds``, how many have got so far; their ``mean``; ``low`` and ``high``, the ends of
        Student's 95 % interval over seeds, nan where there is none: of one. Each of shape (n,)
    """
    logs = [run.log for run in runs if column in run.log and len(run.log[column])]
    if not logs:
        return {name: np.array([]) for name in ("samples", "seeds", "mean", "low", "high")}
    samples = max((log[STEP_COLUMN] for log in logs), key=lambda steps: float(steps[-1]))
    curves = [np.interp(samples, log[STEP_COLUMN], log[column], left=np.nan, right=np.nan) for log in logs]
    there = [values[np.isfinite(values)] for values in np.stack(curves, axis=1)]
    found = [estimate(values) if len(values) else None for values in there]
    bands = {
        name: np.array([None if each is None else getattr(each, name) for each in found], dtype=float)  # None: nan
        for name in ("mean", "low", "high")
    }
    return {"samples": samples, "seeds": np.array([len(values) for values in there]), **bands}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _order(value: Any) -> tuple[int, float]:
    """Sort key of a value: numbers by size, then words in their order, then null."""
    if _is_number(value):
        return 0, float(value)
    return (2, 0.0) if value is None else (1, 0.0)
