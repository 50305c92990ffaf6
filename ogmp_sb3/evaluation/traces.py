"""Motion traces: path of the base in a vertical plane, references of the oracle, and the ground (fig:abl_trc)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.guidance.course import START_PLATEAU
from ogmp_sb3.guidance.rotations import quat_rotate


@dataclass(frozen=True)
class Ground:
    """A flat piece of ground in the plane of a trace."""

    mode: str
    """the mode that asked for it; empty for what lies before the first"""
    start: float
    """m along the plane"""
    end: float
    """m along the plane"""
    top: float
    """m"""


@dataclass(frozen=True)
class Trace:
    """One episode in the vertical plane that it moves along."""

    title: str
    """what is special about it"""
    axis: int
    """of the world, along the plane: 0 is x, 1 is y"""
    base: np.ndarray
    """position along the plane and height, shape (steps + 1, 2), m"""
    up: np.ndarray
    """the trunk's upward axis, seen in the plane, shape (steps + 1, 2)"""
    references: list[np.ndarray]
    """the reference of each query up to the next query, each of shape (steps, 2), m"""
    deviation: np.ndarray
    """``||W (x - x_ref)||``, shape (steps + 1,)"""
    ground: list[Ground]
    """the ground, in the order of the modes"""
    ended: str
    """what ended the episode"""
    rho: float | None
    """permissible-state bound of the training; None: none"""
    half_band: float | None
    """how far the bound lets the height stray from the reference, m; None if it does not bound the height"""


def make_trace(record: EpisodeRecord, task: TaskConfig, title: str) -> Trace:
    """Prepare an episode for drawing.

    :param record: the episode
    :param task: the task as it was in training, for the bound
    :param title: what is special about the episode; its length is added
    """
    reference = record.reference_pos_w
    axis = int(np.argmax(np.ptp(reference[:, :2], axis=0)))  # a flip to the side goes along y
    plane = [axis, 2]
    starts = np.flatnonzero(record.phase == 1)
    weight = task.bound.get("z", 0.0)
    distance = round(record.base_pos_w[-1, axis] - record.base_pos_w[0, axis], 1) + 0.0  # not -0.0
    return Trace(
        title=f"{title}, {record.steps} steps, {distance:.1f} m along {'xy'[axis]}",
        axis=axis,
        base=record.base_pos_w[:, plane],
        up=quat_rotate(record.base_quat, np.array([0.0, 0.0, 1.0]))[:, plane],
        references=[part[:, plane] for part in np.split(reference, starts)[1:]],
        deviation=record.deviation,
        ground=_ground(record, task, axis),
        ended=record.termination,
        rho=task.rho,
        half_band=task.rho / weight if task.rho is not None and weight > 0 else None,
    )


def _ground(record: EpisodeRecord, task: TaskConfig, axis: int) -> list[Ground]:
    """The ground that the modes of an episode lay, cut by the plane."""
    calls = record.calls
    segments = [call.segment() for call in calls]
    pieces = [] if segments[0].timed else [Ground("", -START_PLATEAU, 0.0, 0.0)]
    offset = 0.0
    for call, segment in zip(calls, segments, strict=True):
        for plateau in segment.plateaus:
            x0, x1, y0, y1, top = plateau.box(offset, 0.5 * task.track.width)
            start, end = ((x0, x1), (y0, y1))[axis]
            pieces.append(Ground(call.name, start, end, top))
        offset += segment.length
    return pieces


def trace_rows(traces: list[Trace]) -> list[dict[str, Any]]:
    """The traces as a table: one row for each control step."""
    rows = []
    for trace in traces:
        along = "xy"[trace.axis]
        reference = np.concatenate([trace.base[:1], *trace.references])  # nothing was asked for at the start
        query = np.repeat(np.arange(len(trace.references) + 1), [1, *map(len, trace.references)])
        for step, (base, wanted) in enumerate(zip(trace.base, reference, strict=True)):
            rows.append({
                "trace": trace.title, "step": step, "axis": along, "along_m": base[0], "height_m": base[1],
                "query": query[step], "reference_along_m": wanted[0], "reference_height_m": wanted[1],
                "deviation": trace.deviation[step], "ended": trace.ended,
            })  # fmt: skip
    return rows


def ground_rows(traces: list[Trace]) -> list[dict[str, Any]]:
    """The ground under the traces as a table: one row for each piece."""
    return [
        {"trace": trace.title, "mode": piece.mode, "start_m": piece.start, "end_m": piece.end, "top_m": piece.top}
        for trace in traces
        for piece in trace.ground
    ]
