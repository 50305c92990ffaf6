"""Set-points and references, both batched, one knot per control step.

Knot ``k`` is the target after ``k`` control steps. States are those of :mod:`ogmp_sb3.guidance.srb`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ogmp_sb3.config.task import GaitConfig
from ogmp_sb3.guidance.modes import Contact, Span
from ogmp_sb3.guidance.srb import GRAVITY, OMEGA, POS, STATE_SIZE, VEL
from ogmp_sb3.machine import compiled

# Columns of a span array: spans of many environments as numbers.
END, VX, VY, GROUND0, GROUND1, CONTACT, APEX, WX0, WY0, WX1, WY1 = range(11)
SPAN_SIZE = 11
HOP, STANCE, FLIGHT = float(Contact.HOP), float(Contact.STANCE), float(Contact.FLIGHT)
X, ROLL_RATE, XD = POS.start, OMEGA.start, VEL.start  # columns of the state, as the compiled code sees them
FOREVER = 1e9  # m or s: the end of a span without end
HOP_STRETCH = 1.4  # a hop longer than this many nominal cycles is cut in two (released code: 0.35 s / 0.25 s)


@dataclass(frozen=True)
class SetPoints:
    """What modes ask of an oracle over one horizon."""

    state: np.ndarray
    """desired state at each knot, shape (rows, knots + 1, 12)"""
    stance: np.ndarray
    """whether the feet are on the ground during each step, shape (rows, knots), bool"""
    span: np.ndarray
    """which span each step belongs to, shape (rows, knots), int: orientation is averaged over a span"""
    steps: np.ndarray
    """how many steps of each row are meant; the rest is padding, shape (rows,), int"""
    blend: float
    """steps over which a purely kinematic oracle moves from the present state onto the set-points"""


@dataclass(frozen=True)
class Reference:
    """An oracle's answer."""

    state: np.ndarray
    """shape (rows, knots + 1, 12); knot 0 is the state at the query"""
    steps: np.ndarray
    """shape (rows,), int: knots beyond these are padding"""


def span_row(span: Span, offset: float) -> tuple[float, ...]:
    """One span as a row of a span array.

    :param offset: where the mode starts: m along the track, or 0 s
    """
    (wx0, wy0), (wx1, wy1) = span.rates
    return (
        offset + span.end, *span.velocity, *span.ground, float(span.contact), span.apex, wx0, wy0, wx1, wy1,
    )  # fmt: skip


def span_array(rows: list[tuple[float, ...]]) -> np.ndarray:
    """Spans of one environment, the last one held for ever, shape (spans + 1, SPAN_SIZE)."""
    spans = np.zeros((len(rows) + 1, SPAN_SIZE))
    append_spans(spans, 0, np.array(rows), -FOREVER)
    return spans


@compiled
def append_spans(spans, count, new, keep_from):  # type: ignore[no-untyped-def]
    """Add spans to one environment's, in place, and hold the last; spans that end behind ``keep_from`` go.

    The last of those stays: where the span after it starts is known from its end alone. A span that would end before
    the one in front of it ends with it; but if it leads to higher ground, the one in front ends earlier instead.

    :param spans: shape (spans, SPAN_SIZE)
    :param count: how many of them are in use, without the held one
    :param new: shape (n, SPAN_SIZE)
    :param keep_from: m along the track
    :return: how many are in use now, or -1 if there is no room
    """
    kept = 0
    for i in range(count):
        if i + 1 == count or spans[i + 1, END] > keep_from:
            spans[kept] = spans[i]
            kept += 1
    if kept + len(new) >= len(spans):
        return -1
    for i, row in enumerate(new):
        spans[kept] = row
        if kept > 0 and row[END] < spans[kept - 1, END]:
            if i + 1 < len(new) and new[i + 1, GROUND0] > spans[kept - 1, GROUND1]:
                spans[kept - 1, END] = row[END] if kept == 1 else max(row[END], spans[kept - 2, END])
            spans[kept, END] = max(row[END], spans[kept - 1, END])
        kept += 1
    for i in range(kept, len(spans)):
        spans[i] = spans[kept - 1]
        spans[i, END] = FOREVER
        spans[i, GROUND0], spans[i, WX0], spans[i, WY0] = spans[i, GROUND1], spans[i, WX1], spans[i, WY1]
        spans[i, APEX] = 0.0
    return kept


@compiled
def span_speed(spans, rows, at):  # type: ignore[no-untyped-def]
    """The speed along x of the spans that some environments are in, m/s, shape (n,).

    :param spans: of all environments, shape (num_envs, spans, SPAN_SIZE)
    :param rows: environments, shape (n,), int
    :param at: place, m, or time, s, in the unit of the ends, shape (n,)
    """
    speed = np.empty(len(rows))
    for i, row in enumerate(rows):
        here = 0
        while here < spans.shape[1] - 1 and spans[row, here, END] <= at[i]:
            here += 1
        speed[i] = spans[row, here, VX]
    return speed


def set_points(
    spans: np.ndarray,
    timed: np.ndarray,
    x0: np.ndarray,
    steps: np.ndarray,
    dt: float,
    gait: GaitConfig,
) -> SetPoints:
    """Lay the set-points of the coming spans out in time, from the robot's present place.

    :param spans: shape (rows, spans, SPAN_SIZE), in order, the last one without end (:func:`span_array`); ends are m
        along the track or, in timed rows, s from now
    :param timed: which rows are timed, shape (rows,), bool
    :param x0: state at the query, shape (rows, 12)
    :param steps: how far each row looks, shape (rows,), int, control steps
    :param dt: control step, s
    :param gait: base height and hop cycle
    """
    rows, knots = len(spans), int(steps.max())
    state = np.zeros((rows, knots + 1, STATE_SIZE))
    stance, span = np.empty((rows, knots), dtype=np.bool_), np.empty((rows, knots), dtype=np.int64)
    _fill(spans, timed, x0, dt, gait.height, gait.cycle, state, stance, span)
    return SetPoints(state, stance, span, np.asarray(steps), blend=gait.cycle / dt)


