"""Rotations as batched numpy arrays.

Quaternions are ``wxyz``, unit length, body to world (MuJoCo's order). Roll, pitch and yaw mean
``R = Rz(yaw) Ry(pitch) Rx(roll)``. Leading axes are free.
"""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def quat_multiply(a: Array, b: Array) -> Array:
    """Hamilton product ``a b``, shape (..., 4)."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quat_conjugate(q: Array) -> Array:
    """The inverse of a unit quaternion, shape (..., 4)."""
    conjugate: np.ndarray = q * np.array([1.0, -1.0, -1.0, -1.0])
    return conjugate


def quat_rotate(q: Array, v: Array) -> Array:
    """Rotate body vectors ``v`` (..., 3) into the world."""
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def quat_rotate_inverse(q: Array, v: Array) -> Array:
    """Rotate world vectors ``v`` (..., 3) into the body frame."""
    return quat_rotate(quat_conjugate(q), v)


def quat_to_rotvec(q: Array) -> Array:
    """The rotation vector of a quaternion, its axis times its angle in [0, pi], shape (..., 3), rad."""
    q = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    # angle / sine tends to 2 where both vanish
    scale = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0.0)
    vector: np.ndarray = scale * q[..., 1:]
    return vector


def rpy_to_quat(rpy: Array) -> Array:
    """Roll, pitch, yaw (..., 3), rad, to a quaternion (..., 4)."""
    half = 0.5 * np.asarray(rpy, dtype=float)
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(half), -1, 0), np.moveaxis(np.sin(half), -1, 0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def quat_to_rpy(q: Array) -> Array:
    """A quaternion (..., 4) to roll, pitch in [-pi/2, pi/2], yaw (..., 3), rad."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def smallest_rpy(rpy: Array) -> Array:
    """The same orientations by the smaller of their two triples of angles, shape (..., 3), rad.

    Roll, pitch and yaw in [-pi, pi) name an orientation twice, once with a pitch beyond a quarter turn: a body pitched
    by 100 degrees is also one pitched by 80 with half a turn of roll and of yaw.
    """
    other = wrap_angle(rpy * np.array([1.0, -1.0, 1.0]) + np.pi)
    smaller = np.linalg.norm(other, axis=-1, keepdims=True) < np.linalg.norm(rpy, axis=-1, keepdims=True)
    return np.where(smaller, other, rpy)


def rpy_to_matrix(rpy: Array) -> Array:
    """Roll, pitch, yaw (..., 3), rad, to rotation matrices (..., 3, 3), body to world."""
    (cr, cp, cy) = np.moveaxis(np.cos(rpy), -1, 0)
    (sr, sp, sy) = np.moveaxis(np.sin(rpy), -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rpy_rate_matrix(rpy: Array, min_cos_pitch: float = 0.1) -> Array:
    """T with ``d(rpy)/dt = T omega_w``, shape (..., 3, 3).

    T is singular at a pitch of +-90 degrees; there cos(pitch) is held away from zero, with its sign.

    :param rpy: roll, pitch, yaw, shape (..., 3), rad
    :param min_cos_pitch: least magnitude of cos(pitch)
    """
    rpy = np.asarray(rpy, dtype=float)
    pitch, yaw = rpy[..., 1], rpy[..., 2]
    cp = np.cos(pitch)
    cp = np.where(np.abs(cp) < min_cos_pitch, np.copysign(min_cos_pitch, cp), cp)
    sp, cy, sy = np.sin(pitch), np.cos(yaw), np.sin(yaw)
    zero, one = np.zeros_like(cp), np.ones_like(cp)
    rows = [[cy / cp, sy / cp, zero], [-sy, cy, zero], [cy * sp / cp, sy * sp / cp, one]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def wrap_angle(angle: Array) -> Array:
    """An angle in rad, moved into [-pi, pi)."""
    return (np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi
