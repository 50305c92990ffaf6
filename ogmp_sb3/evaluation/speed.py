"""How fast modes along a track ask the robot to be, and how fast it is.

The command of a control step is the heading speed of the set-points at the place where the step begins: what the mode
asks for, not what the oracle plans from wherever the robot is. The speed is averaged over a stretch of at most a second
before the two are compared, since a robot that keeps a pace exactly is faster and slower within every hop. Isaac Lab
and mjlab average the error of every step instead (``error_vel_xy`` of their velocity commands), which counts that as
well. As there, starting from rest and going over to another speed are part of it. What lies behind the end of a track
is not.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.evaluation.statistics import Estimate, as_text, estimate
from ogmp_sb3.guidance.set_points import END, FOREVER, SPAN_SIZE, VX, append_spans, span_row

BAND = 0.2  # m/s: commanded speeds that a row of a table is about, where those of a mode differ by more
LONGEST = 1.0  # s: some hops, but not so many that running now too fast, now too slowly would make up for each other
ROUNDING = 1e-9


class Stretch(NamedTuple):
    """Successive control steps in one mode at one commanded speed, a second at most."""

    mode: str
    """name of the mode that the set-points are of"""
    commanded: float
    """heading speed that the mode asks for, m/s"""
    measured: float
    """way along the track over time, m/s"""
    steps: int
    """control steps"""

    @property
    def error(self) -> float:
        """How far the measured speed is from the commanded one, m/s."""
        return abs(self.measured - self.commanded)


def stretches(record: EpisodeRecord) -> list[Stretch]:
    """What was commanded and measured in an episode, up to the end of the track.

    :return: in order; none for timed modes, which command a place at a time, nor without a step
    """
    calls = record.calls
    segments = [call.segment() for call in calls]
    x = record.base_pos_w[:, 0]
    steps = record.steps
    if record.track_length is not None and (x[:-1] >= record.track_length).any():
        steps = int(np.argmax(x[:-1] >= record.track_length))
    if segments[0].timed or not steps:
        return []
    spans = np.zeros((1 + sum(len(segment.spans) for segment in segments), SPAN_SIZE))
    owner: list[int] = []  # index of the mode of each span
    offset = 0.0
    for i, segment in enumerate(segments):
        rows = np.array([span_row(span, offset) for span in segment.spans])
        append_spans(spans, len(owner), rows, -FOREVER)
        owner += [i] * len(rows)
        offset += segment.length
    here = np.searchsorted(spans[: len(owner), END], x[:steps], side="right").clip(max=len(owner) - 1)
    modes = [calls[owner[i]].name for i in here]
    speed = spans[here, VX]
    changes = [k for k in range(1, steps) if (modes[k], speed[k]) != (modes[k - 1], speed[k - 1])]
    most = max(1, round(LONGEST / record.control_dt))
    ends = [0]
    for start, end in itertools.pairwise([0, *changes, steps]):
        parts = -(-(end - start) // most)
        ends += [start + (end - start) * (part + 1) // parts for part in range(parts)]
    return [
        Stretch(modes[k], float(speed[k]), float(x[end] - x[k]) / ((end - k) * record.control_dt), end - k)
        for k, end in itertools.pairwise(ends)
    ]


def mean_over_steps(parts: Iterable[Stretch], number: Callable[[Stretch], float]) -> float:
    """The mean of a number of some stretches, each weighted by its control steps."""
    parts = list(parts)
    return float(np.average([number(part) for part in parts], weights=[part.steps for part in parts]))


@dataclass(frozen=True)
class SpeedRow:
    """How well the commanded speeds of a mode are followed; a number of an episode is a mean over its control steps."""

    mode: str
    """name of the mode"""
    band: tuple[float, float] | None
    """only speeds from the first up to the second, m/s; None: all of the mode's"""
    commanded: Estimate
    """m/s, over the episodes with such a command"""
    measured: Estimate
    """m/s"""
    error: Estimate
    """distance of the measured speed of each stretch from the commanded one, m/s"""

    @property
    def title(self) -> str:
        """What the row is about, as the first cell of a table."""
        return self.mode if self.band is None else f"  {as_text(self.band, 1, ' to ')}"

    def as_data(self) -> dict[str, Any]:
        """Plain data, as in JSON files."""
        numbers = {name: getattr(self, name).as_data() for name in ("commanded", "measured", "error")}
        return {"mode": self.mode, "band": None if self.band is None else list(self.band), **numbers}

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> SpeedRow:
        """The row that :meth:`as_data` gave.

        :raises KeyError: if something is missing
        """
        numbers = (Estimate.from_data(data[name]) for name in ("commanded", "measured", "error"))
        return cls(data["mode"], None if data["band"] is None else tuple(data["band"]), *numbers)


def speed_rows(records: list[EpisodeRecord]) -> list[SpeedRow]:
    """Commanded and measured speed in each mode, and in bands of commanded speeds where those of a mode differ.

    :return: none for timed modes
    """
    episodes = [stretches(record) for record in records]
    rows = []
    for mode in sorted({part.mode for parts in episodes for part in parts}):
        of_mode = [[part for part in parts if part.mode == mode] for parts in episodes]
        rows.append(_row(mode, None, of_mode))
        bands = sorted({_band(part.commanded) for parts in of_mode for part in parts})
        for band in bands if len(bands) > 1 else []:
            within = [[part for part in parts if _band(part.commanded) == band] for parts in of_mode]
            rows.append(_row(mode, (round(band * BAND, 6), round((band + 1) * BAND, 6)), within))
    return rows


def _band(speed: float) -> int:
    return int(np.floor(speed / BAND + ROUNDING))


def _row(mode: str, band: tuple[float, float] | None, episodes: list[list[Stretch]]) -> SpeedRow:
    """One row from the stretches of each episode; episodes without one do not count."""
    some = [parts for parts in episodes if parts]
    return SpeedRow(
        mode,
        band,
        commanded=estimate(mean_over_steps(parts, lambda part: part.commanded) for parts in some),
        measured=estimate(mean_over_steps(parts, lambda part: part.measured) for parts in some),
        error=estimate((mean_over_steps(parts, lambda part: part.error) for parts in some), (0.0, None)),
    )
