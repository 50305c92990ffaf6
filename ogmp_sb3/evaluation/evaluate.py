"""Evaluate a policy on a task: metrics with confidence intervals, and what ended the episodes."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from ogmp_sb3.config import registry
from ogmp_sb3.config.answers import answer_text, call
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import AnyPolicy
from ogmp_sb3.env.streams import Stream
from ogmp_sb3.evaluation.copies import copies_text, distinct
from ogmp_sb3.evaluation.episodes import Progress, play_episodes
from ogmp_sb3.evaluation.falls import FallRow, fall_rows
from ogmp_sb3.evaluation.metrics import highest_objective, highest_return, limits_of
from ogmp_sb3.evaluation.own_queries import own_queries
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.evaluation.speed import SpeedRow, speed_rows
from ogmp_sb3.evaluation.statistics import (
    Estimates,
    Limits,
    as_text,
    estimate,
    estimates_as_data,
    estimates_from_data,
)
from ogmp_sb3.evaluation.survival import DISTANCE, TIME, Survival, median_text, survival_curves, survival_table
from ogmp_sb3.guidance.course import extent
from ogmp_sb3.guidance.encoder_training import LatentQuality

PRINTED_WIDTH = 100  # characters
ON_TRACKS = "speed_error_mps"  # a metric of every evaluation of modes along a track, and of no other
TRUE_OBJECTIVE = "true_objective"  # beside the metrics
RETURN = "return"

Values = dict[str, list[float]]  # by name of the metric: of each episode, a bool where it is yes or no


@dataclass(frozen=True)
class Evaluation:
    """What episodes of a policy came to. ``print(evaluation)`` shows the tables of ``ogmp-eval``."""

    metrics: Estimates
    """every metric of the task over all episodes, and the ``true_objective``"""
    groups: dict[str, Estimates]
    """the metrics by the words among the parameters of the first mode, under ``parameter=word``"""
    median_distance_m: float
    """median displacement along the track, m"""
    terminations: dict[str, int]
    """how many episodes each rule ended"""
    title: str = field(default="", compare=False)
    """heading of the first table"""
    speeds: tuple[SpeedRow, ...] = ()
    """how well commanded speeds are followed; none for timed modes, and in evaluations of earlier versions"""
    copies: int = 0
    """how many more episodes were played that are copies of others"""
    latent: LatentQuality | None = None
    """how much the latent keeps of what the policy asked the oracle for; None if it is not observed"""
    falls: tuple[FallRow, ...] = ()
    """in which modes robots fell; none in evaluations of earlier versions"""
    survival: dict[str, Survival] = field(default_factory=dict)
    """share of the episodes that still run over ``distance_m`` and ``time_s``; empty unless tracks have no end"""
    values: Values = field(default_factory=dict)
    """every metric, and the ``true_objective``, of each episode; empty in evaluations of earlier versions"""

    @property
    def episodes(self) -> int:
        """How many episodes were played."""
        return sum(self.terminations.values()) + self.copies

    def as_data(self) -> dict[str, Any]:
        """Plain data, as in ``metrics.json``; without the title."""
        return {
            "metrics": estimates_as_data(self.metrics),
            "groups": {group: estimates_as_data(metrics) for group, metrics in self.groups.items()},
            "median_distance_m": self.median_distance_m,
            "terminations": self.terminations,
            "episodes": self.episodes,
            "copies": self.copies,
            "speeds": [row.as_data() for row in self.speeds],
            **({} if self.latent is None else {"latent": asdict(self.latent)}),
            "falls": [row.as_data() for row in self.falls],
            **({"survival": {name: each.as_data() for name, each in self.survival.items()}} if self.survival else {}),
            "values": self.values,
        }

    @classmethod
    def from_data(cls, data: dict[str, Any], title: str = "") -> Evaluation:
        """The evaluation in plain data, which may hold more than that, or be of an earlier version.

        :param data: of :meth:`as_data`, e.g. what ``metrics.json`` holds
        :raises KeyError: if something is missing
        """
        groups = {group: estimates_from_data(metrics) for group, metrics in data["groups"].items()}
        metrics = estimates_from_data(data["metrics"])
        return cls(
            metrics,
            groups,
            data["median_distance_m"],
            data["terminations"],
            title=title,
            speeds=tuple(map(SpeedRow.from_data, data.get("speeds", []))),
            copies=data.get("copies", 0),
            latent=LatentQuality(**data["latent"]) if "latent" in data else None,
            falls=tuple(map(FallRow.from_data, data.get("falls", []))),
            survival={name: Survival.from_data(each) for name, each in data.get("survival", {}).items()},
            values=data.get("values", {}),
        )

    def __rich__(self) -> Group:
        """The tables, as Rich prints them."""
        ended = ", ".join(f"{cause} {count}" for cause, count in self.terminations.items())
        copies, latent = copies_text(self.copies, self.episodes), self.latent
        return Group(
            _table(self.title, self.metrics),
            *(_table(group, metrics) for group, metrics in self.groups.items()),
            *([_speed_table(self.speeds)] if self.speeds else []),
            *([survival_table(self.survival)] if self.survival else []),
            Text(f"Ended by: {ended}. {self._median()} {copies}".rstrip()),
            *([Text(f"Mode latent, {latent.references:,} references of the policy:\n{latent}.")] if latent else []),
        )

    def _median(self) -> str:
        if not self.survival:
            return f"Median distance {self.median_distance_m:.2f} m."
        distance, time = self.survival[DISTANCE], self.survival[TIME]
        return f"Median distance to a fall: {median_text(distance, 'm')}; time: {median_text(time, 's')}."

    def __str__(self) -> str:
        text = io.StringIO()
        Console(file=text, width=PRINTED_WIDTH, color_system=None).print(self)
        return "\n".join(line.rstrip() for line in text.getvalue().splitlines())


def _table(title: str, metrics: Estimates) -> Table:
    table = Table(title=title, title_justify="left")
    for column in ("metric", "mean", "std", "95 % interval", "n"):
        table.add_column(column, justify="left" if column == "metric" else "right")
    for name, each in metrics.items():
        mean, std, interval = as_text([each.mean]), as_text([each.std]), as_text([each.low, each.high], 3, " .. ")
        table.add_row(name, mean, std, interval, str(each.n))
    return table


def _speed_table(rows: tuple[SpeedRow, ...]) -> Table:
    table = Table(title="speed along the track, m/s", title_justify="left")
    for column in ("mode", "commanded", "measured", "error", "95 % interval", "n"):
        table.add_column(column, justify="left" if column == "mode" else "right")
    for row in rows:
        numbers = [as_text([each.mean], 2) for each in (row.commanded, row.measured, row.error)]
        table.add_row(row.title, *numbers, as_text([row.error.low, row.error.high], 2, " .. "), str(row.error.n))
    return table


def evaluate(
    policy: AnyPolicy,
    task: str | Path | TaskConfig,
    episodes: int = 100,
    seed: int = 0,
    progress: Progress | None = None,
    stream: Stream = "test",
) -> Evaluation:
    """Evaluate a policy by the test protocol of a task, as ``ogmp-eval`` does.

    :param policy: a model, a policy or a loaded policy (:data:`~ogmp_sb3.env.agent.AnyPolicy`)
    :param task: name of a task, path of a task file, or a task; its section ``evaluation`` is the test protocol. For
        episodes of another kind there are :func:`~ogmp_sb3.evaluation.episodes.play_episodes` and :func:`measure`
    :param episodes: how many
    :param seed: episode ``i`` is seeded with ``seed + i``
    :param progress: called with control steps that are done with, of ``episodes`` times the time limit in all
    :param stream: ``"test"`` for numbers that are reported; ``"selection"`` to choose between policies or settings
    :raises KeyError: for an unknown task
    :raises ValueError: if the policy or a metric does not fit the task, or for less than one episode
    """
    if episodes < 1:
        raise ValueError(f"'episodes' must be at least 1, found {episodes}.")
    tested = (task if isinstance(task, TaskConfig) else load_task(task)).for_evaluation()
    metric_names(tested)
    return measure(tested, play_episodes(policy, tested, episodes, seed, progress=progress, stream=stream))


def measure(task: TaskConfig, played: list[EpisodeRecord]) -> Evaluation:
    """The evaluation of episodes that were played; those that are copies of others count once.

    :param task: the task they were played on
    """
    records = distinct(played)
    causes = [record.termination for record in records]
    values = episode_values(task, records)
    return Evaluation(
        metrics=_estimates(task, values),
        groups=estimates_by_word(task, records),
        median_distance_m=float(np.median([registry.metrics.get("distance_m")(record) for record in records])),
        terminations={cause: causes.count(cause) for cause in sorted(set(causes))},
        title=heading(task.name, len(played), task.physics_dt),
        speeds=tuple(speed_rows(records)),
        copies=len(played) - len(records),
        latent=own_queries(task, records),
        falls=tuple(fall_rows(task, records)),
        survival=survival_curves(records),
        values=values,
    )


def heading(task: str, episodes: int, physics_dt: float) -> str:
    """The title of an evaluation.

    :param physics_dt: physics step, s; accelerations depend on it
    """
    return f"{task}, {episodes} episodes, physics step {physics_dt} s"


def metric_names(task: TaskConfig) -> list[str]:
    """The metrics of a task's evaluation: on a track, how far speeds are from what is commanded is always among them.

    :raises ValueError: if that is among the metrics of timed modes, which command no speed, or the horizon is missing
    """
    names = list(task.evaluation.metrics)
    if task.horizon is None and ON_TRACKS in names:
        extent(task)
        raise ValueError(
            f"{task.file}: 'evaluation.metrics' has '{ON_TRACKS}', which is for modes along a track; those of "
            f"'{task.name}' take a time."
        )
    return names if task.horizon is None or ON_TRACKS in names else [*names, ON_TRACKS]


def estimates(task: TaskConfig, records: list[EpisodeRecord]) -> Estimates:
    """Every metric of the task over episodes, with the true objective."""
    return _estimates(task, episode_values(task, records))


def _estimates(task: TaskConfig, values: Values) -> Estimates:
    return {name: estimate(numbers, metric_limits(task, name)) for name, numbers in values.items()}


def episode_values(task: TaskConfig, records: list[EpisodeRecord]) -> Values:
    """Every metric of the task for each episode, with the true objective."""
    values = {name: _values(registry.metrics, name, records) for name in metric_names(task)}
    values[TRUE_OBJECTIVE] = _values(registry.objectives, task.objective, records)
    return {
        name: [bool(number) if isinstance(number, bool | np.bool_) else float(number) for number in numbers]
        for name, numbers in values.items()
    }


def metric_limits(task: TaskConfig, name: str) -> Limits:
    """What a metric, or the true objective, is never below and above."""
    if name == TRUE_OBJECTIVE:
        return None, highest_objective(task)
    if name == RETURN:
        return None, highest_return(task)
    return limits_of(registry.metrics.get(name))


def _values(functions: registry.Registry[Any], name: str, records: list[EpisodeRecord]) -> Iterator[float]:
    """A metric or an objective of each episode.

    :raises FunctionFailed: if its function raises an exception
    :raises TypeError: if it returns anything but a number or a bool
    :raises ValueError: if the number is not finite
    """
    function, title = functions.get(name), f"{functions.kind} '{name}'"
    for record in records:
        value = call(title, function, record)
        if not isinstance(value, bool | int | float | np.integer | np.floating | np.bool_):
            raise TypeError(f"what {title} returns must be a number, or true or false; it is {answer_text(value)}.")
        if not np.isfinite(value):
            raise ValueError(f"what {title} returns must be finite; it is {value:g}.")
        yield value  # type: ignore[misc]


def estimates_by_word(task: TaskConfig, records: list[EpisodeRecord]) -> dict[str, Estimates]:
    """The metrics for each word among the parameters of an episode's first mode (dive: for each direction).

    :return: by ``parameter=word``
    """
    groups: dict[str, list[EpisodeRecord]] = {}
    for record in records:
        for key, value in record.modes[0].items():
            if key != "mode" and isinstance(value, str):
                groups.setdefault(f"{key}={value}", []).append(record)
    return {group: estimates(task, members) for group, members in sorted(groups.items())}
