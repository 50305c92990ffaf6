"""Where robots fall: by the mode that was under way, by the size of what it asked for, and by the mode before it.

An instance of a mode counts if it is known how it ended: the base got to its end, or the episode ended by a fall in it.
The one in which an episode ends by its time limit is left out. Where the base is at the end of the episode decides
which instance it fell in (in timed modes, the time). A robot that stumbles over a block, or lands badly, may come down
some steps behind it, in the next mode. So an instance also has whether the robot fell in the one right behind it.

A fall is here, as in ``no_fall_fraction``, whatever ends an episode before its time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.evaluation.analysis import Report, Request
from ogmp_sb3.evaluation.copies import copies_text, distinct
from ogmp_sb3.evaluation.episodes import Progress, play_episodes
from ogmp_sb3.evaluation.metrics import no_fall_fraction
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.evaluation.statistics import Estimate, as_text, estimate
from ogmp_sb3.guidance.sampling import ModeCall

BINS = 4  # of a parameter
BEFORE = "mode before"  # what rows are by that are not by a parameter
START, BEHIND = "(start)", "(behind the track)"  # in place of a mode: what lies before the first, and behind the last


class Passage(NamedTuple):
    """An instance of a mode in an episode that is known to have been passed, or not."""

    call: ModeCall
    """the mode with its parameters"""
    before: str
    """name of the mode before it"""
    fell: bool
    """whether the episode ended by a fall in it"""
    fell_behind: bool
    """whether it ended by a fall in the instance right behind it"""


def passages(record: EpisodeRecord) -> list[Passage]:
    """The instances of modes in an episode, in order; the flat ground behind a track is one, :data:`BEHIND`."""
    calls = record.calls
    segments = [call.segment() for call in calls]
    behind = len(calls)  # index of the first that is no mode of the task
    if segments[0].timed:
        under_way = max(int((record.phase[1:] == 1).sum()) - 1, 0)
        passed = np.arange(len(calls)) < under_way
    else:
        x = record.base_pos_w[:, 0]
        ends = np.cumsum([segment.length for segment in segments])
        under_way = min(int(np.searchsorted(ends, x[-1], side="right")), len(calls) - 1)
        passed = ends <= x.max()
        if record.track_length is not None:
            behind = 1 + int(np.searchsorted(ends, record.track_length, side="left"))
    fell = not no_fall_fraction(record)
    here = [fell and i == under_way for i in range(len(calls) + 1)]
    names = [START, *(call.name for call in calls)]
    found = [Passage(*each) for each in zip(calls, names, here, here[1:], strict=False)]
    found = [each for i, each in enumerate(found[:behind]) if passed[i] or here[i]]
    if behind < len(calls) and passed[behind - 1]:
        found.append(Passage(ModeCall(BEHIND, {}), names[behind], fell and under_way >= behind, False))
    return found


@dataclass(frozen=True)
class FallRow:
    """In how many instances of a mode robots fell, and out of how many."""

    mode: str
    """name of the mode"""
    by: str
    """the parameter whose values the row is about, :data:`BEFORE`, or nothing: all instances of the mode"""
    value: tuple[float, float] | str | None
    """from the first value up to the second, in the parameter's unit; or a word; None: all"""
    falls: int
    """instances in which a robot fell"""
    falls_behind: int
    """instances that a robot passed and fell right behind, in the next one"""
    share: Estimate
    """of the instances, with Wilson's interval; ``n`` is how many there are"""

    @property
    def title(self) -> str:
        """The value, as a cell of a table."""
        return as_text(self.value, 2, " to ") if isinstance(self.value, tuple) else self.value or ""

    def as_data(self) -> dict[str, Any]:
        """Plain data, as in JSON files."""
        value = list(self.value) if isinstance(self.value, tuple) else self.value
        return {**vars(self), "value": value, "share": self.share.as_data()}

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> FallRow:
        """The row that :meth:`as_data` gave.

        :raises KeyError: if something is missing
        """
        value = tuple(data["value"]) if isinstance(data["value"], list) else data["value"]
        return cls(**{**data, "value": value, "share": Estimate.from_data(data["share"])})


def fall_rows(task: TaskConfig, records: Iterable[EpisodeRecord]) -> list[FallRow]:
    """Falls by mode; within each, by every parameter that varies, and by the mode before it.

    :param task: its ranges are cut into :data:`BINS` sizes of equal width; sizes without an instance have no row
    """
    found = [passage for record in records for passage in passages(record)]
    rows = []
    for mode in sorted({passage.call.name for passage in found}, key=lambda name: (name == BEHIND, name)):
        of_mode = [passage for passage in found if passage.call.name == mode]
        rows.append(_row(mode, "", None, of_mode))
        for key in dict.fromkeys(key for passage in of_mode for key in passage.call.parameters):
            having = [passage for passage in of_mode if key in passage.call.parameters]
            rows += [_row(mode, key, value, some) for value, some in _by_size(task, mode, key, having)]
        befores = sorted({passage.before for passage in of_mode})
        for before in befores if len(befores) > 1 and mode != BEHIND else []:
            rows.append(_row(mode, BEFORE, before, [passage for passage in of_mode if passage.before == before]))
    return rows


