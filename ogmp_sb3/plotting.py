"""Pictures. Only this module and its like import matplotlib; no library module imports them.

A path that ends in ``.png`` gets a picture of that kind; one without an ending gets a ``.png`` and a ``.svg``.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ogmp_sb3.evaluation.traces import Trace
from ogmp_sb3.guidance.sampling import ModeCall

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
TRACE_WIDTH, TRACE_HEIGHT = 9.2, 1.8  # inches: width of motion traces, and the height of one at most
SHORT = 3.0  # m: shorter motions are drawn side by side
UP_EVERY, UP_LENGTH = 4, 0.1  # control steps between strokes along the trunk, and their length in m

plt.rcParams.update({
    "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": "medium", "font.size": 9,
    "legend.frameon": False, "svg.hashsalt": "ogmp_sb3",
})  # fmt: skip


def save(figure: Figure, path: Path, dpi: int = 120) -> None:
    """Write a figure and close it: one file if the path ends in ``.png``, else a ``.png`` and a ``.svg``."""
    if path.suffix == ".png":
        figure.savefig(path, dpi=dpi)
    else:
        figure.savefig(path.with_name(f"{path.name}.png"), dpi=dpi)
        figure.set_layout_engine("none")  # laid out already
        figure.savefig(path.with_name(f"{path.name}.svg"), dpi=dpi, metadata={"Date": None})
    plt.close(figure)


def colours_of(names: Iterable[str], known: dict[str, str]) -> dict[str, str]:
    """A colour for each name: its own if it is known, else the next of a cycle in the order of appearance."""
    others = dict.fromkeys(name for name in names if name not in known)
    return known | dict(zip(others, itertools.cycle(MORE_COLOURS), strict=False))


def plot_grids(grids: list[dict[str, Any]], metric: str, path: Path) -> None:
    """Heat maps of a metric over two mode parameters, the training range outlined (paper, fig:mpt).

    :param grids: each as ``grid`` of an evaluation's ``grid.json``
    :param metric: name of the metric
    :param path: picture to write
    """
    figure, panels = plt.subplots(
        1, len(grids), figsize=(max(3.4 * len(grids), 5.0), 3.0 if len(grids) > 1 else 4.0), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for axes, grid in zip(panels[0], grids, strict=True):
        first, second = grid["axes"]
        a = np.unique([cell[first] for cell in grid["cells"]])
        b = np.unique([cell[second] for cell in grid["cells"]])
        values = np.array([cell["metrics"][metric]["mean"] for cell in grid["cells"]]).reshape(len(a) - 1, len(b) - 1)
        mesh = axes.pcolormesh(a, b, values.T, cmap="viridis", rasterized=True)
        if grid["trained"]:
            (a0, a1), (b0, b1) = grid["trained"][first], grid["trained"][second]
            axes.add_patch(Rectangle((a0, b0), a1 - a0, b1 - b0, fill=False, edgecolor="black", linewidth=2))
        axes.set(title=grid["mode"], xlabel=first, ylabel=second)
        figure.colorbar(mesh)
    figure.suptitle(f"{metric} (black: trained on)", fontsize="medium")
    save(figure, path)


def plot_robustness(results: list[dict[str, Any]], path: Path) -> None:
    """Fraction of episodes without a fall over the size of each disturbance, with 95 % intervals.

    :param results: ``robustness`` of an evaluation's ``robustness.json``
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
    save(figure, path)


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


def plot_terminations(bars: list[tuple[str, dict[str, int]]], path: Path) -> None:
    """What ended the episodes of evaluations, a bar for each.

    :param bars: name of the evaluation; cause -> number of episodes
    :param path: picture to write
    """
    totals = Counter[str]()
    for _, causes in bars:
        totals.update(causes)
    colours = colours_of(totals, CAUSE_COLOURS)
    places, left = np.arange(len(bars))[::-1], np.zeros(len(bars))
    figure, axes = plt.subplots(figsize=(10, 0.9 + 0.4 * len(bars)), layout="constrained")
    for cause, total in totals.most_common():
        shares = np.array([causes.get(cause, 0) / sum(causes.values()) for _, causes in bars])
        label = f"{cause} {total / totals.total():.0%} ({total})"
        axes.barh(places, shares, left=left, height=0.6, color=colours[cause], label=label)
        left += shares
    axes.set(xlim=(0, 1), ylim=(-0.4, len(bars) - 0.6), xlabel="share of the episodes")
    axes.set_yticks(places, [name for name, _ in bars])
    axes.tick_params(left=False)
    axes.spines["left"].set_visible(False)
    axes.legend(ncols=len(totals), loc="lower center", bbox_to_anchor=(0.5, 1.0))
    save(figure, path)


