"""Pictures of the guidance: the references of oracles, and the latents of modes."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.report.plots.style import COLOURS, panel_grid, save


def plot_references(
    panels: list[tuple[str, np.ndarray, np.ndarray, dict[str, np.ndarray]]], dt: float, path: Path
) -> None:
    """Base height over time by every oracle, one panel for each mode (paper, fig:orac_trajs).

    :param panels: title, stance (steps,), set-point height (steps + 1,), and oracle -> height (steps + 1,), m
    :param dt: distance of knots, s
    :param path: picture to write
    """
    figure, grid = panel_grid(len(panels), 3, 4.5, 3.2)
    for axes, (title, stance, set_point, heights) in zip(grid, panels, strict=True):
        time = dt * np.arange(len(set_point))
        for k in np.flatnonzero(stance):
            axes.axvspan(time[k], time[k + 1], color="0.92", linewidth=0)
        axes.plot(time, set_point, color="0.4", linestyle=":", label="set-points")
        for oracle, height in heights.items():
            axes.plot(time, height, label=oracle, color=COLOURS.get(oracle))
        axes.set(title=title, xlabel="time (s)", ylabel="base height (m)")
    grid[0].legend(fontsize="small")
    figure.suptitle("References by mode (grey: stance)")
    save(figure, path)


def plot_latents(latents: np.ndarray, calls: list[ModeCall], path: Path) -> None:
    """Scatter of the latent: all modes, and each mode coloured by its parameters (paper, fig:afo c).

    Of a latent of more than two numbers, the two principal components.

    :param latents: shape (n, latent size)
    :param calls: the mode and parameters of each
    :param path: picture to write
    """
    points, labels = _plane(latents)
    names = dict.fromkeys(call.name for call in calls)
    members = {name: [i for i, call in enumerate(calls) if call.name == name] for name in names}
    coloured = [
        (name, parameter, values)
        for name, rows in members.items()
        for parameter in calls[rows[0]].parameters
        if all(parameter in calls[i].parameters for i in rows)
        and len(set(values := [calls[i].parameters[parameter] for i in rows])) > 1
    ]
    figure, (first, *others) = panel_grid(1 + len(coloured), 3, 3.5, 2.9)
    for name, rows in members.items():
        first.scatter(points[rows, 0], points[rows, 1], s=6, label=name, rasterized=True)
    first.legend(fontsize="small")
    first.set(title="all modes", **labels)
    for axes, (name, parameter, values) in zip(others, coloured, strict=True):
        _scatter_by_value(axes, points[members[name]], values)
        words = _words(values)
        axes.set(title=f"{name}: {parameter}" + (f" ({', '.join(words)})" if words else ""), **labels)
    save(figure, path, dpi=100)


def _plane(latents: np.ndarray) -> tuple[np.ndarray, dict[str, str]]:
    """Latents as points of a plane, and the labels of its axes."""
    if latents.shape[1] == 2:
        return latents, {"xlabel": "z1", "ylabel": "z2"}
    centred = latents - latents.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2][:2]
    return centred @ axes.T, {"xlabel": "first principal component", "ylabel": "second"}


def _scatter_by_value(axes: Axes, points: np.ndarray, values: list[float | str]) -> None:
    """Points coloured by a number, with a bar of colours, or by a word."""
    words, (x, y) = _words(values), points.T
    if words:
        axes.scatter(x, y, s=6, c=[words.index(str(value)) for value in values], cmap="tab10", rasterized=True)
    else:
        marks = axes.scatter(x, y, s=6, c=np.array(values), cmap="viridis", rasterized=True)
        plt.colorbar(marks, ax=axes)


def _words(values: list[float | str]) -> list[str]:
    return sorted({value for value in values if isinstance(value, str)})
