"""Pictures of the guidance: the references of oracles, and the latents of modes."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.report.plots.style import COLOURS, save


def plot_references(
    panels: list[tuple[str, np.ndarray, np.ndarray, dict[str, np.ndarray]]], dt: float, path: Path
) -> None:
    """Base height over time by every oracle, one panel for each mode (paper, fig:orac_trajs).

    :param panels: title, stance (steps,), set-point height (steps + 1,), and oracle -> height (steps + 1,), m
    :param dt: distance of knots, s
    :param path: picture to write
    """
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure, grid = plt.subplots(rows, columns, figsize=(4.5 * columns, 3.2 * rows), squeeze=False, layout="constrained")
    for axes in grid.flat[len(panels) :]:
        axes.axis("off")
    for axes, (title, stance, set_point, heights) in zip(grid.flat, panels, strict=False):
        time = dt * np.arange(len(set_point))
        for k in np.flatnonzero(stance):
            axes.axvspan(time[k], time[k + 1], color="0.92", linewidth=0)
        axes.plot(time, set_point, color="0.4", linestyle=":", label="set-points")
        for oracle, height in heights.items():
            axes.plot(time, height, label=oracle, color=COLOURS.get(oracle))
        axes.set(title=title, xlabel="time (s)", ylabel="base height (m)")
    grid.flat[0].legend(fontsize="small")
    figure.suptitle("References by mode (grey: stance)")
    save(figure, path)


def plot_latents(latents: np.ndarray, calls: list[ModeCall], path: Path) -> None:
    """Scatter of the latent: all modes, and each mode coloured by its parameters (paper, fig:afo c).

    :param latents: shape (n, 2)
    :param calls: the mode and parameters of each
    :param path: picture to write
    """
    names = list(dict.fromkeys(call.name for call in calls))
    panels: list[tuple[str, str | None]] = [("all modes", None)]
    for name in names:
        parameters = next(call.parameters for call in calls if call.name == name)
        varied = [k for k in parameters if len({call.parameters[k] for call in calls if call.name == name}) > 1]
        panels += [(name, parameter) for parameter in varied]
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure, grid = plt.subplots(rows, columns, figsize=(3.5 * columns, 2.9 * rows), squeeze=False, layout="constrained")
    for axes in grid.flat[len(panels) :]:
        axes.axis("off")
    for axes, (name, parameter) in zip(grid.flat, panels, strict=False):
        if parameter is None:
            for mode in names:
                rows_of = [i for i, call in enumerate(calls) if call.name == mode]
                axes.scatter(*latents[rows_of].T, s=6, label=mode, rasterized=True)
            axes.legend(fontsize="small")
            axes.set(title=name, xlabel="z1", ylabel="z2")
            continue
        members = [i for i, call in enumerate(calls) if call.name == name]
        values = [calls[i].parameters[parameter] for i in members]
        words = sorted({v for v in values if isinstance(v, str)})
        colours = [words.index(str(v)) for v in values] if words else values
        colour_map = "tab10" if words else "viridis"
        points = axes.scatter(*latents[members].T, s=6, c=colours, cmap=colour_map, rasterized=True)
        axes.set(title=f"{name}: {parameter}" + (f" ({', '.join(words)})" if words else ""), xlabel="z1", ylabel="z2")
        if not words:
            figure.colorbar(points)
    save(figure, path, dpi=100)
