"""Pictures of falls: in which modes robots fall, and how far they get before they do."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ogmp_sb3.evaluation.falls import FallRow
from ogmp_sb3.evaluation.survival import Survival
from ogmp_sb3.report.plots.style import COLOURS, MODE_COLOURS, colours_of, in_style, panel_grid, save, subplots


@in_style
def plot_falls(rows: Sequence[FallRow], path: Path) -> None:
    """Rate of falls with 95 % intervals: by mode, then in each mode by its parameters and by the mode before it.

    Circles count falls right behind an instance, in the next mode, too.

    :param rows: of an evaluation
    :param path: picture to write
    """
    colours = colours_of(dict.fromkeys(row.mode for row in rows), MODE_COLOURS)
    by_mode = [row for row in rows if not row.by]
    rest = [row for row in rows if row.by]
    panels = [list(group) for _, group in itertools.groupby(rest, key=lambda row: (row.mode, row.by))]
    figure, (first, *others) = panel_grid(1 + len(panels), 4, 2.9, 2.5)
    _draw(first, by_mode, [row.mode for row in by_mode], [colours[row.mode] for row in by_mode])
    first.set(title="by mode", ylabel="falls per instance")
    for axes, panel in zip(others, panels, strict=True):
        _draw(axes, panel, [row.title for row in panel], [colours[row.mode] for row in panel])
        axes.set(title=f"{panel[0].mode}, by {panel[0].by}")
    reach = [max(row.share.high or 0.0, row.share.mean + row.falls_behind / row.share.n) for row in rows]
    top = 1.05 * max(reach, default=1.0)
    for axes in (first, *others):
        axes.set_ylim(-0.03 * top, top)
    save(figure, path)


def _draw(axes: Axes, rows: Sequence[FallRow], labels: list[str], colours: list[str]) -> None:
    """Rates side by side, with falls and instances below each."""
    for place, (row, colour) in enumerate(zip(rows, colours, strict=True)):
        rate, ends = row.share.mean, np.array([row.share.low, row.share.high], dtype=float)
        errors = np.maximum([[rate - ends[0]], [ends[1] - rate]], 0.0)  # not below 0, by rounding
        axes.errorbar([place], [rate], errors, fmt="o", markersize=4, capsize=3, color=colour)
        within = rate + row.falls_behind / row.share.n
        axes.plot([place], [within], "o", markersize=7, markerfacecolor="none", markeredgecolor=colour)
    counted = [f"{label}\n{row.falls} of {row.share.n}" for label, row in zip(labels, rows, strict=True)]
    axes.set_xticks(range(len(rows)), counted, fontsize="x-small")
    axes.set_xlim(-0.5, max(len(rows), 1) - 0.5)
    axes.grid(alpha=0.3, axis="y")


@in_style
def plot_survival(curves: dict[str, Survival], labels: dict[str, str], path: Path) -> None:
    """Share of episodes that still run, with its 95 % interval, a panel for each curve; ticks: censored episodes.

    :param curves: by name
    :param labels: of their axes
    :param path: picture to write
    """
    figure, panels = subplots(1, len(curves), (4.6 * len(curves), 3.3), sharey=True)
    for axes, (name, curve) in zip(panels[0], curves.items(), strict=True):
        x = np.array([0.0, *(step.at for step in curve.steps)])
        share = np.array([1.0, *(step.share for step in curve.steps)])
        low, high = (
            np.array([np.nan, *(getattr(s, end) for s in curve.steps)], dtype=float) for end in ("low", "high")
        )
        axes.fill_between(x, low, high, step="post", color=COLOURS["lqr"], alpha=0.2, linewidth=0)
        axes.step(x, share, where="post", color=COLOURS["lqr"], linewidth=1.6)
        censored = np.diff(share, prepend=1.0) == 0.0
        axes.plot(x[1:][censored[1:]], share[1:][censored[1:]], "|", color=COLOURS["lqr"], markersize=6)
        if curve.median is not None:
            axes.plot([0.0, curve.median, curve.median], [0.5, 0.5, 0.0], ":", color="0.5")
        axes.set(xlabel=labels[name], xlim=(0.0, None), ylim=(0.0, 1.03))
        axes.grid(alpha=0.3)
    panels[0][0].set_ylabel("episodes that still run")
    save(figure, path)
