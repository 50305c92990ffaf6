"""Oracles: from set-points and the robot's present state to a reference (paper, eq:oracle_def).

``linear`` interpolates and knows no dynamics. ``lqr`` and ``preview`` forward-simulate the single rigid body of
:mod:`ogmp_sb3.guidance.srb` under the input of a quadratic tracker whose reference is the set-points; in flight the
input is zero. Only ``preview`` sees what is coming. An oracle knows no mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np

from ogmp_sb3.config.registry import oracles
from ogmp_sb3.config.robot import INPUT_NAMES, SRB, STATE_NAMES
from ogmp_sb3.config.weights import InputWeights, PhaseWeights, Positive, TrackingWeights
from ogmp_sb3.guidance.riccati import tracking_gains
from ogmp_sb3.guidance.set_points import Reference, SetPoints
from ogmp_sb3.guidance.srb import GRAVITY, OMEGA, POS, RPY, STATE_SIZE, VEL, srb_axes, srb_dynamics
from ogmp_sb3.guidance.tracking import simulate_lqr, simulate_preview, simulate_preview_upright

Oracle = Callable[[SetPoints, np.ndarray], Reference]

ORIENTATION_STEP = 0.05  # rad: mean orientations of contact segments are rounded to this, so that gains are reused
MODEL_FEET = 2  # of the single rigid body as the paper writes it


@dataclass(frozen=True)
class Plant:
    """What an oracle plans with."""

    srb: SRB
    """single rigid body"""
    dt: float
    """control step = distance of knots, s"""
    feet: int = 2
    """how many feet of the robot share the total force and moment"""


Orientation = tuple[float, float, float]
FrozenWeights = tuple[tuple[str, float], ...]  # by name, as keys of what is kept
UPRIGHT: Orientation = (0.0, 0.0, 0.0)


@oracles.register()
def linear(set_points: SetPoints, x0: np.ndarray, plant: Plant) -> Reference:
    """Interpolate from the present state onto the set-points; velocities are differences of positions.

    :param set_points: what the modes ask for
    :param x0: state at the query, shape (rows, 12)
    :param plant: only its time step is used
    """
    state = set_points.state.copy()
    knots = state.shape[1]
    # The lateral offset goes over the whole horizon, the height over one hop.
    over = np.ones((len(state), 1, 3))
    over[:, 0, 1], over[:, 0, 2] = set_points.steps, set_points.blend
    left = np.maximum(1.0 - np.arange(knots)[:, None] / over, 0.0)
    state[..., POS] += left * (x0[:, None, POS] - state[:, :1, POS])
    state[:, 1:, VEL] = np.diff(state[..., POS], axis=1) / plant.dt
    state[:, 0] = x0
    return Reference(state, set_points.steps)


@oracles.register()
def lqr(
    set_points: SetPoints, x0: np.ndarray, plant: Plant, Q: TrackingWeights, R: InputWeights, eps: Positive
) -> Reference:
    """Track the present set-point with the stationary LQR gain of each contact segment.

    In stance ``u_k = -K (x_k - r_k) + u_g`` with ``K`` from ``control.dlqr`` and ``u_g`` carrying the weight; where
    ``r`` is at rest this is the same as holding it constant in :func:`preview`, but for the end of the horizon,
    where ``preview`` no longer has to carry the weight.

    :param set_points: what the modes ask for
    :param x0: state at the query, shape (rows, 12)
    :param plant: what to plan with
    :param Q: tracking weights by state name; of weights for each phase of contact, those of stance count
    :param R: input weights of one foot by input name
    :param eps: least weight of a state, and that of those that Q does not name
    """
    index, orientations = _mean_orientations(set_points)
    A, B, d = _models(plant, orientations)
    weights = _freeze(phase_weights(Q)["stance"]), _freeze(R), eps
    K = np.stack([_total_gain(plant, *weights, mean_rpy)[0] for mean_rpy in orientations])
    hover = np.zeros(6)
    hover[2] = plant.srb.mass * GRAVITY
    state = simulate_lqr(A, B, d, K, hover, index, set_points.stance, set_points.state, x0)
    return Reference(state, set_points.steps)


@oracles.register()
def preview(
    set_points: SetPoints, x0: np.ndarray, plant: Plant, Q: TrackingWeights, R: InputWeights, eps: Positive
) -> Reference:
    """Track all coming set-points with the least quadratic cost over the horizon (preview control).

    Backward over the horizon from ``P_N = P`` (of ``control.dlqr``) and ``v_N = P r_N``, with ``w = v_{k+1} -
    P_{k+1} d``, in stance ``u_k = -K_k x_k + (R + B^T P_{k+1} B)^-1 B^T w`` and ``v_k = Q r_k + (A - B K_k)^T w``.
    (Anderson and Moore, *Optimal Control: Linear Quadratic Methods*, ch. 4; Katayama et al., Int. J. Control 41, 1985.)
    ``Q`` of a knot is that of the contact phase of the step that begins there, and ``P`` that of the last step's, so a
    horizon that ends in flight is judged at its end by what flight is judged by.
    Inside a long stance P and K are the stationary ones. In flight the input is zero and the same recursion runs
    with ``B = 0``, so a stance prepares for the flight after it: the result is the optimum over the whole contact
    schedule, not just within one segment.

    :param set_points: what the modes ask for
    :param x0: state at the query, shape (rows, 12)
    :param plant: what to plan with
    :param Q: tracking weights by state name, for both phases of contact or for each
    :param R: input weights of one foot by input name
    :param eps: least weight of a state, and that of those that Q does not name
    """
    index, orientations = _mean_orientations(set_points)
    phases = phase_weights(Q)
    weights = _preview_weights(plant, _freeze(phases["flight"]), _freeze(phases["stance"]), _freeze(R), eps)
    if len(orientations) == 1:
        dynamics = srb_axes(plant.srb, plant.dt)
        state = simulate_preview_upright(*dynamics, *weights, set_points.stance, set_points.state, set_points.steps, x0)
    else:
        A, B, d = _models(plant, orientations)
        state = simulate_preview(A, B, d, *weights, index, set_points.stance, set_points.state, set_points.steps, x0)
    return Reference(state, set_points.steps)


@lru_cache(maxsize=64)
def _preview_weights(
    plant: Plant, flight: FrozenWeights, stance: FrozenWeights, R: FrozenWeights, eps: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diagonals of Q in flight and in stance, (2, 12), that of R, (6,), and the costs of the end, (2, 12, 12)."""
    P_end = np.stack([_total_gain(plant, named, R, eps, UPRIGHT)[1] for named in (flight, stance)])
    Q = np.stack([state_weights(dict(named), eps) for named in (flight, stance)])
    return Q, input_weights(dict(R)) / plant.feet, P_end


