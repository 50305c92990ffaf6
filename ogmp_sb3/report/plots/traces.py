"""Motion traces: the way of the base, its references and the ground (paper, fig:abl_trc)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ogmp_sb3.evaluation.traces import Trace
from ogmp_sb3.report.plots.style import MODE_COLOURS, colours_of, in_style, legend_entries, save, subplots

TRACE_WIDTH, TRACE_HEIGHT = 9.2, 1.8  # inches: width of motion traces, and the height of one at most
SHORT = 3.0  # m: shorter motions are drawn side by side
UP_EVERY, UP_LENGTH = 4, 0.1  # control steps between strokes along the trunk, and their length in m


@in_style
def plot_traces(traces: list[Trace], path: Path) -> None:
    """Motion traces, each with its deviation from the reference below (paper, fig:abl_trc).

    Motions along a track have one axis for both, the way. Short ones, as a dive, are drawn side by side, and their
    deviation over the control steps: most of it is where the robot hardly moves along.

    :param traces: episodes
    :param path: picture to write
    """
    (start, end), (floor, ceiling) = _extent(traces)
    short = end - start < SHORT
    columns = min(len(traces), 3) if short else 1
    rows, width = -(-len(traces) // columns), TRACE_WIDTH / columns
    more = max(width / TRACE_HEIGHT * (ceiling - floor) - (end - start), 0.0)  # ground around a short motion
    start, end = start - 0.25 * more, end + 0.75 * more
    height = width * (ceiling - floor) / (end - start)  # inches, at the same scale as the width
    size = (TRACE_WIDTH + 0.8 * columns, rows * (height + 1.7))
    figure, grid = subplots(2 * rows, columns, size, height_ratios=[height, 0.6] * rows)
    for axes in [*grid[::2].flat[len(traces) :], *grid[1::2].flat[len(traces) :]]:
        axes.axis("off")
    largest = max([float(trace.deviation.max()) for trace in traces] + [trace.rho or 0.0 for trace in traces]) or 1.0
    longest = max(len(trace.deviation) for trace in traces)
    colours = colours_of([piece.mode for trace in traces for piece in trace.ground], MODE_COLOURS)
    for trace, above, below in zip(traces, grid[::2].flat, grid[1::2].flat, strict=False):
        _draw_trace(above, trace, floor, colours)
        above.set(title=trace.title, ylabel="height (m)", xlim=(start, end), ylim=(floor, ceiling))
        above.locator_params(axis="x", nbins=5 if columns > 1 else 12)
        way = f"{'xy'[trace.axis]} (m)"
        if short:
            above.set_xlabel(way, labelpad=0)
            below.plot(trace.deviation, color="0.2", linewidth=1.0)
            below.set(xlim=(0, longest))
        else:
            above.tick_params(labelbottom=False)
            below.plot(trace.base[:, 0], trace.deviation, color="0.2", linewidth=1.0)
            below.sharex(above)
        if trace.rho is not None:
            below.axhline(trace.rho, color="#d55e00", linestyle="--", linewidth=1.0)
            below.annotate("ρ", (1.0, trace.rho), xycoords=("axes fraction", "data"), color="#d55e00", va="center")
        below.set(ylabel="deviation", ylim=(0.0, 1.1 * largest))
        below.set_xlabel("control step" if short else way, labelpad=0)
    figure.align_ylabels()
    handles = legend_entries(list(grid[::2].flat))
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=len(handles))
    save(figure, path)


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
