"""What all pictures share: colours, and how they are written. No picture needs a screen, nor a backend of matplotlib.

pyplot is not used, and the settings of matplotlib are as they were before when a picture is done: both are the user's.

A path that ends in ``.png`` gets a picture of that kind; one without an ending gets a ``.png`` and a ``.svg``.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ogmp_sb3.runs.atomic import replacing

COLOURS = {"linear": "#e69f00", "lqr": "#0072b2", "preview": "#009e73"}
MODE_COLOURS = {
    "pace": "#0072b2", "leap": "#d55e00", "jump": "#009e73", "flip": "#cc79a7", "settle": "#0072b2",
    "": "0.6",  # no mode
}  # fmt: skip
CAUSE_COLOURS = {
    "time_limit": "#009e73", "max_distance": "#56b4e9", "bound": "#e69f00", "low_reward": "#cc79a7", "fall": "#d55e00",
    "unstable": "#000000",
}  # fmt: skip
MORE_COLOURS = ("#8c564b", "#6a3d9a", "#bcbd22", "#17becf", "#e377c2", "#393b79")  # of users' own names

in_style = matplotlib.rc_context({
    "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": "medium", "font.size": 9,
    "legend.frameon": False, "svg.hashsalt": "ogmp_sb3",
})  # fmt: skip
"""Decorator of a function that draws: with our settings of matplotlib."""


def subplots(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Figure, Any]:
    """A figure with a grid of panels.

    :param size: of the figure, inches
    :param options: of :meth:`matplotlib.figure.Figure.subplots`
    :return: the figure, and its axes, shape (rows, columns)
    """
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def save(figure: Figure, path: Path, dpi: int = 120) -> None:
    """Write a figure: one file if the path ends in ``.png``, else a ``.png`` and a ``.svg``; all or nothing."""
    with replacing(path if path.suffix == ".png" else path.with_name(f"{path.name}.png")) as file:
        figure.savefig(file, dpi=dpi, format="png")
    if path.suffix != ".png":
        figure.set_layout_engine("none")  # laid out already
        with replacing(path.with_name(f"{path.name}.svg")) as file:
            figure.savefig(file, dpi=dpi, format="svg", metadata={"Date": None})


def colours_of(names: Iterable[str], known: dict[str, str]) -> dict[str, str]:
    """A colour for each name: its own if it is known, else the next of a cycle in the order of appearance."""
    others = dict.fromkeys(name for name in names if name not in known)
    return known | dict(zip(others, itertools.cycle(MORE_COLOURS), strict=False))


def panel_grid(count: int, columns: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """A figure with some panels in rows; what is left over in the last row stays empty.

    :param columns: the most panels in a row
    :param width: of a panel, inches
    :param height: of a panel, inches
    """
    columns = min(count, columns)
    rows = -(-count // columns)
    size = (width * columns, height * rows)
    figure, grid = subplots(rows, columns, size)
    for axes in grid.flat[count:]:
        axes.axis("off")
    return figure, list(grid.flat[:count])


def legend_entries(panels: list[Axes]) -> dict[str, Any]:
    """The legend entries of several panels by label, each once."""
    return {label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
