"""What reward, observation and termination terms see: a frozen snapshot of one control step, all environments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ogmp_sb3.rotations import wrap_angle
from ogmp_sb3.srb import RPY


@dataclass(frozen=True, kw_only=True)
class EnvView:
    """One control step of all environments. World frame unless the name ends in ``_b`` (body)."""

    base_pos_w: np.ndarray
    """trunk origin, shape (num_envs, 3), m"""
    base_quat: np.ndarray
    """wxyz, body to world, shape (num_envs, 4)"""
    base_linvel_w: np.ndarray
    """shape (num_envs, 3), m/s"""
    base_angvel_b: np.ndarray
    """shape (num_envs, 3), rad/s"""
    joint_pos: np.ndarray
    """shape (num_envs, joints), rad"""
    joint_vel: np.ndarray
    """shape (num_envs, joints), rad/s"""
    torque: np.ndarray
    """PD torque before the limits, shape (num_envs, joints), N m"""
    body_contact: np.ndarray
    """whether anything but a foot touches the terrain, shape (num_envs,), bool"""
    terrain: np.ndarray
    """boxes, shape (num_envs, boxes, 5); see :mod:`ogmp_sb3.terrain`"""
    ground_height: np.ndarray
    """terrain under the base, shape (num_envs,), m"""
    state: np.ndarray
    """single-rigid-body state, shape (num_envs, 12)"""
    reference: np.ndarray
    """the oracle's knot of this step, shape (num_envs, 12)"""
    reference_quat: np.ndarray
    """its orientation, shape (num_envs, 4)"""
    deviation: np.ndarray
    """weighted distance to the reference, shape (num_envs,)"""
    phase: np.ndarray
    """control steps since the oracle was asked, shape (num_envs,), int"""
    period: np.ndarray
    """control steps between queries, shape (num_envs,), int"""


def deviation(state: np.ndarray, reference: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted norm ``||W (x - x_ref)||`` of the permissible-state bound (paper, sec. II).

    :param state: shape (num_envs, 12)
    :param reference: shape (num_envs, 12)
    :param weights: diagonal of W, shape (12,)
    :return: shape (num_envs,)
    """
    error = state - reference
    if weights[RPY].any():
        error[:, RPY] = wrap_angle(error[:, RPY])
    return np.linalg.norm(weights * error, axis=1)
