"""What varies over episodes: the curriculum, how robots begin, and restarts before earlier falls."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ogmp_sb3.config.ranges import ModeRanges, Range
from ogmp_sb3.config.strict import not_negative, positive

REMEMBER_EVERY = 5  # control steps between two moments that are remembered
LONGEST_BEFORE = 1_000  # control steps before a fall; more is a slip of the pen
INITIAL_LIMITS = {"x": 1.0, "y": 1.0, "yaw": 3.15, "joint_pos": 1.0, "velocity": 5.0}  # more is a slip of the pen
MOST_WAITING = 6  # moments that wait to be begun from, of each environment


@dataclass(frozen=True, kw_only=True)
class CurriculumConfig:
    """A schedule on Psi_M, driven by success: each environment has a level from 0 to 1 of its own.

    Level 0 samples the weights and ranges given here, level 1 those of the task, levels between them lie between.
    """

    modes: ModeRanges = field(default_factory=dict)
    """mode parameters at level 0, where they differ from the task's"""
    weights: dict[str, float] = field(default_factory=dict)
    """mode frequencies at level 0, where they differ from the task's"""
    randomisation: ModeRanges = field(default_factory=dict)
    """parameters of disturbances at level 0, where they differ from the task's"""
    step: float = 0.05
    """change of level after an episode"""
    raise_above: float = 0.8
    """an episode that lasts longer than this share of its time limit raises the level"""
    lower_below: float = 0.3
    """a shorter one lowers it"""

    def __post_init__(self) -> None:
        if not 0 <= self.lower_below <= self.raise_above < 1:
            values = f"lower_below {self.lower_below:g}, raise_above {self.raise_above:g}"
            raise ValueError(f"0 <= lower_below <= raise_above < 1 must hold, found {values}.")
        positive("step", self.step)
        not_negative("weights", self.weights)

    def moved(self, level: np.ndarray, lasted: np.ndarray) -> np.ndarray:
        """Levels after an episode each.

        :param level: before it, shape (n,), 0 to 1
        :param lasted: how long it lasted, as a share of its time limit, shape (n,)
        :return: shape (n,), 0 to 1
        """
        change = np.where(lasted > self.raise_above, self.step, np.where(lasted < self.lower_below, -self.step, 0.0))
        moved: np.ndarray = np.clip(level + change, 0.0, 1.0)
        return moved


@dataclass(frozen=True, kw_only=True)
class InitialConfig:
    """How a robot begins an episode; each is a number, ``[low, high]`` drawn uniformly for every episode, or null.

    Null is as it would be without: in the nominal pose, at rest, at the start of the track.
    """

    x: Range | None = None
    """along the track from its start, m"""
    y: Range | None = None
    """beside the track's centre line, m"""
    yaw: Range | None = None
    """heading, rad"""
    joint_pos: Range | None = None
    """added to the nominal position of each joint, drawn for each, rad; joint limits hold"""
    velocity: Range | None = None
    """of the base along each axis of the world, drawn for each, m/s"""

    def __post_init__(self) -> None:
        for name, limit in INITIAL_LIMITS.items():
            range_ = getattr(self, name)
            if range_ is None:
                continue
            _numbers(name, range_)
            for value in (range_.low, range_.high):
                if abs(value) > limit:
                    raise ValueError(f"'{name}' must lie between -{limit:g} and {limit:g}, found {value:g}.")


def _numbers(name: str, range_: Range) -> None:
    if range_.words:
        raise ValueError(f"'{name}' must be a number or [low, high], found {', '.join(range_.words)}.")


@dataclass(frozen=True, kw_only=True)
class RestartConfig:
    """Episodes that begin before a fall, beside those that begin at the start of a track."""

    fraction: float
    """share of the episodes that begin so, as long as there are falls to begin from"""
    before: Range
    """how long before the fall, control steps"""
    per_fall: int = 3
    """episodes for each fall of an episode that began at the start"""
    episode_steps: int = 100
    """their time limit, control steps"""

    def __post_init__(self) -> None:
        if not 0 < self.fraction < 1:
            raise ValueError(f"'fraction' must be above 0 and below 1, found {self.fraction:g}.")
        if self.before.words or self.before.low < REMEMBER_EVERY or self.before.high > LONGEST_BEFORE:
            limits = f"{REMEMBER_EVERY} to {LONGEST_BEFORE}"
            raise ValueError(f"'before' must be control steps from {limits}, found {self.before}.")
        for name, most in (("per_fall", MOST_WAITING), ("episode_steps", None)):
            value = getattr(self, name)
            if value < 1 or (most is not None and value > most):
                limit = f"at least 1 and at most {most}" if most else "at least 1"
                raise ValueError(f"'{name}' must be {limit}, found {value}.")
