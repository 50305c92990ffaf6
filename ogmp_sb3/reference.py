"""Set-points and references, both batched, one knot per control step.

Knot ``k`` is the target after ``k`` control steps. States are those of :mod:`ogmp_sb3.srb`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ogmp_sb3.definitions import GaitConfig
from ogmp_sb3.modes import Contact, Span
from ogmp_sb3.srb import GRAVITY, OMEGA, POS, RPY, STATE_SIZE, VEL

# Columns of a span array: spans of many environments as numbers.
END, VX, VY, GROUND0, GROUND1, CONTACT, APEX, WX0, WY0, WX1, WY1 = range(11)
SPAN_SIZE = 11
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


def hold_row(last: np.ndarray) -> np.ndarray:
    """The span that goes on where another one ends, with its last height, rates and velocity, for ever."""
    held = last.copy()
    held[END] = FOREVER
    held[[GROUND0, WX0, WY0]] = last[[GROUND1, WX1, WY1]]
    held[APEX] = 0.0
    return held


def set_points(
    spans: np.ndarray,
    timed: np.ndarray,
    x0: np.ndarray,
    steps: np.ndarray,
    dt: float,
    gait: GaitConfig,
) -> SetPoints:
    """Lay the set-points of the coming spans out in time, from the robot's present place.

    :param spans: shape (rows, spans, SPAN_SIZE), in order, the last one without end (:func:`hold_row`); ends are m
        along the track or, in timed rows, s from now
    :param timed: which rows are timed, shape (rows,), bool
    :param x0: state at the query, shape (rows, 12)
    :param steps: how far each row looks, shape (rows,), int, control steps
    :param dt: control step, s
    :param gait: base height and hop cycle
    """
    rows, knots = len(spans), int(steps.max())
    ends = _end_times(spans, timed, x0[:, POS.start])  # (rows, spans)
    starts = np.concatenate([np.zeros((rows, 1)), ends[:, :-1]], axis=1)

    time = dt * np.arange(knots + 1)
    at_knot = _span_index(ends, np.maximum(time, 1e-6))  # what ended before now does not count
    middle = time[:-1] + 0.5 * dt
    at_step = _span_index(ends, middle)

    row = np.arange(rows)[:, None]
    here = spans[row, at_knot]  # (rows, knots + 1, SPAN_SIZE)
    begin, finish = starts[row, at_knot], ends[row, at_knot]
    share = np.clip((time - begin) / np.maximum(finish - begin, 1e-9), 0.0, 1.0)

    state = np.zeros((rows, knots + 1, STATE_SIZE))
    step_velocity = spans[row, at_step][..., [VX, VY]]
    moved = np.concatenate([np.zeros((rows, 1, 2)), np.cumsum(step_velocity * dt, axis=1)], axis=1)
    state[..., POS.start : POS.start + 2] = moved
    state[..., POS.start] += x0[:, None, POS.start]
    # On a track the lateral target is the centre line, in a timed mode the place of the query.
    state[..., POS.start + 1] += np.where(timed, x0[:, POS.start + 1], 0.0)[:, None]
    state[..., VEL.start : VEL.start + 2] = here[..., [VX, VY]]

    ground = here[..., GROUND0] + share * (here[..., GROUND1] - here[..., GROUND0])
    bump = (_apex_left(spans, timed, ends - starts))[row, at_knot] * (1.0 - np.abs(2.0 * share - 1.0))
    state[..., POS.start + 2] = gait.height + ground + bump
    state[..., VEL.start + 2] = _vertical_velocity(spans, starts, ends, at_knot, time)

    state[..., OMEGA.start] = here[..., WX0] + share * (here[..., WX1] - here[..., WX0])
    state[..., OMEGA.start + 1] = here[..., WY0] + share * (here[..., WY1] - here[..., WY0])
    mean_rate = 0.5 * (state[:, :-1, OMEGA] + state[:, 1:, OMEGA])
    state[:, 1:, RPY] = np.cumsum(mean_rate * dt, axis=1)

    stance = _stance(spans, starts, ends, at_step, middle, gait.cycle)
    return SetPoints(state, stance, at_step, np.asarray(steps), blend=gait.cycle / dt)


def _end_times(spans: np.ndarray, timed: np.ndarray, x: np.ndarray) -> np.ndarray:
    """When each span ends, s from now, shape (rows, spans); the last one never does."""
    previous = np.concatenate([np.full((len(spans), 1), -FOREVER), spans[:, :-1, END]], axis=1)
    distance = np.maximum(spans[..., END] - np.maximum(previous, x[:, None]), 0.0)
    speed = np.maximum(spans[..., VX], 1e-9)
    ends = np.where(timed[:, None], spans[..., END], np.cumsum(distance / speed, axis=1))
    return np.maximum(ends, 0.0)


def _apex_left(spans: np.ndarray, timed: np.ndarray, duration: np.ndarray) -> np.ndarray:
    """Rise of the set-points over what is left of each span, shape (rows, spans): that of a shorter flight."""
    whole = np.diff(spans[..., END], axis=1, prepend=0.0) / np.maximum(spans[..., VX], 1e-9)
    share = np.where(timed[:, None], 1.0, np.minimum(duration / np.maximum(whole, 1e-9), 1.0))
    return spans[..., APEX] * share**2


def _span_index(ends: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Which span each time lies in, shape (rows, times)."""
    # A knot at the end of a span belongs to it; the last span has no end.
    return (time[None, :, None] > ends[:, None, :-1] + 1e-9).sum(axis=-1)


