"""Which bounds make sense, worked out before any training.

Below ``low``, some reference has no feasible motion inside the bound (:mod:`ogmp_sb3.guidance.feasible`). From ``high``
on, a robot that does something else than its task stays inside, which is a local optimum of the tracking reward. Both
come from asking the task's own oracle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np

from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.course import MAX_LOOKAHEAD, Course
from ogmp_sb3.guidance.feasible import footing, least_deviation
from ogmp_sb3.guidance.oracles import Oracle
from ogmp_sb3.guidance.plans import make_oracle, segment_set_points, start_state
from ogmp_sb3.guidance.sampling import corner_segments, flat_ground
from ogmp_sb3.guidance.set_points import set_points
from ogmp_sb3.guidance.srb import OMEGA, POS, RPY, STATE_SIZE, deviation

CORNERS = 64  # of the modes' ranges; more are thinned out
TRACKS, TRACK_TIME = 8, 2.7  # random tracks, and how much of each is followed, s
FEWEST, MOST = 3, 12  # queries on each
LONGEST = 120  # control steps of a reference that feasible motions are sought for
FLAT = 1.0  # m of flat ground behind a mode along the track; it has no end

STANDING, NOT_TURNING, OTHER_WAY = "standing still", "not turning", "turning the other way"


@dataclass(frozen=True, kw_only=True)
class Behaviour:
    """Something that a robot could do instead of its task."""

    name: str
    """what"""
    least: float
    """deviation from the references of the modes that are the easiest for it, weighted as in the bound"""
    greatest: float
    """and from those of the hardest"""
    weighed: bool = True
    """whether the bound weighs what it changes, in every mode that leaves room for it"""

    def judged(self, rho: float | None) -> str:
        """Its deviation in words, and whether a bound ends it."""
        low, high = _number(self.least), _number(self.greatest)
        if not self.weighed:
            return "the bound does not weigh what it changes"
        if rho is None or rho >= self.greatest:
            verdict = "stays inside the bound"
        elif rho >= self.least:
            verdict = "stays inside the bound in some modes"
        else:
            verdict = "leaves the bound"
        return f"deviates by {low if low == high else f'{low} to {high}'}, {verdict}"


@dataclass(frozen=True, kw_only=True)
class AdmissibleRho:
    """The values of rho that make sense for a task, in the unit of its bound."""

    low: float
    """the greatest of the least deviations of feasible motions from references; infinite if none can be followed"""
    behaviours: tuple[Behaviour, ...]
    """what the modes leave room for"""
    queries: int
    """references that ``low`` is about"""
    left_out: int
    """references whose contact schedule no feasible motion keeps to"""

    @property
    def high(self) -> float:
        """The least deviation of a behaviour that the bound weighs; infinite if there is none."""
        return min((each.least for each in self.behaviours if each.weighed), default=math.inf)

    def judged(self, rho: float | None) -> str:
        """The interval in words, and where a bound lies."""
        if math.isinf(self.low):
            return "unknown: no feasible motion keeps to the contact schedule of any reference"
        names = " and ".join(each.name for each in self.behaviours if each.weighed and each.least == self.high)
        if self.low >= self.high:
            closest = f"no feasible motion comes closer than {_number(self.low)} to some reference"
            return f"none: {closest}, but {names} comes within {_number(self.high)}"
        interval = f"{_number(self.low)} " + ("or more" if math.isinf(self.high) else f"to {_number(self.high)}")
        if rho is None:
            return f"{interval}; rho is off"
        if rho < self.low:
            return f"{interval}; {rho:g} is below: some references cannot be followed so closely"
        permitted = [each.name for each in self.behaviours if each.weighed and each.least <= rho]
        return f"{interval}; {rho:g} is " + (f"above: it permits {', '.join(permitted)}" if permitted else "inside")


def admissible_rho(task: TaskConfig) -> AdmissibleRho:
    """The values of rho that make sense for a task.

    Asked are the corners of the modes' ranges from rest and, along a track, robots that follow their references.
    """
    oracle, weights = make_oracle(task), np.array(task.bound_weights)
    least = [
        _least_deviation(task, asked, weights) for asked in chain(_from_rest(task, oracle), _followed(task, oracle))
    ]
    followed = [each for each in least if math.isfinite(each)]
    return AdmissibleRho(
        low=max(followed, default=math.inf),
        behaviours=_behaviours(task, oracle, weights),
        queries=len(least),
        left_out=len(least) - len(followed),
    )


def standing_deviation(task: TaskConfig) -> tuple[float, float] | None:
    """How far a robot that stands still gets from the references before the next query.

    A bound that is not below this lets it stand for ever, which is a local optimum.

    :return: weighted as in the bound, in the modes that are the easiest and the hardest to stand in; None if the bound
        does not weigh it, or all modes stand
    """
    behaviour = _standing(task)
    return None if behaviour is None or not behaviour.weighed else (behaviour.least, behaviour.greatest)


def standing_still(task: TaskConfig) -> str | None:
    """A sentence on whether the bound allows a robot to stand still; None where the question does not arise."""
    behaviour = _standing(task)
    return None if behaviour is None else behaviour.judged(task.rho)


def _standing(task: TaskConfig) -> Behaviour | None:
    behaviours = _behaviours(task, make_oracle(task), np.array(task.bound_weights))
    return next((each for each in behaviours if each.name == STANDING), None)


def _number(value: float) -> str:
    return f"{value:.2f}" if value == 0.0 or value >= 0.005 else f"{value:.1g}"


class _Asked(NamedTuple):
    """One question to the oracle, and its answer."""

    set_points: np.ndarray
    """shape (steps + 1, 12)"""
    stance: np.ndarray
    """shape (steps,), bool"""
    state: np.ndarray
    """of the robot, shape (12,)"""
    reference: np.ndarray
    """shape (steps + 1, 12)"""


def _from_rest(task: TaskConfig, oracle: Oracle) -> Iterator[_Asked]:
    """Every corner of the modes' ranges, asked by a robot that stands at its start, with flat ground behind."""
    segments = list({repr(segment): segment for segment in corner_segments(task)}.values())  # each once
    for segment in segments[:: math.ceil(len(segments) / CORNERS)]:
        state, last = start_state(task, segment), segment.spans[-1]
        steps = max(round(last.end / task.control_dt), 1) if segment.timed else task.horizon
        assert steps is not None
        behind = [] if segment.timed else [flat_ground(last.velocity[0], FLAT).segment()]
        x0 = _fed_back(task, state)
        points = segment_set_points(task, [segment, *behind], x0, steps)
        yield _Asked(points.state[0], points.stance[0], state[0], oracle(points, x0).state[0])


