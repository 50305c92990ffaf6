"""The sections of a report on where robots fall, and on how far they get on tracks without end before they do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ogmp_sb3.evaluation.copies import copies_text
from ogmp_sb3.evaluation.endless import SLOWEST
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy
from ogmp_sb3.evaluation.falls import BINS, FallRow, falls_csv, kinds_of
from ogmp_sb3.evaluation.statistics import as_text
from ogmp_sb3.evaluation.survival import DISTANCE, TIME, Survival, median_text, round_places
from ogmp_sb3.report.page import Part, Rows, Section, Table, make_picture
from ogmp_sb3.report.plots.falls import plot_falls, plot_survival
from ogmp_sb3.runs.callbacks import steps_bar

LABELS = {DISTANCE: "distance along the track (m)", TIME: "time (s)"}
UNITS = {DISTANCE: "m", TIME: "s"}
COLUMNS = ["instances", "falls", "rate", "95 % interval over instances", "passed, but fell right behind"]


def falls(rows: Sequence[FallRow], out: Path, name: str = "falls") -> Section | None:
    """In which modes robots fell, by the size of what these asked for and by the mode before them.

    :param rows: of an evaluation
    :param name: of the files
    """
    parts = falls_parts(rows, out, name)
    text = (
        "An instance of a mode counts if the robot got to its end or fell in it. Where its base is at the end of the "
        "episode decides: who stumbles over a block may come down some steps behind it, in the next mode (passed, but "
        "fell right behind). A fall is whatever ends an episode before its time. Intervals are Wilson's, over the "
        "instances of all episodes."
    )
    return Section("Falls", text, parts) if parts else None


def falls_parts(rows: Sequence[FallRow], out: Path, name: str) -> list[Part]:
    """A picture and a table of where robots fell; nothing without an instance."""
    if not rows:
        return []
    caption = (
        f"Falls per instance of a mode, with 95 % intervals over instances: by mode, by each parameter that varies (in "
        f"{BINS} sizes of its range), and by the mode before. Circles count falls right behind, in the next mode, too. "
        "Below: in how many instances the robot fell, out of how many."
    )
    picture = make_picture(out, name, caption, falls_csv(rows), lambda path: plot_falls(rows, path))
    by_mode = dict(kinds_of(rows))["falls by mode"]
    cells = [
        [row.mode, str(row.share.n), str(row.falls), as_text([row.share.mean]),
         as_text([row.share.low, row.share.high], 3, " … "), str(row.falls_behind)]
        for row in by_mode
    ]  # fmt: skip
    return [picture, Table(cells, ["mode", *COLUMNS], "Sizes and modes before are in the file of the picture.")]


def endless(subject: EvaluatedPolicy, episodes: int, seed: int, max_distance: float, out: Path) -> Section:
    """How far robots get on tracks without end, and in which modes they fall there.

    :param max_distance: an episode also ends this far along the track, m
    """
    with steps_bar(subject.endless_steps(episodes, seed, max_distance), "endless tracks") as bar:
        result = subject.endless(episodes, seed, max_distance, bar.update)
    curves = result.survival
    medians = "; ".join(median_text(curve, UNITS[name]) for name, curve in curves.items())
    text = (
        f"{episodes} episodes with seeds {seed} to {seed + episodes - 1} on tracks without end, until the robot falls, "
        f"is {max_distance:g} m along or is slower than {SLOWEST:g} m/s in all. Median to a fall: {medians}. "
        f"{copies_text(result.copies, result.episodes)}"
    ).rstrip()
    caption = (
        "Share of the episodes that still run, by Kaplan and Meier, with 95 % intervals over episodes (Greenwood's, "
        "log(-log)). Ticks are episodes that ended without a fall. Dotted: the median."
    )
    picture = make_picture(
        out, "survival", caption, survival_rows(curves), lambda path: plot_survival(curves, LABELS, path)
    )
    parts = [picture, _shares(curves[DISTANCE]), *falls_parts(result.falls, out, "falls_endless")]
    return Section("Endless tracks", text, parts)


def survival_rows(curves: dict[str, Survival]) -> Rows:
    """Survival curves as a table for a file: a row for each place where an episode ended."""
    return [
        {"curve": name, **step._asdict(), "episodes": curve.n, "falls": curve.falls}
        for name, curve in curves.items()
        for step in curve.steps
    ]


def _shares(curve: Survival) -> Table:
    places = map(curve.share_at, round_places(curve.steps[-1].at))
    rows = [
        [f"{each.at:g}", as_text([each.share]), as_text([each.low, each.high], 3, " … "), str(each.running)]
        for each in places
    ]
    columns = ["m", "share that still runs", "95 % interval over episodes", "episodes that got so far"]
    return Table(rows, columns, f"{curve.n} episodes, of which {curve.falls} ended by a fall.")
