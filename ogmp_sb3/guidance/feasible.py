"""How close a body that can exist comes to a reference: what an oracle errs by at least, by linear programming.

The body is the single rigid body of :mod:`ogmp_sb3.guidance.srb` on the contact schedule that the oracle was given. In
flight it is ballistic and turns at a constant rate. In stance the ground pushes and never pulls, friction is limited,
and the base is between a height at which a robot counts as fallen and one that its legs reach. How hard the ground
pushes has no limit, nor have moments, so mass and inertia do not matter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from ogmp_sb3.guidance.srb import GRAVITY, POS, STATE_SIZE

FRICTION = 1.0  # of the shipped robots and terrain (MuJoCo's default)
LEAST_HEIGHT = 0.6  # of the nominal height: below, HECTOR counts as fallen (0.3 m of 0.5 m, as in the released code)
GREATEST_HEIGHT = 1.35  # of the nominal height: HECTOR's legs are straight (0.68 m of 0.5 m)
STRIDE = 0.15  # m: how far in front of the base or behind it a foot stands
TIE = 1e-3  # weight of each state's greatest error: among the motions that deviate least, one with small errors
TOLERANCE = 1e-3  # of a deviation in several states, for a greatest weight of 1
SOLVED = 1e-6  # of a deviation: less is 0, within the solver's own tolerance
ROUNDS = 30  # of planes; a few are enough
AXES = STATE_SIZE // 2  # positions of all axes, then their velocities
Z = POS.start + 2
ALONG = frozenset((POS.start, POS.start + 1))  # axes that friction acts along


class Footing(NamedTuple):
    """When the feet are on the ground, and where the base can be then."""

    stance: np.ndarray
    """whether the feet are on the ground during each step, shape (steps,), bool"""
    low: np.ndarray
    """least height of the base at each knot, if a stance begins or ends there, shape (steps + 1,), m"""
    high: np.ndarray
    """greatest height of the base, likewise"""


def footing(set_points: np.ndarray, stance: np.ndarray, nominal_height: float, gait_height: float) -> Footing:
    """Where a robot's feet find the ground that its set-points stand over.

    :param set_points: desired state at each knot, shape (steps + 1, 12)
    :param stance: whether the feet are on the ground during each step, shape (steps,), bool
    :param nominal_height: of the robot's base over the ground, m
    :param gait_height: of the set-points over the ground, m
    """
    position = set_points[:, POS]
    touched = _touched(stance)
    touched[0] = True  # the robot comes from somewhere
    apart = np.linalg.norm(position[:, None, :2] - position[None, :, :2], axis=-1)
    near = (touched & (apart <= STRIDE)) | np.eye(len(position), dtype=bool)
    ground = position[:, 2] - gait_height
    low, high = np.where(near, ground, np.inf).min(axis=1), np.where(near, ground, -np.inf).max(axis=1)
    return Footing(stance, low + LEAST_HEIGHT * nominal_height, high + GREATEST_HEIGHT * nominal_height)


def least_deviation(reference: np.ndarray, x0: np.ndarray, weights: np.ndarray, feet: Footing, dt: float) -> float:
    """The least ``max_k ||W (x_k - reference_k)||`` of the feasible motions from a state.

    At the end, the base is not falling so fast that it cannot be stopped within a step over its least height.

    Each axis is a double integrator, which is exact for a body that stays upright or turns about one axis. With one
    weighted state the problem is linear. With several, planes that touch the ball of the norm are added until the
    motion's deviation is within ``TOLERANCE`` of the least (Kelley, J. SIAM 8, 1960).

    :param reference: an oracle's answer, shape (steps + 1, 12)
    :param x0: where motions start, shape (12,)
    :param weights: diagonal of W, shape (12,)
    :param feet: the contact schedule, and where the base can be
    :param dt: control step, s
    :return: infinite if no feasible motion keeps to the contact schedule
    """
    scale = weights.max()
    weighted, weights = np.flatnonzero(weights), weights / scale
    moving = {int(state) % AXES for state in weighted}
    axes = sorted(moving | {Z} if moving & ALONG else moving)
    free, given = _motions(x0, axes, feet.stance, dt)
    rows, limits = _limits(free, given, axes, feet, dt)
    error = (weights * (free - reference))[1:, weighted]  # (steps, weighted)
    given = (weights[:, None] * given)[1:, weighted]  # (steps, weighted, accelerations)
    steps, states, inputs = given.shape
    # The variables are the accelerations, the greatest error of each state, and the deviation.
    cost = np.concatenate([np.zeros(inputs), np.full(states, TIE), [1.0]])
    pushes = np.repeat([axis == Z for axis in axes], feet.stance.sum())
    bounds = [(0.0 if push else None, None) for push in pushes] + [(0.0, None)] * (states + 1)
    flat, own, none = (
        given.reshape(steps * states, inputs),
        np.tile(np.eye(states), (steps, 1)),
        np.zeros((steps * states, 1)),
    )
    A = np.block([
        [rows, np.zeros((len(rows), states + 1))],
        [flat, -own, none],
        [-flat, -own, none],
        [np.zeros((states, inputs)), np.eye(states), -np.ones((states, 1))],
    ])  # fmt: skip
    b = np.concatenate([limits, -error.ravel(), error.ravel(), np.zeros(states)])
    for _ in range(ROUNDS):
        solution = linprog(cost, A_ub=A, b_ub=b, bounds=bounds, method="highs").x
        if solution is None:
            return float("inf")
        motion = error + given @ solution[:inputs]
        deviation = np.linalg.norm(motion, axis=1)
        beyond = np.flatnonzero(deviation > solution[-1] + 0.5 * TOLERANCE)
        if deviation.max() <= solution[-1] + TOLERANCE:
            break
        normal = motion[beyond] / deviation[beyond, None]
        planes = [
            np.einsum("ks,ksi->ki", normal, given[beyond]),
            np.zeros((len(beyond), states)),
            -np.ones((len(beyond), 1)),
        ]
        A, b = np.concatenate([A, np.block([planes])]), np.concatenate([b, -np.sum(normal * error[beyond], axis=1)])
    greatest = float(deviation.max())
    return scale * greatest if greatest > SOLVED else 0.0


def _touched(stance: np.ndarray) -> np.ndarray:
    """The knots at which a step of stance begins or ends, shape (steps + 1,)."""
    touched = np.zeros(len(stance) + 1, dtype=bool)
    touched[:-1] |= stance
    touched[1:] |= stance
    return touched


def _motions(x0: np.ndarray, axes: list[int], stance: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Motions as a linear map of what the ground gives to some axes: an acceleration in each step of stance.

    :return: the motion without any, shape (steps + 1, 12), and the map, shape (steps + 1, 12, accelerations)
    """
    time, begin = dt * np.arange(len(stance) + 1)[:, None], dt * np.flatnonzero(stance)
    free = np.concatenate([x0[:AXES] + time * x0[AXES:], np.repeat(x0[None, AXES:], len(time), axis=0)], axis=1)
    free[:, Z] -= 0.5 * GRAVITY * time[:, 0] ** 2
    free[:, Z + AXES] -= GRAVITY * time[:, 0]
    velocity = np.where(time > begin + 0.5 * dt, dt, 0.0)  # (knots, steps of stance)
    position = velocity * (time - begin - 0.5 * dt)
    given = np.zeros((len(time), STATE_SIZE, len(axes), len(begin)))
    for place, axis in enumerate(axes):
        given[:, axis, place], given[:, axis + AXES, place] = position, velocity
    return free, given.reshape(len(time), STATE_SIZE, len(axes) * len(begin))


def _limits(
    free: np.ndarray, given: np.ndarray, axes: list[int], feet: Footing, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rows ``A`` and limits ``b`` of ``A accelerations <= b``: friction, and the height of the base."""
    if Z not in axes:
        return np.zeros((0, given.shape[-1])), np.zeros(0)
    inputs, steps = given.shape[-1], int(feet.stance.sum())
    by_axis = np.eye(inputs).reshape(len(axes), steps, inputs)
    friction = FRICTION * by_axis[axes.index(Z)]
    rows = [sign * by_axis[axes.index(axis)] - friction for axis in ALONG.intersection(axes) for sign in (1.0, -1.0)]
    limits = [np.zeros(len(each)) for each in rows]
    knots = np.flatnonzero(_touched(feet.stance)[1:]) + 1  # the state at the start is given
    rows += [given[knots, Z], -given[knots, Z]]
    limits += [feet.high[knots] - free[knots, Z], free[knots, Z] - feet.low[knots]]
    stopped, stopping = (each[-1:, Z] + 0.5 * dt * each[-1:, Z + AXES] for each in (free, given))
    return np.concatenate([*rows, -stopping]), np.concatenate([*limits, stopped - feet.low[-1:]])