def _followed(task: TaskConfig, oracle: Oracle) -> Iterator[_Asked]:
    """Random tracks, asked by robots that start at rest and then are where the reference before has led them."""
    if task.horizon is None:
        return
    rng, course = np.random.default_rng(0), Course(task, TRACKS)
    state, steps = np.zeros((TRACKS, STATE_SIZE)), np.full(TRACKS, task.horizon)
    for row in range(TRACKS):
        state[row, POS.start + 2] = task.robot_config.nominal_height + course.begin(row, rng, 1.0)
    for _ in range(int(np.clip(TRACK_TIME / (task.horizon * task.control_dt), FEWEST, MOST))):
        for row in range(TRACKS):
            course.extend(row, state[row, POS.start], rng, 1.0)
        x0 = _fed_back(task, state)
        points = set_points(course.spans, np.zeros(TRACKS, dtype=bool), x0, steps, task.control_dt, task.gait)
        reference = oracle(points, x0).state
        yield from map(_Asked, points.state, points.stance, state, reference)
        if not (np.abs(reference) < MAX_LOOKAHEAD).all():
            return  # an oracle that leads nowhere, or far off the track
        state = reference[:, -1]


def _fed_back(task: TaskConfig, state: np.ndarray) -> np.ndarray:
    return np.where([name in task.feedback for name in STATE_NAMES], state, 0.0)


def _least_deviation(task: TaskConfig, asked: _Asked, weights: np.ndarray) -> float:
    if not np.isfinite(asked.reference).all():
        return math.inf
    stance, knots = asked.stance[:LONGEST], LONGEST + 1
    feet = footing(asked.set_points[:knots], stance, task.robot_config.nominal_height, task.gait.height)
    return least_deviation(asked.reference[:knots], asked.state, weights, feet, task.control_dt)


def _behaviours(task: TaskConfig, oracle: Oracle, weights: np.ndarray) -> tuple[Behaviour, ...]:
    """What a robot could do instead of its task, over the corners of all modes."""
    found: dict[str, list[float]] = {}
    unseen = set()
    for asked in _from_rest(task, oracle):
        if not np.isfinite(asked.reference).all():
            continue
        for name, motion in _instead(asked).items():
            found.setdefault(name, []).append(float(deviation(motion, asked.reference, weights)[1:].max()))
            if not (_moves(asked.set_points, weights) if name == STANDING else found[name][-1] > 0.0):
                unseen.add(name)
    return tuple(
        Behaviour(name=name, least=min(each), greatest=max(each), weighed=name not in unseen)
        for name, each in found.items()
    )


def _instead(asked: _Asked) -> dict[str, np.ndarray]:
    """Motions of a robot that does not do what is asked, each of shape (steps + 1, 12)."""
    motions = {}
    if np.ptp(asked.set_points[:, POS], axis=0).any():
        motions[STANDING] = np.broadcast_to(asked.state, asked.reference.shape)
    if asked.set_points[:, OMEGA].any():
        for name, share in ((NOT_TURNING, 0.0), (OTHER_WAY, -1.0)):
            motions[name] = asked.reference.copy()
            motions[name][:, RPY] *= share
            motions[name][:, OMEGA] *= share
    return motions


def _moves(set_points: np.ndarray, weights: np.ndarray) -> bool:
    """Whether the bound weighs a state that the set-points move."""
    asked, half = weights * set_points, STATE_SIZE // 2
    return bool(np.ptp(asked[:, :half], axis=0).any() or asked[:, half:].any())
