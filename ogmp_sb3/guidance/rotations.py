"""Rotations as batched numpy arrays.

Quaternions are ``wxyz``, unit length, body to world (MuJoCo's order). Roll, pitch and yaw mean
``R = Rz(yaw) Ry(pitch) Rx(roll)``. Leading axes are free.
"""

from __future__ import annotations

import numpy as np

from ogmp_sb3.machine import compiled

Array = np.ndarray


def quat_multiply(a: Array, b: Array) -> Array:
    """Hamilton product ``a b``, shape (..., 4)."""
    if np.shape(a) != np.shape(b):
        a, b = np.broadcast_arrays(a, b)
    product = np.empty(np.shape(a))
    _quat_multiply(_rows(a), _rows(b), product.reshape(-1, 4))
    return product


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
    vector = np.empty((*np.shape(q)[:-1], 3))
    _quat_to_rotvec(_rows(q), vector.reshape(-1, 3))
    return vector


def rpy_to_quat(rpy: Array) -> Array:
    """Roll, pitch, yaw (..., 3), rad, to a quaternion (..., 4)."""
    quat = np.empty((*np.shape(rpy)[:-1], 4))
    _rpy_to_quat(_rows(rpy), quat.reshape(-1, 4))
    return quat


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


def _rows(vectors: Array) -> Array:
    """Vectors of any leading shape, one behind the other, for compiled code."""
    vectors = np.ascontiguousarray(vectors, dtype=float)
    return vectors.reshape(-1, vectors.shape[-1])


@compiled
def _quat_multiply(a, b, product):  # type: ignore[no-untyped-def]
    for i in range(len(product)):
        aw, ax, ay, az = a[i]
        bw, bx, by, bz = b[i]
        product[i, 0] = aw * bw - ax * bx - ay * by - az * bz
        product[i, 1] = aw * bx + ax * bw + ay * bz - az * by
        product[i, 2] = aw * by - ax * bz + ay * bw + az * bx
        product[i, 3] = aw * bz + ax * by - ay * bx + az * bw


@compiled
def _quat_to_rotvec(quat, vector):  # type: ignore[no-untyped-def]
    for i in range(len(quat)):
        w, x, y, z = quat[i]
        sine = np.sqrt(x * x + y * y + z * z)
        # The angle over the sine, which tends to 2 where both vanish; q and -q are the same rotation.
        scale = 2.0 * np.arctan2(sine, abs(w)) / sine if sine > 0.0 else 2.0
        if w < 0.0:
            scale = -scale
        for j in range(3):
            vector[i, j] = scale * quat[i, 1 + j]


@compiled
def _rpy_to_quat(rpy, quat):  # type: ignore[no-untyped-def]
    for i in range(len(rpy)):
        cr, cp, cy = np.cos(0.5 * rpy[i, 0]), np.cos(0.5 * rpy[i, 1]), np.cos(0.5 * rpy[i, 2])
        sr, sp, sy = np.sin(0.5 * rpy[i, 0]), np.sin(0.5 * rpy[i, 1]), np.sin(0.5 * rpy[i, 2])
        quat[i, 0] = cr * cp * cy + sr * sp * sy
        quat[i, 1] = sr * cp * cy - cr * sp * sy
        quat[i, 2] = cr * sp * cy + sr * cp * sy
        quat[i, 3] = cr * cp * sy - sr * sp * cy
