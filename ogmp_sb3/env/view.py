"""What reward, observation and termination terms see: a frozen snapshot of one control step, all environments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ogmp_sb3.guidance.srb import STATE_SIZE
from ogmp_sb3.machine import compiled


@dataclass(frozen=True, kw_only=True)
class EnvView:
    """One control step of all environments. World frame unless the name ends in ``_b`` (body)."""

    base_pos_w: np.ndarray
    """trunk origin, shape (num_envs, 3), m"""
    base_quat: np.ndarray
    """wxyz, body to world, shape (num_envs, 4)"""
    base_linvel_w: np.ndarray
    """shape (num_envs, 3), m/s"""
    base_linvel_b: np.ndarray
    """shape (num_envs, 3), m/s"""
    base_angvel_b: np.ndarray
    """shape (num_envs, 3), rad/s"""
    joint_pos: np.ndarray
    """shape (num_envs, joints), rad"""
    joint_vel: np.ndarray
    """shape (num_envs, joints), rad/s"""
    down: np.ndarray
    """direction of gravity, shape (num_envs, 3); it leans where the ground is said to be a slope"""
    action: np.ndarray
    """the last action, in -1 to 1, shape (num_envs, joints); 0 before the first"""
    torque: np.ndarray
    """PD torque before the limits, shape (num_envs, joints), N m"""
    body_contact: np.ndarray
    """whether anything but a foot touches the terrain, shape (num_envs,), bool"""
    terrain: np.ndarray
    """boxes, shape (num_envs, boxes, 5); see :mod:`ogmp_sb3.guidance.terrain`"""
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
    latent: np.ndarray
    """mode latent of the reference, shape (num_envs, latent size); 0 where it is not observed"""
    phase: np.ndarray
    """control steps since the oracle was asked, shape (num_envs,), int"""
    period: np.ndarray
    """control steps between queries, shape (num_envs,), int"""
    commanded_speed: np.ndarray
    """what the modes ask for along x where the robot is, shape (num_envs,), m/s"""


def srb_state(pose: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The single-rigid-body state of free joints, and the linear velocity in the body frame.

    :param pose: position and quaternion wxyz, shape (rows, 7)
    :param velocity: linear velocity in the world and angular velocity in the body frame, shape (rows, 6)
    :return: shapes (rows, 12) and (rows, 3)
    """
    state, linvel_b = np.empty((len(pose), STATE_SIZE)), np.empty((len(pose), 3))
    _srb_state(pose, velocity, state, linvel_b)
    return state, linvel_b


@compiled
def _srb_state(pose, velocity, state, linvel_b):  # type: ignore[no-untyped-def]
    rotation = np.empty((3, 3))
    for row in range(len(pose)):
        w, x, y, z = pose[row, 3], pose[row, 4], pose[row, 5], pose[row, 6]
        rotation[0] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        rotation[1] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        rotation[2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        state[row, 0] = np.arctan2(rotation[2, 1], rotation[2, 2])
        state[row, 1] = -np.arcsin(min(1.0, max(-1.0, rotation[2, 0])))
        state[row, 2] = np.arctan2(rotation[1, 0], rotation[0, 0])
        for i in range(3):
            state[row, 3 + i] = pose[row, i]
            state[row, 9 + i] = velocity[row, i]
            state[row, 6 + i] = 0.0
            linvel_b[row, i] = 0.0
            for j in range(3):
                state[row, 6 + i] += rotation[i, j] * velocity[row, 3 + j]
                linvel_b[row, i] += rotation[j, i] * velocity[row, j]
