"""The section with heat maps over mode parameters, which takes longer than all else of a report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ogmp_sb3.evaluation.copies import copies_in_sets_text
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy
from ogmp_sb3.evaluation.grid import Grid
from ogmp_sb3.evaluation.statistics import Estimate
from ogmp_sb3.report.page import Rows, Section, make_picture
from ogmp_sb3.report.plots.evaluations import plot_grids
from ogmp_sb3.runs.callbacks import steps_bar

TITLE = "Mode parameters"
TEXT = "Tracks that hold only one mode, with two of its parameters from small ranges, some never trained on."
NOT_YET = (
    "The heat maps are being measured, and this page is written again when they are there. If ogmp-report was "
    "interrupted, the same command goes on where it stopped."
)


def heat_maps_to_come() -> Section:
    """What stands in the place of the heat maps while they are being measured."""
    return Section(TITLE, f"{TEXT} {NOT_YET}", [])


def heat_maps(subject: EvaluatedPolicy, grids: list[Grid], episodes: int, seed: int, out: Path) -> Section:
    """Heat maps of the return over two parameters of modes.

    :param grids: at least one
    :param episodes: of each cell
    """
    with steps_bar(subject.grids_steps(grids, episodes, seed), "heat maps") as bar:
        measured = subject.grids(grids, episodes, seed, bar.update)
    rows = grid_rows(measured)
    means = []
    for grid in grids:
        inside, outside = (
            [row["return"] for row in rows if row["mode"] == grid.mode and row["trained"] is trained]
            for trained in (True, False)
        )
        means.append(f"{grid.mode} {_mean(inside)} and {_mean(outside)}")
    caption = (
        f"Mean return over two parameters of a mode, {episodes} episodes a cell, each occurrence with values drawn in "
        f"the cell; the training range outlined. Means over the cells inside and outside of it: {'; '.join(means)}. "
        f"{copies_in_sets_text((row['n'] for row in rows), episodes, 'cells')}"
    ).rstrip()
    picture = make_picture(out, "grids", caption, rows, lambda path: plot_grids(measured, "return", path))
    return Section(TITLE, TEXT, [picture])


def grid_rows(grids: list[dict[str, Any]]) -> Rows:
    """The returns of grids as a table for a file: one row for each cell."""
    rows = []
    for grid in grids:
        for cell in grid["cells"]:
            spans = grid["trained"].items()
            inside = bool(spans) and all(_trained(cell[key], span) for key, span in spans)
            returned, (first, second) = Estimate.from_data(cell["metrics"]["return"]), grid["axes"]
            rows.append({
                "mode": grid["mode"],
                "first": first, "first_from": cell[first][0], "first_to": cell[first][1],
                "second": second, "second_from": cell[second][0], "second_to": cell[second][1],
                "trained": inside, "return": returned.mean,
                "low": returned.low, "high": returned.high, "n": returned.n,
            })  # fmt: skip
    return rows


def _trained(cell: list[float], span: list[float]) -> bool:
    """Whether the middle of a cell lies in the training range, or the whole range in the cell."""
    return span[0] <= float(np.mean(cell)) <= span[1] or cell[0] <= span[0] <= span[1] <= cell[1]


def _mean(values: list[float]) -> str:
    return f"{np.mean(values):.1f}" if values else "none"
