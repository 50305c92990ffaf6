"""The oracle's side of a controller in numpy: set-points of a track, preview control, mode latent.

All that it needs is in ``controller.json`` (``guidance``) and in the set-points of the track. It knows the oracle
``preview`` on a track, for a body that stays upright; what the formulas are is in ``docs/concepts.md`` of ogmp_sb3.
"""

from __future__ import annotations

from typing import Any

import numpy as np

GRAVITY = 9.81  # m/s^2
STATE = ("roll", "pitch", "yaw", "x", "y", "z", "wx", "wy", "wz", "vx", "vy", "vz")
INPUT = ("mx", "my", "mz", "fx", "fy", "fz")  # of the axes roll, pitch, yaw, x, y, z
END, VX, VY, GROUND0, GROUND1, CONTACT, APEX = range(7)  # columns of a span of set-points
STANCE, FLIGHT = 1, 2  # contacts; 0 are hops, half stance and half flight
HOP_STRETCH = 1.4  # a hop that lasts longer than this many cycles is cut in two
FOREVER = 1e9


class Preview:
    """The oracle ``preview`` of an exported policy.

    :param info: ``controller.json``
    :raises ValueError: for an oracle that is not this one
    """

    def __init__(self, info: dict[str, Any]) -> None:
        guidance = info.get("guidance")
        if guidance is None:
            raise ValueError(
                "controller.json has no 'guidance': export the policy again, with this version of ogmp_sb3."
            )
        if info["oracle"] != "preview" or info["horizon"] is None:
            raise ValueError(
                f"this example knows the oracle preview on a track, not '{info['oracle']}' of {info['task']}."
            )
        angles = [name for name in guidance["feedback"] if name in STATE[:3]]
        if angles:
            raise ValueError(f"this example knows no oracle that is fed back angles ({', '.join(angles)}).")
        self.dt, self.steps = float(info["control_dt"]), int(info["horizon"])
        self._height, self._cycle = guidance["gait"]["height"], guidance["gait"]["cycle"]
        self._fed_back = np.array([name in guidance["feedback"] for name in STATE])
        parameters = guidance["oracle_params"]
        Q, eps = parameters["Q"], parameters["eps"]
        phases = [Q.get(phase, Q) for phase in ("flight", "stance")]
        weights = np.array([[max(phase.get(name, 0.0), eps) for name in STATE] for phase in phases])
        self._Q = weights.reshape(2, 2, 6)  # contact, position or velocity, axis
        self._R = np.array([parameters["R"][name] for name in INPUT]) / guidance["feet"]
        inverse = 1.0 / np.array([*guidance["srb"]["inertia"], *[guidance["srb"]["mass"]] * 3])
        self._b = np.stack([0.5 * self.dt**2 * inverse, self.dt * inverse])  # (2, 6)
        self._d = np.zeros((2, 6))
        self._d[:, 5] = -0.5 * GRAVITY * self.dt**2, -GRAVITY * self.dt
        self._A = np.array([[1.0, self.dt], [0.0, 1.0]])
        ends = [[_stationary_cost(self._A, self._b[:, j], Q[:, j], self._R[j]) for j in range(6)] for Q in self._Q]
        self._P_end = np.array(ends)  # (2, 6, 2, 2)

    def reference(self, spans: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The reference from a robot's present state, shape (steps + 1, 12); row k is the target after k steps.

        :param spans: set-points of the track, shape (n, 11)
        :param state: roll, pitch, yaw, position, angular and linear velocity in the world, shape (12,)
        """
        x0 = np.where(self._fed_back, state, 0.0)
        points, stance = self.set_points(spans, x0)
        r = points.reshape(-1, 2, 6)
        reference = np.empty_like(r)
        reference[0] = x0.reshape(2, 6)
        for axis in range(6):
            self._follow(axis, r[..., axis], stance, reference[..., axis])
        return reference.reshape(-1, 12)

    def _follow(self, axis: int, r: np.ndarray, stance: np.ndarray, x: np.ndarray) -> None:
        """Preview control of one double integrator; fills in ``x`` (steps + 1, 2) from its first row on."""
        A, b, d, R, N = self._A, self._b[:, axis], self._d[:, axis], self._R[axis], len(stance)
        P = self._P_end[int(stance[-1]), axis]
        v = P @ r[N]
        gains, feed_forward = np.zeros((N, 2)), np.zeros(N)
        for k in range(N - 1, -1, -1):
            w = v - P @ d
            if stance[k]:
                S = R + b @ P @ b
                gains[k], feed_forward[k] = b @ P @ A / S, b @ w / S
            closed, Q = A - np.outer(b, gains[k]), self._Q[int(stance[k]), :, axis]
            v = Q * r[k] + closed.T @ w
            P = np.diag(Q) + A.T @ P @ closed
        for k in range(N):
            x[k + 1] = A @ x[k] + b * (feed_forward[k] - gains[k] @ x[k]) + d

    def set_points(self, spans: np.ndarray, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the modes ask for at each knot (steps + 1, 12), and whether feet are down in each step (steps,)."""
        start, end = _times(spans, x0[3])
        knots, stance = np.zeros((self.steps + 1, 12)), np.zeros(self.steps, dtype=bool)
        x = x0[3]
        for k in range(self.steps + 1):
            i = int(np.argmax(end + 1e-9 >= max(self.dt * k, 1e-6)))
            span = spans[i]
            share = np.clip((self.dt * k - start[i]) / max(end[i] - start[i], 1e-9), 0.0, 1.0)
            ground = span[GROUND0] + share * (span[GROUND1] - span[GROUND0])
            rise = _apex(spans, i, end[i] - start[i]) * (1.0 - abs(2.0 * share - 1.0))
            knots[k, 3], knots[k, 5] = x, self._height + ground + rise
            knots[k, 9], knots[k, 10] = span[VX], span[VY]
            knots[k, 11] = _rising(spans, start, end, i, self.dt * k)
            if k < self.steps:
                middle = self.dt * (k + 0.5)
                j = int(np.argmax(end + 1e-9 >= middle))
                stance[k] = self._on_ground(spans[j, CONTACT], start[j], end[j], middle)
                x += spans[j, VX] * self.dt
                knots[k + 1, 4] = knots[k, 4] + spans[j, VY] * self.dt
        return knots, stance

    def _on_ground(self, contact: float, start: float, end: float, time: float) -> bool:
        if contact:
            return contact == STANCE
        duration = max(end - start, 1e-9)
        hops = max(np.round(duration / self._cycle), 1.0)
        if duration / hops > HOP_STRETCH * self._cycle:
            hops += 1.0
        return bool(((time - start) / duration * hops) % 1.0 < 0.5)


def commanded_speed(spans: np.ndarray, x: float) -> float:
    """The heading speed that the mode asks for at a place, m/s."""
    return float(spans[np.argmax(spans[:, END] > x), VX])


def latent_features(reference: np.ndarray, mirrored: bool = False) -> np.ndarray:
    """What ``encoder.onnx`` sees of a reference of an upright body, shape (knots, 13), float32.

    :param mirrored: of its mirror image across the plane y = 0
    """
    features = np.zeros((len(reference), 13))
    features[:, :3] = reference[:, 3:6]
    features[:, 0] -= reference[0, 3]
    features[:, 3:7] = _quaternions(reference[:, :3])
    features[:, 7:10], features[:, 10:13] = reference[:, 9:12], reference[:, 6:9]
    if mirrored:
        features[:, [1, 4, 6, 8, 10, 12]] *= -1.0  # y, qx, qz, vy, wx, wz
    return features.astype(np.float32)


def _quaternions(rpy: np.ndarray) -> np.ndarray:
    """Quaternions w x y z of roll, pitch and yaw, shape (n, 4)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * rpy).T, np.sin(0.5 * rpy).T
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.stack([w, x, y, z], axis=1)


def _stationary_cost(A: np.ndarray, b: np.ndarray, Q: np.ndarray, R: float) -> np.ndarray:
    """Solution of the discrete Riccati equation, by the structure-preserving doubling algorithm.

    (Chu, Fan, Lin and Wang, Int. J. Control 77, 2004, algorithm 3.1: it converges quadratically.)
    """
    A, G, H = A.copy(), np.outer(b, b) / R, np.diag(Q)
    for _ in range(60):
        W = np.linalg.inv(np.eye(2) + G @ H)
        further = A.T @ H @ W @ A
        A, G, H = A @ W @ A, G + A @ W @ G @ A.T, H + further
        if np.abs(further).max() <= 1e-15 * np.abs(H).max():
            break
    return 0.5 * (H + H.T)


def _times(spans: np.ndarray, x: float) -> tuple[np.ndarray, np.ndarray]:
    """When each span starts and ends, s from now, at the speeds that are asked for."""
    before = np.maximum(np.concatenate([[-FOREVER], spans[:-1, END]]), x)
    end = np.cumsum(np.maximum(spans[:, END] - before, 0.0) / np.maximum(spans[:, VX], 1e-9))
    return np.concatenate([[0.0], end[:-1]]), end


def _apex(spans: np.ndarray, i: int, duration: float) -> float:
    """Rise of the set-points over what is left of a span: that of a shorter flight."""
    if spans[i, APEX] == 0.0:
        return 0.0
    whole = (spans[i, END] - (spans[i - 1, END] if i > 0 else 0.0)) / max(spans[i, VX], 1e-9)
    return float(spans[i, APEX] * min(duration / max(whole, 1e-9), 1.0) ** 2)


def _lift_off(spans: np.ndarray, start: np.ndarray, end: np.ndarray, i: int) -> float:
    """The velocity that a flight starts with; 0 elsewhere."""
    duration = end[i] - start[i]
    if spans[i, CONTACT] != FLIGHT or spans[i, END] >= FOREVER or duration <= 0.0:
        return 0.0
    return float(0.5 * GRAVITY * duration + (spans[i, GROUND1] - spans[i, GROUND0]) / duration)


def _rising(spans: np.ndarray, start: np.ndarray, end: np.ndarray, i: int, time: float) -> float:
    """Vertical velocity: of the coming flight in the stance before it, then ballistic; 0 elsewhere."""
    if spans[i, CONTACT] == STANCE and i + 1 < len(spans):
        return _lift_off(spans, start, end, i + 1)
    if spans[i, CONTACT] == FLIGHT:
        return _lift_off(spans, start, end, i) - GRAVITY * (time - start[i])
    return 0.0
