"""Pictures of the guidance: the references of oracles, and the latents of modes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.srb import OMEGA, POS, RPY
from ogmp_sb3.report.plots.style import COLOURS, in_style, panel_grid, save

LEAST_RANGE = 0.1  # m, rad or rad/s: of an axis, so that what hardly moves looks at rest


@in_style
def plot_references(
    panels: list[tuple[str, np.ndarray, np.ndarray, dict[str, np.ndarray]]], dt: float, path: Path
) -> None:
    """References over time by every oracle, one panel for each mode (paper, fig:orac_trajs).

    Shown is the height of the base, and of a mode that turns it the angle and the rate about its axis as well.

    :param panels: title, stance (steps,), set-points (steps + 1, 12), and oracle -> reference (steps + 1, 12)
    :param dt: distance of knots, s
    :param path: picture to write
    """
    shown = [(panel, label, state) for panel in panels for label, state in _shown(panel[2])]
    figure, grid = panel_grid(len(shown), 3, 4.5, 3.2)
    for axes, ((title, stance, set_points, references), label, state) in zip(grid, shown, strict=True):
        time = dt * np.arange(len(set_points))
        for k in np.flatnonzero(stance):
            axes.axvspan(time[k], time[k + 1], color="0.92", linewidth=0)
        axes.plot(time, set_points[:, state], color="0.4", linestyle=":", label="set-points")
        for oracle, reference in references.items():
            axes.plot(time, reference[:, state], label=oracle, color=COLOURS.get(oracle))
        low, high = axes.get_ylim()
        short = max(LEAST_RANGE - (high - low), 0.0)
        axes.set(title=title, xlabel="time (s)", ylabel=label, ylim=(low - 0.5 * short, high + 0.5 * short))
    grid[0].legend(fontsize="small")
    figure.suptitle("References by mode (grey: stance)")
    save(figure, path)


def _shown(set_points: np.ndarray) -> list[tuple[str, int]]:
    """Labels and places of the states that a mode's picture shows."""
    shown = [("base height (m)", POS.start + 2)]
    for axis in map(int, np.flatnonzero(set_points[:, OMEGA].any(axis=0))):
        name = STATE_NAMES[axis]
        shown += [(f"{name} (rad)", RPY.start + axis), (f"{name} rate (rad/s)", OMEGA.start + axis)]
    return shown


@in_style
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
        _scatter_by_value(figure, axes, points[members[name]], values)
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


def _scatter_by_value(figure: Figure, axes: Axes, points: np.ndarray, values: list[float | str]) -> None:
    """Points coloured by a number, with a bar of colours, or by a word."""
    words, (x, y) = _words(values), points.T
    if words:
        axes.scatter(x, y, s=6, c=[words.index(str(value)) for value in values], cmap="tab10", rasterized=True)
    else:
        marks = axes.scatter(x, y, s=6, c=np.array(values), cmap="viridis", rasterized=True)
        figure.colorbar(marks, ax=axes)


def _words(values: list[float | str]) -> list[str]:
    return sorted({value for value in values if isinstance(value, str)})