@compiled
def _fill(spans, timed, x0, dt, height, cycle, state, stance, span):  # type: ignore[no-untyped-def]
    rows, knots = stance.shape
    count = spans.shape[1]
    start, end = np.empty(count), np.empty(count)
    for row in range(rows):
        _times(spans[row], timed[row], x0[row, X], start, end)
        x, y = x0[row, X], x0[row, X + 1] if timed[row] else 0.0  # on a track the target is the centre line
        roll, pitch = 0.0, 0.0
        at_knot, at_step = 0, 0
        for k in range(knots + 1):
            time = dt * k
            # A knot at the end of a span belongs to it; what ended before now does not count.
            while at_knot < count - 1 and max(time, 1e-6) > end[at_knot] + 1e-9:
                at_knot += 1
            here = spans[row, at_knot]
            share = min(max((time - start[at_knot]) / max(end[at_knot] - start[at_knot], 1e-9), 0.0), 1.0)
            knot = state[row, k]
            knot[ROLL_RATE] = here[WX0] + share * (here[WX1] - here[WX0])
            knot[ROLL_RATE + 1] = here[WY0] + share * (here[WY1] - here[WY0])
            if k > 0:
                roll += 0.5 * dt * (state[row, k - 1, ROLL_RATE] + knot[ROLL_RATE])
                pitch += 0.5 * dt * (state[row, k - 1, ROLL_RATE + 1] + knot[ROLL_RATE + 1])
            knot[0], knot[1] = roll, pitch
            knot[X], knot[X + 1] = x, y
            knot[XD], knot[XD + 1] = here[VX], here[VY]
            rise = _apex_left(spans[row], timed[row], at_knot, end[at_knot] - start[at_knot])
            ground = here[GROUND0] + share * (here[GROUND1] - here[GROUND0])
            knot[X + 2] = height + ground + rise * (1.0 - abs(2.0 * share - 1.0))
            knot[XD + 2] = _vertical_velocity(spans[row], start, end, at_knot, time)
            if k < knots:
                middle = time + 0.5 * dt
                while at_step < count - 1 and middle > end[at_step] + 1e-9:
                    at_step += 1
                span[row, k] = at_step
                stance[row, k] = _on_ground(spans[row, at_step, CONTACT], start[at_step], end[at_step], middle, cycle)
                x += spans[row, at_step, VX] * dt
                y += spans[row, at_step, VY] * dt


@compiled
def _times(spans, timed, x, start, end):  # type: ignore[no-untyped-def]
    """When each span starts and ends, s from now."""
    now, previous = 0.0, -FOREVER
    for i in range(len(spans)):
        start[i] = now
        if timed:
            now = spans[i, END]
        else:
            now += max(spans[i, END] - max(previous, x), 0.0) / max(spans[i, VX], 1e-9)
            previous = spans[i, END]
        end[i] = now


@compiled
def _apex_left(spans, timed, i, duration):  # type: ignore[no-untyped-def]
    """Rise of the set-points over what is left of a span: that of a shorter flight."""
    if timed or spans[i, APEX] == 0.0:
        return spans[i, APEX]
    whole = (spans[i, END] - (spans[i - 1, END] if i > 0 else 0.0)) / max(spans[i, VX], 1e-9)
    return spans[i, APEX] * min(duration / max(whole, 1e-9), 1.0) ** 2


@compiled
def _lift_off(spans, start, end, i):  # type: ignore[no-untyped-def]
    """The velocity that a flight of duration t which ends dh higher starts with, g t / 2 + dh / t; 0 elsewhere."""
    duration = end[i] - start[i]
    if spans[i, CONTACT] != FLIGHT or spans[i, END] >= FOREVER or duration <= 0.0:
        return 0.0
    return 0.5 * GRAVITY * duration + (spans[i, GROUND1] - spans[i, GROUND0]) / duration


@compiled
def _vertical_velocity(spans, start, end, i, time):  # type: ignore[no-untyped-def]
    """The lift-off velocity of the coming flight in the stance before it, then ballistic; 0 elsewhere."""
    if spans[i, CONTACT] == STANCE and i + 1 < len(spans):
        return _lift_off(spans, start, end, i + 1)
    if spans[i, CONTACT] == FLIGHT:
        if spans[i, END] >= FOREVER and i > 0:  # a flight that is held falls on
            return _lift_off(spans, start, end, i - 1) - GRAVITY * (time - start[i - 1])
        return _lift_off(spans, start, end, i) - GRAVITY * (time - start[i])
    return 0.0


@compiled
def _on_ground(contact, start, end, time, cycle):  # type: ignore[no-untyped-def]
    """Whether the feet are on the ground at a time within a span."""
    if contact != HOP:
        return contact == STANCE
    duration = max(end - start, 1e-9)
    hops = max(np.round(duration / cycle), 1.0)
    if duration / hops > HOP_STRETCH * cycle:
        hops += 1.0
    return ((time - start) / duration * hops) % 1.0 < 0.5
