"""What the section on an evaluation says of commanded and measured speed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ogmp_sb3.evaluation.speed import BAND, SpeedRow
from ogmp_sb3.evaluation.statistics import Estimate, as_text
from ogmp_sb3.report.page import Picture, Rows, Table, make_picture
from ogmp_sb3.report.plots.evaluations import plot_speeds

DASH = "\N{NARROW NO-BREAK SPACE}…\N{NARROW NO-BREAK SPACE}"


def speed_parts(speeds: Sequence[SpeedRow], out: Path) -> list[Table | Picture]:
    """A picture and a table of commanded and measured speed; nothing where modes take a time."""
    if not speeds:
        return []
    caption = (
        "Measured against commanded speed along the track: means over the episodes with 95 % intervals, in bands of "
        f"{BAND:g} m/s where the commanded speeds of a mode differ. On the dotted line the command is followed."
    )
    picture = make_picture(out, "speeds", caption, speed_csv(speeds), lambda path: plot_speeds(speeds, path))
    rows = [
        [row.title, as_text([row.commanded.mean], 2), _cell(row.measured), _cell(row.error), str(row.error.n)]
        for row in speeds
    ]
    caption = (
        "Speed along the track by mode, m/s. The error is the distance of the speed, averaged over stretches of a "
        "second at most, from the commanded one; n counts the episodes with such a command."
    )
    return [picture, Table(rows, ["mode", "commanded", "measured", "error", "n"], caption)]


def _cell(estimate: Estimate) -> str:
    return f"{estimate.mean:.2f} [{as_text([estimate.low, estimate.high], 2, DASH)}]"


def speed_csv(speeds: Sequence[SpeedRow]) -> Rows:
    """Commanded and measured speeds as a table for a file; a row of a whole mode has no ends."""
    return [
        {
            "mode": row.mode, "from": None if row.band is None else row.band[0],
            "to": None if row.band is None else row.band[1], "commanded": row.commanded.mean,
            "measured": row.measured.mean, "measured_low": row.measured.low, "measured_high": row.measured.high,
            "error": row.error.mean, "error_low": row.error.low, "error_high": row.error.high, "n": row.error.n,
        }
        for row in speeds
    ]  # fmt: skip
