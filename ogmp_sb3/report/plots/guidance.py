"""Pictures of the guidance: the references of oracles, and the latents of modes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.srb import OMEGA, POS, RPY, VEL
from ogmp_sb3.report.plots.style import COLOURS, in_style, legend_entries, panel_grid, save

HEIGHT = POS.start + 2
KINDS = ((POS, "m", 0.1), (RPY, "rad", 0.1), (VEL, "m/s", 0.5), (OMEGA, "rad/s", 0.5))
"""Parts of a state in the order they are drawn in, their unit, and the least span of an axis, so that what hardly moves
looks at rest."""
MOVES = 0.01  # of the least span: a state that moves less is not drawn

Panel = tuple[str, np.ndarray, np.ndarray, dict[str, np.ndarray]]
"""Title, stance (steps,), set-points (steps + 1, 12), and oracle -> reference (steps + 1, 12)."""


@in_style
def plot_references(panels: list[Panel], dt: float, path: Path) -> None:
    """References over time by every oracle, one row for each mode (paper, fig:orac_trajs).

    Shown is the height of the base, and all else of its state that moves.

    :param dt: distance of knots, s
    :param path: picture to write
    """
    shown = [_shown([set_points, *references.values()]) for _, _, set_points, references in panels]
    columns = max(map(len, shown))
    figure, grid = panel_grid(len(panels) * columns, columns, 3.3, 2.7)
    for row, (panel, states) in enumerate(zip(panels, shown, strict=True)):
        for column in range(columns):
            axes = grid[row * columns + column]
            if column < len(states):
                _draw_reference(axes, panel, dt, *states[column])
            else:
                axes.axis("off")
    entries = legend_entries(grid)
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=len(entries), fontsize="small")
    figure.suptitle("References by mode (grey: stance)")
    save(figure, path)


def _draw_reference(axes: Axes, panel: Panel, dt: float, state: int, label: str, least: float) -> None:
    """One number of the state over time.

    :param least: span of its axis, in its unit
    """
    title, stance, set_points, references = panel
    time = dt * np.arange(len(set_points))
    for k in np.flatnonzero(stance):
        axes.axvspan(time[k], time[k + 1], color="0.92", linewidth=0)
    axes.plot(time, set_points[:, state], color="0.4", linestyle=":", label="set-points")
    for oracle, reference in references.items():
        axes.plot(time, reference[:, state], label=oracle, color=COLOURS.get(oracle))
    low, high = axes.get_ylim()
    short = max(least - (high - low), 0.0)
    axes.set(title=title, xlabel="time (s)", ylabel=label, ylim=(low - 0.5 * short, high + 0.5 * short))


def _shown(curves: list[np.ndarray]) -> list[tuple[int, str, float]]:
    """The states that a mode's row shows: place, label, and least span of the axis.

    :param curves: set-points and references, each (steps + 1, 12)
    """
    shown = []
    for part, unit, least in KINDS:
        for place in range(part.start, part.stop):
            if place == HEIGHT or max(np.ptp(curve[:, place]) for curve in curves) > MOVES * least:
                shown.append((place, f"{_label(place)} ({unit})", least))
    return sorted(shown, key=lambda state: state[0] != HEIGHT)


def _label(place: int) -> str:
    """What a number of the state is called."""
    name = STATE_NAMES[place]
    if OMEGA.start <= place < OMEGA.stop:
        return f"{STATE_NAMES[RPY.start + place - OMEGA.start]} rate"
    return {"x": "x, forward", "y": "y, sideways", "z": "base height"}.get(name, name)


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