def _vertical_velocity(
    spans: np.ndarray, starts: np.ndarray, ends: np.ndarray, at_knot: np.ndarray, time: np.ndarray
) -> np.ndarray:
    """Vertical velocity set-points: the lift-off velocity of the coming flight, then ballistic; 0 elsewhere.

    A flight of duration t that ends dh higher starts with g t / 2 + dh / t.
    """
    flight = spans[..., CONTACT] == Contact.FLIGHT
    duration = np.maximum(ends - starts, 1e-9)
    rise = spans[..., GROUND1] - spans[..., GROUND0]
    lift_off = np.where(
        flight & (ends > starts) & (spans[..., END] < FOREVER), 0.5 * GRAVITY * duration + rise / duration, 0.0
    )
    upcoming = np.concatenate([lift_off[:, 1:], np.zeros((len(spans), 1))], axis=1)
    # A flight that is held falls on.
    held = flight & (spans[..., END] >= FOREVER)
    lift_off[:, 1:] = np.where(held[:, 1:], lift_off[:, :-1], lift_off[:, 1:])
    since = np.where(held, np.concatenate([starts[:, :1], starts[:, :-1]], axis=1), starts)
    push_off = np.where(spans[..., CONTACT] == Contact.STANCE, upcoming, 0.0)
    row = np.arange(len(spans))[:, None]
    airborne = lift_off[row, at_knot] - GRAVITY * (time - since[row, at_knot])
    return np.where(flight[row, at_knot], airborne, push_off[row, at_knot])


def _stance(
    spans: np.ndarray, starts: np.ndarray, ends: np.ndarray, at_step: np.ndarray, middle: np.ndarray, cycle: float
) -> np.ndarray:
    """Whether the feet are on the ground in the middle of each step, shape (rows, knots)."""
    duration = ends - starts
    hops = np.maximum(np.round(duration / cycle), 1.0)
    hops += duration / hops > HOP_STRETCH * cycle
    rate = np.where(duration > 0, hops / np.maximum(duration, 1e-9), 0.0)  # hops per second
    row = np.arange(len(spans))[:, None]
    phase = ((middle - starts[row, at_step]) * rate[row, at_step]) % 1.0
    contact = spans[row, at_step, CONTACT]
    return (contact == Contact.STANCE) | ((contact == Contact.HOP) & (phase < 0.5))
