"""Modes: one function each, from continuous parameters to terrain and set-points (paper, table:task_def).

A mode says what should happen and knows no oracle. Its parameters are its YAML parameters. A mode is laid along
the track (its spans end at distances) or is timed (its spans end at times and it says so).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

from ogmp_sb3.config.registry import modes, parameter_units
from ogmp_sb3.guidance.srb import GRAVITY
from ogmp_sb3.guidance.terrain import Plateau

Direction = Literal["front", "back", "left", "right"]

BLOCK_LEAD = 0.05  # m: set-points rise this far before a block begins (released code)
BLOCK_TAIL = 0.20  # m: and come down this far behind its end (released code)
FLIP_STANCE = 0.5  # s (released code)
FLIP_RATE = 8.95  # rad/s: rate of the flip off a low block (released code)
FLIP_SPEED = 1.0  # m/s: horizontal speed of a flip (released code)
FLIP_BLOCK = 0.4  # m: side of the square block under a flip (released code)
SETTLE_TIME = 1.2  # s: length of one settling reference (released code)
GROUND_HALF_SIZE = 50.0  # m: of the ground around a block


class Contact(IntEnum):
    """What the feet do during a span."""

    HOP = 0
    """cycles of half stance, half flight"""
    STANCE = 1
    """both feet on the ground"""
    FLIGHT = 2
    """none"""


@dataclass(frozen=True, kw_only=True)
class Span:
    """A stretch of set-points; heights and rates are linear over it."""

    end: float
    """where it ends, from the start of the mode: m along the track, or s if the mode is timed"""
    velocity: tuple[float, float] = (0.0, 0.0)
    """x and y, m/s"""
    ground: tuple[float, float] = (0.0, 0.0)
    """height of the ground that the set-points stand over, at the start and the end, m"""
    contact: Contact = Contact.HOP
    """contact schedule"""
    apex: float = 0.0
    """rise of the set-points above the straight line, half way, m"""
    rates: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    """roll and pitch rate, at the start and at the end, rad/s"""


@dataclass(frozen=True, kw_only=True)
class Segment:
    """What a mode asks for."""

    spans: tuple[Span, ...]
    """set-points in order"""
    plateaus: tuple[Plateau, ...] = ()
    """terrain"""
    length: float = 0.0
    """how much of the track the mode takes, m; 0 if timed"""
    timed: bool = False
    """whether spans end at times"""
    start_height: float = 0.0
    """ground height where an episode that begins with this mode starts, m"""


@modes.register()
@parameter_units(v="m/s", length="m")
def pace(v: float, length: float = 0.6) -> Segment:
    """Run on flat ground.

    :param v: heading speed, m/s
    :param length: m along the track
    """
    return Segment(length=length, plateaus=(Plateau(0.0, length, 0.0),), spans=(Span(end=length, velocity=(v, 0.0)),))


@modes.register()
@parameter_units(w="m", h="m", v="m/s", run_up="m", lead="m", tail="m")
def jump(
    w: float, h: float, v: float = 0.8, run_up: float = 0.45, lead: float = BLOCK_LEAD, tail: float = BLOCK_TAIL
) -> Segment:
    """Jump onto a block and down again.

    :param w: length of the block along the track, m
    :param h: height of the block, m
    :param v: heading speed, m/s
    :param run_up: flat ground before the block, m
    :param lead: how far before the block the set-points rise, m
    :param tail: how far behind its end they come down, m
    """
    end = run_up + w
    return Segment(
        length=end,
        plateaus=(Plateau(0.0, run_up, 0.0), Plateau(run_up, end, h)),
        spans=(
            Span(end=run_up - lead, velocity=(v, 0.0)),
            Span(end=end + tail, velocity=(v, 0.0), ground=(h, h)),
        ),
    )


@modes.register()
@parameter_units(w="m", d="m", v="m/s", run_up="m")
def leap(w: float, d: float, v: float = 0.8, run_up: float = 0.45) -> Segment:
    """Leap over a gap: stance over its first half, flight over the second (released code).

    :param w: length of the gap along the track, m
    :param d: depth of the gap, m
    :param v: heading speed, m/s
    :param run_up: flat ground before the gap, m
    """
    end = run_up + w
    flight_time = 0.5 * w / v if v > 0 else 0.0
    return Segment(
        length=end,
        plateaus=(Plateau(0.0, run_up, 0.0), Plateau(run_up, end, -d)),
        spans=(
            Span(end=run_up, velocity=(v, 0.0)),
            Span(end=run_up + 0.5 * w, velocity=(v, 0.0), contact=Contact.STANCE),
            Span(end=end, velocity=(v, 0.0), contact=Contact.FLIGHT, apex=GRAVITY * flight_time**2 / 8),
        ),
    )


@modes.register()
@parameter_units(h="m", push="s", rate="rad/s", v="m/s", block="m")
def flip(
    r: Direction,
    h: float,
    push: float = FLIP_STANCE,
    rate: float = FLIP_RATE,
    v: float = FLIP_SPEED,
    block: float = FLIP_BLOCK,
) -> Segment:
    """Turn once about the roll or pitch axis while diving off a block.

    :param r: where to: front, back, left or right
    :param h: height of the block, m
    :param push: how long the feet push off, s
    :param rate: of the turn off a low block, rad/s; off a high one it takes as long as the fall
    :param v: horizontal speed, m/s
    :param block: side of the square block, m
    """
    flight_time = max(2 * math.pi / rate - 0.5 * push, math.sqrt(2 * h / GRAVITY))
    rate = 2 * math.pi / (0.5 * push + flight_time)
    # A positive pitch rate turns the head forwards (+x); a positive roll rate turns it to the right (-y).
    turn = {"front": (0.0, rate), "back": (0.0, -rate), "right": (rate, 0.0), "left": (-rate, 0.0)}[r]
    heading = {"front": (1.0, 0.0), "back": (-1.0, 0.0), "right": (0.0, -1.0), "left": (0.0, 1.0)}[r]
    velocity = (v * heading[0], v * heading[1])
    half = 0.5 * block
    return Segment(
        timed=True,
        start_height=h,
        plateaus=(
            Plateau(-GROUND_HALF_SIZE, GROUND_HALF_SIZE, 0.0, GROUND_HALF_SIZE),
            Plateau(-half, half, h, half),
        ),
        spans=(
            Span(end=push, velocity=velocity, ground=(h, h), contact=Contact.STANCE, rates=((0, 0), turn)),
            Span(
                end=push + flight_time,
                velocity=velocity,
                ground=(h, 0.0),
                contact=Contact.FLIGHT,
                rates=(turn, turn),
            ),
        ),
    )


@modes.register()
@parameter_units(time="s")
def settle(time: float = SETTLE_TIME) -> Segment:
    """Stand still where the robot is.

    :param time: length of one reference, s
    """
    return Segment(timed=True, spans=(Span(end=time, contact=Contact.STANCE),))
