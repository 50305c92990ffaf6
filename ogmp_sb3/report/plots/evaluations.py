"""Pictures of evaluations and benchmarks: heat maps, disturbances, terminations, rates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import Rectangle

from ogmp_sb3.evaluation.speed import SpeedRow
from ogmp_sb3.report.plots.style import CAUSE_COLOURS, COLOURS, MODE_COLOURS, colours_of, in_style, save, subplots


@in_style
def plot_grids(grids: list[dict[str, Any]], metric: str, path: Path) -> None:
    """Heat maps of a metric over two mode parameters, the training range outlined (paper, fig:mpt).

    :param grids: each as ``grid`` of an evaluation's ``grid.json``
    :param metric: name of the metric
    :param path: picture to write
    """
    size = (max(3.4 * len(grids), 5.0), 3.0 if len(grids) > 1 else 4.0)
    figure, panels = subplots(1, len(grids), size)
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


@in_style
def plot_robustness(results: list[dict[str, Any]], path: Path) -> None:
    """Fraction of episodes without a fall over the size of each disturbance, with 95 % intervals.

    :param results: ``robustness`` of an evaluation's ``robustness.json``
    :param path: picture to write
    """
    columns = min(len(results), 3)
    rows = -(-len(results) // columns)
    figure, grid = subplots(rows, columns, (3.6 * columns, 2.8 * rows), sharey=True)
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


@in_style
def plot_speeds(speeds: Sequence[SpeedRow], path: Path) -> None:
    """Measured against commanded speed of each mode, in bands of the command if there are, with 95 % intervals.

    :param speeds: of an evaluation
    :param path: picture to write
    """
    modes = dict.fromkeys(row.mode for row in speeds)
    colours = colours_of(modes, MODE_COLOURS)
    figure, ((axes,),) = subplots(1, 1, (4.6, 4.2))
    for mode in modes:
        of_mode = [row for row in speeds if row.mode == mode]
        points = [row for row in of_mode if row.band is not None] or of_mode
        x, y = (np.array([getattr(row, name).mean for row in points]) for name in ("commanded", "measured"))
        ends = np.array([[row.measured.low, row.measured.high] for row in points], dtype=float).T  # None: nan
        colour = colours[mode]
        axes.errorbar(x, y, np.abs(ends - y), fmt="o-", markersize=4, capsize=3, color=colour, label=mode)
    most = 1.1 * max(max(row.commanded.mean, row.measured.mean) for row in speeds)
    axes.plot([0.0, most], [0.0, most], ":", color="0.5", label="as commanded")
    axes.set(xlabel="commanded (m/s)", ylabel="measured (m/s)", xlim=(0.0, most), ylim=(0.0, most), aspect="equal")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    save(figure, path)


@in_style
def plot_epsilon(epsilon: dict[str, Any], path: Path) -> None:
    """Share of whole episodes that stay within a bound over the bound, for each oracle, with 95 % intervals.

    :param epsilon: ``epsilon`` of an evaluation's ``epsilon.json``
    :param path: picture to write
    """
    colours = colours_of(epsilon["maxima"], COLOURS)
    figure, ((axes,),) = subplots(1, 1, (5.5, 3.6))
    for oracle, modes in epsilon["maxima"].items():
        shares = modes["all"]["within"]
        mean = np.array([share["mean"] for share in shares])
        interval = np.array([share["ci95"] for share in shares]).T
        rho, errors, colour = [share["rho"] for share in shares], np.abs(interval - mean), colours[oracle]
        axes.errorbar(rho, mean, errors, marker="o", markersize=4, capsize=3, color=colour, label=oracle)
    trained = epsilon["trained_with"]["rho"]
    if trained is not None:
        axes.axvline(trained, color="0.5", linestyle=":", label=f"trained with ρ = {trained:g}")
    axes.set(xlabel="ρ", ylabel="whole episodes within ρ", ylim=(-0.03, 1.03))
    axes.set_title(f"n = {epsilon['episodes']}")
    axes.grid(alpha=0.3)
    if epsilon["maxima"] or trained is not None:
        axes.legend(loc="lower right")
    save(figure, path)


@in_style
def plot_throughput(title: str, numbers: dict[str, float], path: Path) -> None:
    """Bars of all rates (``..._per_second...``) of a benchmark, its ratios (``..._over_...``) in the title.

    :param numbers: name -> value
    :param path: picture to write
    """
    rates = {name: value for name, value in numbers.items() if "per_second" in name}
    ratios = [f"{name} {value:.2f}" for name, value in numbers.items() if "_over_" in name]
    figure, ((axes,),) = subplots(1, 1, (8, 0.6 + 0.35 * len(rates)))
    bars = axes.barh(list(rates), list(rates.values()), color=COLOURS["lqr"])
    axes.bar_label(bars, fmt="{:,.0f}", padding=3)
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.set(xlabel="per second", title="\n".join([title, *ratios]))
    save(figure, path)


@in_style
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
    figure, ((axes,),) = subplots(1, 1, (10, 0.9 + 0.4 * len(bars)))
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