def plot_traces(traces: list[Trace], path: Path) -> None:
    """Motion traces, each with its deviation from the reference below; short ones side by side (paper, fig:abl_trc).

    :param traces: episodes
    :param path: picture to write
    """
    (start, end), (floor, ceiling) = _extent(traces)
    columns = min(len(traces), 3) if end - start < SHORT else 1
    rows, width = -(-len(traces) // columns), TRACE_WIDTH / columns
    more = max(width / TRACE_HEIGHT * (ceiling - floor) - (end - start), 0.0)  # ground around a short motion
    start, end = start - 0.25 * more, end + 0.75 * more
    height = width * (ceiling - floor) / (end - start)  # inches, at the same scale as the width
    figure, grid = plt.subplots(
        2 * rows, columns, figsize=(TRACE_WIDTH + 0.8 * columns, rows * (height + 1.7)), squeeze=False,
        height_ratios=[height, 0.6] * rows, layout="constrained",
    )  # fmt: skip
    for axes in [*grid[::2].flat[len(traces) :], *grid[1::2].flat[len(traces) :]]:
        axes.axis("off")
    largest = max([float(trace.deviation.max()) for trace in traces] + [trace.rho or 0.0 for trace in traces]) or 1.0
    longest = max(len(trace.deviation) for trace in traces)
    colours = colours_of([piece.mode for trace in traces for piece in trace.ground], MODE_COLOURS)
    for trace, above, below in zip(traces, grid[::2].flat, grid[1::2].flat, strict=False):
        _draw_trace(above, trace, floor, colours)
        above.set(title=trace.title, ylabel="height (m)", xlim=(start, end), ylim=(floor, ceiling))
        above.set_xlabel(f"{'xy'[trace.axis]} (m)", labelpad=0)
        above.locator_params(axis="x", nbins=5 if columns > 1 else 12)
        below.plot(trace.deviation, color="0.2", linewidth=1.0)
        if trace.rho is not None:
            below.axhline(trace.rho, color="#d55e00", linestyle="--", linewidth=1.0)
            below.annotate("ρ", (1.0, trace.rho), xycoords=("axes fraction", "data"), color="#d55e00", va="center")
        below.set(ylabel="deviation", xlim=(0, longest), ylim=(0.0, 1.1 * largest))
        below.set_xlabel("control step", labelpad=0)
    figure.align_ylabels()
    handles = legend_entries(list(grid[::2].flat))
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=len(handles))
    save(figure, path)


def legend_entries(panels: list[Axes]) -> dict[str, Any]:
    """The legend entries of several panels by label, each once."""
    return {label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}


def _extent(traces: list[Trace]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where motions and references are, with the ground below, m: along the plane, and in height."""
    along, up = (
        np.concatenate([part[:, i] for trace in traces for part in [trace.base, *trace.references]]) for i in (0, 1)
    )
    floor = min(float(up.min()), -0.25) - 0.05
    return (float(along.min()) - 0.2, float(along.max()) + 0.2), (floor, float(up.max()) + 0.15)


def _draw_trace(axes: Axes, trace: Trace, floor: float, colours: dict[str, str]) -> None:
    for piece in trace.ground:
        width = piece.end - piece.start
        axes.bar(piece.start, piece.top - floor, width, bottom=floor, align="edge", color="0.88", linewidth=0.5)
        level = [piece.top, piece.top]
        axes.plot([piece.start, piece.end], level, color=colours[piece.mode], linewidth=2.5, label=piece.mode or None)
    start = 0
    for part in trace.references:
        if trace.half_band is not None:
            low, high = part[:, 1] - trace.half_band, part[:, 1] + trace.half_band
            axes.fill_between(part[:, 0], low, high, color="#e69f00", alpha=0.15, linewidth=0, label="within ρ")
        axes.plot(*part.T, color="#e69f00", linewidth=1.6, label="reference")
        axes.plot(*trace.base[start], "o", color="#e69f00", markersize=4, label="query")
        start += len(part)
    axes.plot(*trace.base.T, color="black", linewidth=1.2, label="base")
    feet = trace.base[::UP_EVERY]
    strokes = np.stack([feet, feet + UP_LENGTH * trace.up[::UP_EVERY], np.full_like(feet, np.nan)], axis=1)
    axes.plot(*strokes.reshape(-1, 2).T, color="0.45", linewidth=0.7)  # one line, broken at each nan
    fell = trace.ended != "time_limit"
    axes.plot(*trace.base[-1], "x" if fell else ".", color="#d55e00" if fell else "black", markersize=8)
    axes.annotate(trace.ended, trace.base[-1], xytext=(6, 4), textcoords="offset points", fontsize="small")