def phase_weights(Q: TrackingWeights) -> PhaseWeights:
    """Weights for each phase of contact; those that are not told apart are the same in both."""
    if "stance" in Q:
        return cast(PhaseWeights, Q)
    return {"stance": Q, "flight": Q}


def state_weights(Q: dict[str, float], eps: float) -> np.ndarray:
    """Diagonal of Q, shape (12,): the named weights, at least ``eps``."""
    return np.array([max(Q.get(name, 0.0), eps) for name in STATE_NAMES])


def input_weights(R: dict[str, float]) -> np.ndarray:
    """Diagonal of R of one foot, shape (6,)."""
    return np.array([R[name] for name in INPUT_NAMES])


def _freeze(weights: dict[str, float]) -> FrozenWeights:
    return tuple(sorted(weights.items()))


def stationary_gains(
    plant: Plant, Q: dict[str, float], R: dict[str, float], eps: float, mean_rpy: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Feedback of 12 inputs and cost of one contact segment (:func:`~ogmp_sb3.guidance.riccati.tracking_gains`).

    The model has two feet. A robot with n spreads the same total over n, as two feet of 2/n times the weight would.
    """
    one_foot = input_weights(R) * MODEL_FEET / plant.feet
    both = np.concatenate([np.tile(one_foot[:3], MODEL_FEET), np.tile(one_foot[3:], MODEL_FEET)])
    dynamics = srb_dynamics(plant.srb, plant.dt, np.array(mean_rpy))
    return tracking_gains(dynamics, np.diag(state_weights(Q, eps)), np.diag(both))


@lru_cache(maxsize=4096)
def _total_gain(
    plant: Plant, Q: FrozenWeights, R: FrozenWeights, eps: float, mean_rpy: Orientation
) -> tuple[np.ndarray, np.ndarray]:
    """Stationary feedback of the total force and moment, shape (6, 12), and the stationary cost, shape (12, 12).

    Both feet enter the model alike, so each carries half of the total: 6 inputs with half the weight of one foot
    give the same trajectory as 12.
    """
    K, P = stationary_gains(plant, dict(Q), dict(R), eps, mean_rpy)
    forces, moments = K[:6].reshape(MODEL_FEET, 3, STATE_SIZE), K[6:].reshape(MODEL_FEET, 3, STATE_SIZE)
    return np.concatenate([forces.sum(axis=0), moments.sum(axis=0)]), P


@lru_cache(maxsize=4096)
def _model(plant: Plant, mean_rpy: Orientation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (12, 12), B of the total force and moment (12, 6), and d (12,)."""
    dynamics = srb_dynamics(plant.srb, plant.dt, np.array(mean_rpy))
    return dynamics.A, np.ascontiguousarray(dynamics.B[:, [0, 1, 2, 6, 7, 8]]), dynamics.d


def _models(plant: Plant, orientations: list[Orientation]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The models of several orientations, stacked; gravity is the same for all."""
    models = [_model(plant, mean_rpy) for mean_rpy in orientations]
    return np.stack([m[0] for m in models]), np.stack([m[1] for m in models]), models[0][2]


def _mean_orientations(set_points: SetPoints) -> tuple[np.ndarray, list[Orientation]]:
    """The mean orientations of all spans, and which one each step is in, shape (rows, knots)."""
    index = np.zeros(set_points.stance.shape, dtype=np.int64)
    orientations = [UPRIGHT]
    for row in np.flatnonzero(np.any(set_points.state[..., OMEGA] != 0.0, axis=(1, 2))):
        rpy = 0.5 * (set_points.state[row, :-1, RPY] + set_points.state[row, 1:, RPY])
        for span in np.unique(set_points.span[row]):
            steps = set_points.span[row] == span
            mean = np.round(rpy[steps].mean(axis=0) / ORIENTATION_STEP) * ORIENTATION_STEP
            key = (float(mean[0]), float(mean[1]), float(mean[2]))
            if key not in orientations:
                orientations.append(key)
            index[row, steps] = orientations.index(key)
    return index, orientations
