"""The single rigid body (SRB) the oracles plan with (paper, eq:srb and eq:ssm).

State ``x = [rpy, position, omega, velocity]`` (12; rad, m, rad/s, m/s; world frame), input
``u = [f_1, f_2, tau_1, tau_2]`` (12; N, N m): one force and one overall moment per foot, acting at the centre of
mass, so that the dynamics do not depend on where the feet stand. The paper's 13th state, gravity, is here the
affine term ``d``: ``x_{k+1} = A x_k + B u_k + d``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ogmp_sb3.config.robot import SRB
from ogmp_sb3.guidance.rotations import (
    quat_conjugate,
    quat_multiply,
    quat_to_rotvec,
    rpy_rate_matrix,
    rpy_to_matrix,
    rpy_to_quat,
)

GRAVITY = 9.81  # m/s^2
STATE_SIZE = 12
RPY, POS, OMEGA, VEL = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
# Factors that give mirror images across the plane y = 0: of positions and velocities, of rotations, of a state.
POLAR_MIRROR = np.array([1.0, -1.0, 1.0])
AXIAL_MIRROR = -POLAR_MIRROR
STATE_MIRROR = np.tile(np.concatenate([AXIAL_MIRROR, POLAR_MIRROR]), 2)


def deviation(state: np.ndarray, reference: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted norm ``||W (x - x_ref)||`` of the permissible-state bound (paper, sec. II).

    Roll, pitch and yaw are not subtracted, which means nothing beyond a quarter turn: their error is the rotation
    vector ``log(R_ref^T R)``, from the reference to the state about the reference's body axes. Its components are the
    errors of roll, pitch and yaw where these are small and the reference is upright; its length is at most pi.

    :param state: shape (rows, 12)
    :param reference: shape (rows, 12)
    :param weights: diagonal of W, shape (12,)
    :return: shape (rows,)
    """
    error = state - reference
    if weights[RPY].any():
        inverse = quat_conjugate(rpy_to_quat(reference[:, RPY]))
        error[:, RPY] = quat_to_rotvec(quat_multiply(inverse, rpy_to_quat(state[:, RPY])))
    distance: np.ndarray = np.linalg.norm(weights * error, axis=1)
    return distance


@dataclass(frozen=True)
class SRBDynamics:
    """``x_{k+1} = A x_k + B u_k + d`` over one control step."""

    A: np.ndarray
    """shape (12, 12)"""
    B: np.ndarray
    """shape (12, 12)"""
    d: np.ndarray
    """gravity, shape (12,)"""


def srb_dynamics(srb: SRB, dt: float, mean_rpy: np.ndarray) -> SRBDynamics:
    """Discretise eq:srb about a mean orientation.

    The rotation and the Euler rate matrix are constant, over a span here and over a horizon in the paper; the rest is
    a double integrator, so the zero-order hold used here is exact.

    :param srb: mass properties
    :param dt: length of a control step, s
    :param mean_rpy: shape (3,), rad
    """
    rotation = rpy_to_matrix(mean_rpy)
    inertia_w = rotation @ np.diag(srb.inertia) @ rotation.T
    rates = rpy_rate_matrix(mean_rpy)
    inertia_inverse = np.linalg.inv(inertia_w)

    A = np.eye(STATE_SIZE)
    A[RPY, OMEGA] = dt * rates
    A[POS, VEL] = dt * np.eye(3)

    B = np.zeros((STATE_SIZE, 12))
    for foot in range(2):
        force, moment = slice(3 * foot, 3 * foot + 3), slice(6 + 3 * foot, 9 + 3 * foot)
        B[POS, force] = 0.5 * dt**2 / srb.mass * np.eye(3)
        B[VEL, force] = dt / srb.mass * np.eye(3)
        B[RPY, moment] = 0.5 * dt**2 * rates @ inertia_inverse
        B[OMEGA, moment] = dt * inertia_inverse

    d = np.zeros(STATE_SIZE)
    d[POS.start + 2] = -0.5 * GRAVITY * dt**2
    d[VEL.start + 2] = -GRAVITY * dt
    return SRBDynamics(A, B, d)


@lru_cache(maxsize=16)
def srb_axes(srb: SRB, dt: float) -> tuple[np.ndarray, np.ndarray, float]:
    """An upright body as six double integrators: roll, pitch, yaw, x, y, z.

    :return: the effect of a unit of total moment or force on position and velocity of each axis, shape (6, 2);
        gravity, shape (12,); and ``dt``
    """
    inverse = np.array([1.0 / i for i in srb.inertia] + [1.0 / srb.mass] * 3)
    dynamics = srb_dynamics(srb, dt, np.zeros(3))
    return np.stack([0.5 * dt**2 * inverse, dt * inverse], axis=1), dynamics.d, dt
