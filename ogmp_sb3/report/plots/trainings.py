"""Pictures of trainings: the curves of a run and of a sweep, and the objectives of a sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter

from ogmp_sb3.report.plots.style import CAUSE_COLOURS, colours_of, in_style, legend_entries, panel_grid, save, subplots
from ogmp_sb3.runs.logs import STEP_COLUMN

SMOOTH = 5  # rows of progress.csv that a line is averaged over
BOUND_COLOUR = "#c00000"
NO_VALUE = "null"  # of rho: no bound
FOR_BAND = 3  # seeds: the interval of two is nine standard deviations long to either side, and would hide everything
Rows = list[dict[str, Any]]


def smoothed(values: np.ndarray, rows: int = SMOOTH) -> np.ndarray:
    """Running mean over a number of rows, those without a value left out.

    :param values: shape (n,)
    :return: shape (n,); nan where no row around has a value
    """
    known = np.isfinite(values)
    weights = np.ones(min(rows, len(values)))
    count = np.convolve(known, weights, "same")
    total = np.convolve(np.where(known, values, 0.0), weights, "same")
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@in_style
def plot_training(
    log: dict[str, np.ndarray], columns: dict[str, str], causes: dict[str, str], rho: float | None, path: Path
) -> None:
    """Training curves of a run, smoothed, the rows themselves behind; the last panel is what ended the episodes.

    :param log: column -> values, each of shape (rows,)
    :param columns: columns to show, with the labels of their axes
    :param causes: columns that are shares of episodes, with what ended these
    :param rho: permissible-state bound, drawn into the panel of the deviation
    :param path: picture to write
    """
    samples = log[STEP_COLUMN]
    count = len(columns) + 1
    rows = -(-count // 3)
    figure, grid = subplots(rows, 3, (10.5, 2.7 * rows))
    for axes in grid.flat[count:]:
        axes.axis("off")
    for axes, (column, label) in zip(grid.flat, columns.items(), strict=False):
        axes.plot(samples, log[column], color="#0072b2", alpha=0.3, linewidth=0.9)
        axes.plot(samples, smoothed(log[column]), color="#0072b2", linewidth=1.6)
        if column.endswith("deviation") and rho is not None:
            axes.axhline(rho, color=BOUND_COLOUR, linestyle="--", linewidth=1.0, label=f"ρ = {rho:g}")
            axes.legend(fontsize="small")
        _frame(axes, label)
    axes = grid.flat[len(columns)]
    shares = [smoothed(np.nan_to_num(log[column])) for column in causes]
    colours = colours_of(causes.values(), CAUSE_COLOURS)
    if shares:
        axes.stackplot(samples, shares, labels=causes.values(), colors=[colours[cause] for cause in causes.values()])
        axes.legend(fontsize="small", ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        axes.set(xlim=(samples[0], max(samples[-1], samples[0] + 1e-9)), ylim=(0.0, 1.0))
    _count_samples(axes)
    axes.set(ylabel="episodes ended by")
    save(figure, path)


@in_style
def plot_sweep_curves(rows: Rows, key: str, path: Path, seeds: Rows = ()) -> None:  # type: ignore[assignment]
    """Training returns of a sweep: a panel for each combination of the other keys (paper, fig:rho_vary).

    :param rows: ``panel``, ``line``, ``samples``, ``mean``, ``low``, ``high``, ``seeds``; lines in the order of their
        values. The band from low to high is drawn where it is of :data:`FOR_BAND` seeds or more
    :param key: what the lines differ in
    :param path: picture to write
    :param seeds: the trainings behind lines of several: ``panel``, ``line``, ``seed``, ``samples``, ``return``
    """
    panels = list(dict.fromkeys(row["panel"] for row in rows))
    colours = line_colours([row["line"] for row in rows])
    columns = min(len(panels), 3)
    height = -(-len(panels) // columns)
    figure, grid = subplots(height, columns, (10.0, 3.2 * height), sharey=True)
    for axes in grid.flat[len(panels) :]:
        axes.axis("off")
    reach: list[float] = []
    for axes, panel in zip(grid.flat, panels, strict=False):
        for line, colour in colours.items():
            of_line = [row for row in rows if (row["panel"], row["line"]) == (panel, line)]
            if not of_line:  # of a job that has not begun
                continue
            x, mean, low, high, count = (
                np.array([row.get(name, 1) for row in of_line], dtype=float)
                for name in ("samples", "mean", "low", "high", "seeds")
            )
            style = "--" if line == NO_VALUE else "-"
            axes.plot(x, smoothed(mean), style, color=colour, linewidth=1.6, label=f"{key} = {line}")
            band = np.where(count >= FOR_BAND, [low, high], np.nan)
            axes.fill_between(x, *map(smoothed, band), color=colour, alpha=0.2, linewidth=0)
            mine = [row for row in seeds if (row["panel"], row["line"]) == (panel, line)]
            reach += [*smoothed(mean), *_draw_seeds(axes, mine, colour)]
        _frame(axes, "return")
        axes.set_title(panel)
    _set_reach(grid.flat[0], np.array(reach))
    handles = legend_entries(list(grid.flat))
    figure.legend(handles.values(), handles.keys(), loc="outside right center")
    save(figure, path)


def _draw_seeds(axes: Axes, rows: Rows, colour: Any) -> list[float]:
    """The curves of single trainings, thin; returns what they reach."""
    reach: list[float] = []
    for seed in dict.fromkeys(row["seed"] for row in rows):
        mine = [row for row in rows if row["seed"] == seed]
        values = smoothed(np.array([row["return"] for row in mine], dtype=float))
        axes.plot([row["samples"] for row in mine], values, color=colour, linewidth=0.5, alpha=0.6)
        reach += values.tolist()
    return reach


def _set_reach(axes: Axes, values: np.ndarray) -> None:
    """Limit an axis to what lines reach: the interval of a few seeds goes far beyond."""
    known = values[np.isfinite(values)]
    if len(known) and known.max() > known.min():
        margin = 0.08 * (known.max() - known.min())
        axes.set_ylim(known.min() - margin, known.max() + margin)


@in_style
def plot_objectives(
    rows: Rows,
    key: str,
    bounds: dict[str, float | None],
    standing: tuple[float, float] | None,
    path: Path,
    seeds: Rows = (),  # type: ignore[assignment]
) -> None:
    """Objectives of the jobs of a sweep against one key, a panel for each objective (paper, fig:abl).

    :param rows: ``objective``, ``line``, ``value``, ``mean``, ``low``, ``high``
    :param key: what ``value`` is of
    :param bounds: objective -> what it can reach at most, or None
    :param standing: values of the key above which a robot may stand still, in the easiest and the hardest mode, or None
    :param path: picture to write
    :param seeds: the trainings behind points of several, small: ``objective``, ``line``, ``value``, ``mean``
    """
    places = _places(list(dict.fromkeys(row["value"] for row in rows)))
    lines = list(dict.fromkeys(row["line"] for row in rows))
    colours = dict(zip(lines, colormaps["tab10"].colors * (1 + len(lines) // 10), strict=False))  # type: ignore[attr-defined]
    figure, panels = panel_grid(len(bounds), len(bounds), 5.2, 3.8)
    for axes, (objective, bound) in zip(panels, bounds.items(), strict=True):
        for line in lines:
            of_line = [row for row in rows if (row["objective"], row["line"]) == (objective, line)]
            _draw_means(axes, of_line, places, colours[line], line)
            dots = [row for row in seeds if (row["objective"], row["line"]) == (objective, line)]
            x, y = [places[row["value"]] for row in dots], [row["mean"] for row in dots]
            axes.scatter(x, y, s=9, facecolors="none", edgecolors=[colours[line]], linewidths=0.8)
        if bound is not None:
            axes.axhline(bound, color=BOUND_COLOUR, linewidth=1.4, label="upper bound")
        if standing is not None:
            _mark_standing(axes, _between(places, standing))
        _label_values(axes, places)
        axes.set(xlabel=key, ylabel=objective)
        axes.grid(alpha=0.3)
    handles = legend_entries(panels)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=max(min(len(handles), 5), 1))
    save(figure, path)


def _draw_means(axes: Axes, rows: Rows, places: dict[str, int], colour: Any, label: str) -> None:
    """Means with their intervals, joined by a line; what has no interval has a bar of no length."""
    mean = np.array([row["mean"] for row in rows])
    low, high = (np.array([row[end] for row in rows], dtype=float) for end in ("low", "high"))  # None: nan
    errors = np.maximum([mean - low, high - mean], 0.0)  # not below 0, by rounding, where all seeds are equal
    x = [places[row["value"]] for row in rows]
    axes.errorbar(x, mean, errors, fmt="o-", color=colour, capsize=3, markersize=4, label=label or None)


def _mark_standing(axes: Axes, ends: np.ndarray) -> None:
    """Mark where a robot that stands still begins to stay inside the bound, for the slowest to the fastest mode."""
    low, high = ends
    axes.axvspan(low, high, color="0.93", linewidth=0, zorder=0)
    axes.axvline(low, color="0.5", linestyle=":", label="standing still")
    axes.axvline(high, color="0.5", linestyle=":")


def _label_values(axes: Axes, places: dict[str, int]) -> None:
    """Write the values below the axis, aslant if they are long."""
    axes.set_xticks(list(places.values()), ["off" if value == NO_VALUE else value for value in places])
    if max(map(len, places)) >= 8:
        for label in axes.get_xticklabels():
            label.set(rotation=30, ha="right", rotation_mode="anchor")


def line_colours(lines: list[str]) -> dict[str, Any]:
    """A colour for each line by its place in the order, black for no value."""
    values = [line for line in dict.fromkeys(lines) if line != NO_VALUE]
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(values)))
    return {**dict(zip(values, colours, strict=True)), **({NO_VALUE: "black"} if NO_VALUE in lines else {})}


def _places(values: list[str]) -> dict[str, int]:
    """Places of values along an axis: numbers by size, then words in the order they come in, then no value."""
    return {value: i for i, value in enumerate(sorted(values, key=lambda v: (v == NO_VALUE, _number(v))))}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.inf


def _between(places: dict[str, int], numbers: tuple[float, float]) -> np.ndarray:
    """Places of positive numbers between the values of an axis; half a place from the last for those above it."""
    known = {0.0: -0.5} | {_number(value): float(place) for value, place in places.items() if value != NO_VALUE}
    return np.interp(numbers, list(known), list(known.values()), right=len(known) - 1.5)


def _frame(axes: Axes, label: str) -> None:
    _count_samples(axes)
    axes.set(ylabel=label)
    axes.grid(alpha=0.3)


def _count_samples(axes: Axes) -> None:
    """Write samples along the horizontal axis as 500k and 16M."""
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.set(xlabel="samples")
