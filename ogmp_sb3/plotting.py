"""Pictures. The only module that imports matplotlib; no library module imports this one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from ogmp_sb3.sampling import ModeCall

COLOURS = {"linear": "#e69f00", "lqr": "#0072b2", "preview": "#009e73"}


def plot_grid(grid: dict[str, Any], metric: str, path: Path) -> None:
    """Heat map of a metric over two mode parameters, the training range outlined (paper, fig:mpt).

    :param grid: ``grid`` of an evaluation's ``metrics.json``
    :param metric: name of the metric
    :param path: picture to write
    """
    first, second = grid["axes"]
    a = np.unique([cell[first] for cell in grid["cells"]])
    b = np.unique([cell[second] for cell in grid["cells"]])
    values = np.array([cell["metrics"][metric]["mean"] for cell in grid["cells"]]).reshape(len(a), len(b))
    figure, axes = plt.subplots(figsize=(6, 5), layout="constrained")
    mesh = axes.pcolormesh(a, b, values.T, shading="nearest", cmap="viridis")
    (a0, a1), (b0, b1) = grid["trained"][first], grid["trained"][second]
    axes.add_patch(plt.Rectangle((a0, b0), a1 - a0, b1 - b0, fill=False, edgecolor="black", linewidth=2))
    axes.set_xlabel(f"{grid['mode']}.{first}")
    axes.set_ylabel(f"{grid['mode']}.{second}")
    figure.colorbar(mesh, label=f"{metric} (black: trained on)")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def plot_robustness(results: list[dict[str, Any]], path: Path) -> None:
    """Fraction of episodes without a fall over the size of each disturbance, with 95 % intervals.

    :param results: ``robustness`` of an evaluation's ``metrics.json``
    :param path: picture to write
    """
    columns = min(len(results), 3)
    rows = -(-len(results) // columns)
    figure, grid = plt.subplots(
        rows, columns, figsize=(3.6 * columns, 2.8 * rows), sharey=True, squeeze=False, layout="constrained"
    )
    for axes in grid.flat[len(results) :]:
        axes.axis("off")
    for axes, result in zip(grid.flat, results, strict=False):
        value = [point["value"] for point in result["points"]]
        mean = np.array([point["no_fall_fraction"]["mean"] for point in result["points"]])
        interval = np.array([point["no_fall_fraction"]["ci95"] for point in result["points"]]).T
        if result["declared"]:
            axes.axvspan(*result["declared"], color="0.9", linewidth=2)
        axes.errorbar(value, mean, np.abs(interval - mean), marker="o", markersize=4, capsize=3, color=COLOURS["lqr"])
        axes.set(xlabel=result["label"], ylim=(-0.03, 1.03))
        axes.grid(alpha=0.3)
    for axes in grid[:, 0]:
        axes.set_ylabel("episodes without a fall")
    if any(result["declared"] for result in results):
        figure.suptitle("Grey: declared in the task", fontsize="medium")
    figure.savefig(path, dpi=120)
    plt.close(figure)


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
    figure.savefig(path, dpi=120)
    plt.close(figure)


def plot_learning_curves(runs: dict[str, Path], path: Path, smooth: int = 5) -> None:
    """Return and episode length of training over samples, one line a run.

    :param runs: label -> run directory
    :param path: picture to write
    :param smooth: rows of progress.csv to average over
    """
    figure, panels = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    for label, run in runs.items():
        log = np.genfromtxt(run / "progress.csv", delimiter=",", names=True, deletechars="", ndmin=1)
        samples = log["time/total_timesteps"] / 1e6
        for axes, column in zip(panels, ("episode/return", "episode/length"), strict=True):
            weights = np.ones(smooth)
            smoothed = np.convolve(log[column], weights, "same") / np.convolve(np.ones(len(log)), weights, "same")
            axes.plot(samples, smoothed, label=label)
            axes.set(xlabel="samples (millions)", ylabel=f"{column.split('/')[1]} of training episodes")
            axes.grid(alpha=0.3)
    panels[0].legend(fontsize="small")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def plot_throughput(title: str, numbers: dict[str, float], path: Path) -> None:
    """Bars of all rates (``..._per_second...``) of a benchmark, its ratios (``..._over_...``) in the title.

    :param numbers: name -> value
    :param path: picture to write
    """
    rates = {name: value for name, value in numbers.items() if "per_second" in name}
    ratios = [f"{name} {value:.2f}" for name, value in numbers.items() if "_over_" in name]
    figure, axes = plt.subplots(figsize=(8, 0.6 + 0.35 * len(rates)), layout="constrained")
    bars = axes.barh(list(rates), list(rates.values()), color=COLOURS["lqr"])
    axes.bar_label(bars, fmt="{:,.0f}", padding=3)
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.set(xlabel="per second", title="\n".join([title, *ratios]))
    figure.savefig(path, dpi=120)
    plt.close(figure)


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
    columns = min(len(panels), 4)
    rows = -(-len(panels) // columns)
    figure, grid = plt.subplots(rows, columns, figsize=(4 * columns, 3.4 * rows), squeeze=False, layout="constrained")
    for axes in grid.flat[len(panels) :]:
        axes.axis("off")
    for axes, (name, parameter) in zip(grid.flat, panels, strict=False):
        if parameter is None:
            for mode in names:
                rows_of = [i for i, call in enumerate(calls) if call.name == mode]
                axes.scatter(*latents[rows_of].T, s=6, label=mode)
            axes.legend(fontsize="small")
            axes.set(title=name, xlabel="z1", ylabel="z2")
            continue
        members = [i for i, call in enumerate(calls) if call.name == name]
        values = [calls[i].parameters[parameter] for i in members]
        words = sorted({v for v in values if isinstance(v, str)})
        colours = [words.index(v) for v in values] if words else values
        points = axes.scatter(*latents[members].T, s=6, c=colours, cmap="tab10" if words else "viridis")
        axes.set(title=f"{name}: {parameter}" + (f" ({', '.join(words)})" if words else ""), xlabel="z1", ylabel="z2")
        if not words:
            figure.colorbar(points)
    figure.savefig(path, dpi=100)
    plt.close(figure)