def _row(mode: str, by: str, value: tuple[float, float] | str | None, some: list[Passage]) -> FallRow:
    falls, behind = (sum(getattr(passage, name) for passage in some) for name in ("fell", "fell_behind"))
    return FallRow(mode, by, value, falls, behind, estimate(passage.fell for passage in some))


def _by_size(
    task: TaskConfig, mode: str, key: str, some: list[Passage]
) -> list[tuple[tuple[float, float] | str, list[Passage]]]:
    """Instances of a mode by the value of a parameter: by its words or sizes; none if all have the same."""
    values = [passage.call.parameters[key] for passage in some]
    if len(set(values)) == 1:
        return []
    if any(isinstance(value, str) for value in values):
        words = sorted(set(map(str, values)))
        return [(word, [p for p, value in zip(some, values, strict=True) if value == word]) for word in words]
    numbers, drawn = np.array(values, dtype=float), task.mode_ranges.get(mode, {}).get(key)
    reach = [*numbers, *([] if drawn is None else [drawn.low, drawn.high])]
    edges = np.linspace(min(reach), max(reach), BINS + 1)
    sizes = np.searchsorted(edges[1:-1], numbers, side="right")
    bins = [
        ((float(edges[k]), float(edges[k + 1])), [some[i] for i in np.flatnonzero(sizes == k)]) for k in range(BINS)
    ]
    return [(ends, members) for ends, members in bins if members]


def measure_falls(request: Request, progress: Progress) -> Report:
    """Where the robot fell in a set of episodes: ``falls``, rows as :func:`fall_rows` gives them."""
    played = play_episodes(
        request.policy, request.task, request.episodes, request.seed, request.max_distance, progress
    )  # fmt: skip
    records = distinct(played)
    rows = [row.as_data() for row in fall_rows(request.task, records)]
    return {"falls": rows, "copies": len(played) - len(records)}


def falls_of(report: Report) -> list[FallRow]:
    """The rows of a report.

    :param report: of :func:`measure_falls`, or of an evaluation
    """
    return [FallRow.from_data(row) for row in report["falls"]]


def falls_csv(rows: Iterable[FallRow]) -> list[dict[str, Any]]:
    """The rows as a table for a file."""
    return [
        {
            "mode": row.mode, "by": row.by,
            "from": row.value[0] if isinstance(row.value, tuple) else None,
            "to": row.value[1] if isinstance(row.value, tuple) else None,
            "word": row.value if isinstance(row.value, str) else None,
            "instances": row.share.n, "falls": row.falls, "rate": row.share.mean,
            "ci95_low": row.share.low, "ci95_high": row.share.high, "falls_behind": row.falls_behind,
        }
        for row in rows
    ]  # fmt: skip


def kinds_of(rows: Sequence[FallRow]) -> list[tuple[str, list[FallRow]]]:
    """The rows of each table: by mode, by size, by the mode before; each with its title."""
    kinds: list[tuple[str, Callable[[FallRow], bool]]] = [
        ("falls by mode", lambda row: row.by == ""),
        ("falls by size", lambda row: row.by not in ("", BEFORE)),
        ("falls by the mode before", lambda row: row.by == BEFORE),
    ]
    tables = [(title, [row for row in rows if belongs(row)]) for title, belongs in kinds]
    return [(title, some) for title, some in tables if some]


def falls_tables(report: Report) -> Group:
    """What :func:`measure_falls` found, as Rich prints it."""
    rows = falls_of(report)
    tables = [_table(title, some) for title, some in kinds_of(rows)]
    fallen = sum(row.falls for row in rows if not row.by)
    counted = report["episodes"] - report["copies"]
    copies = copies_text(report["copies"], report["episodes"])
    text = f"{fallen} of {counted} episodes ended by a fall. Intervals are Wilson's, over instances. 'Right behind': "
    text += f"passed, but the robot fell in the next mode. {copies}"
    return Group(*tables, Text(text.rstrip()))


def _table(title: str, rows: list[FallRow]) -> Table:
    """One table; what stands in the cells of the row above is left out."""
    labels: dict[str, Callable[[FallRow], str]] = {"mode": lambda row: row.mode}
    if rows[0].by == BEFORE:
        labels["after"] = lambda row: row.title
    elif rows[0].by:
        labels |= {"parameter": lambda row: row.by, "size": lambda row: row.title}
    table = Table(title=title, title_justify="left")
    for column in (*labels, "instances", "falls", "rate", "95 % interval", "right behind"):
        table.add_column(column, justify="left" if column in labels else "right")
    above: list[str] = []
    for row in rows:
        cells = [label(row) for label in labels.values()]
        same = 0 if cells[:1] != above[:1] else 1 if cells[:2] != above[:2] else 2
        above = cells
        numbers = [str(row.share.n), str(row.falls), as_text([row.share.mean])]
        numbers += [as_text([row.share.low, row.share.high], 3, " .. "), str(row.falls_behind)]
        table.add_row(*([""] * same), *cells[same:], *numbers)
    return table
