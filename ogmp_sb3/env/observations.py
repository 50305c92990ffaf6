"""Observation terms: pure functions of an :class:`~ogmp_sb3.env.view.EnvView`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ogmp_sb3.config.registry import looks_ahead, observations, parameter_units
from ogmp_sb3.env.view import EnvView
from ogmp_sb3.guidance.rotations import (
    quat_conjugate,
    quat_multiply,
    quat_rotate_inverse,
    quat_to_rotvec,
    quat_to_rpy,
)
from ogmp_sb3.guidance.terrain import height_at, scan_points

CLIP = 50.0  # observations are clipped to this many scales, which makes their bounds finite
MAX_POINTS = 1000  # of a terrain scan
HIGHEST = 2.0  # m: a base that is higher looks the same
DEEPEST = 1.0  # m: so does ground further below or above the base's ground


class Part(NamedTuple):
    """A stretch of an observation that holds one quantity."""

    name: str
    unit: str
    size: int
    measured: bool = False
    """whether the robot measures it of itself"""
    sensed: bool = True
    """False for what a controller knows by itself, so that no delay of sensors makes it old"""


@dataclass(frozen=True)
class Signal:
    """One observation term."""

    value: np.ndarray
    """shape (num_envs, size), SI units"""
    scale: np.ndarray
    """typical size of each component, shape (size,): a normaliser must not divide by less"""
    parts: tuple[Part, ...] = ()
    """what stands where, for those who rebuild the observation elsewhere; empty: one quantity without a unit"""

    def parts_of(self, term: str) -> tuple[Part, ...]:
        """What stands where, in order; all of it under the term's name if that does not say."""
        return self.parts or (Part(term, "", len(self.scale)),)


@observations.register()
def proprioception(view: EnvView) -> Signal:
    """Height over the terrain (1), quaternion (4), joint positions, body-frame velocities (3 + 3), joint rates.

    The height is 2 m at most, also where there is no ground.
    """
    height = np.minimum(view.base_pos_w[:, 2] - view.ground_height, HIGHEST)
    joints = view.joint_pos.shape[1]
    parts = (
        Part("base_height", "m", 1, measured=True),
        Part("base_quat", "1", 4, measured=True),
        Part("joint_pos", "rad", joints, measured=True),
        Part("base_linvel_b", "m/s", 3, measured=True),
        Part("base_angvel_b", "rad/s", 3, measured=True),
        Part("joint_vel", "rad/s", joints, measured=True),
    )
    value = np.concatenate(
        [
            height[:, None],
            view.base_quat,
            view.joint_pos,
            view.base_linvel_b,
            view.base_angvel_b,
            view.joint_vel,
        ],
        axis=1,
    )
    scale = np.repeat((0.1, 0.1, 0.3, 0.3, 1.0, 3.0), [part.size for part in parts])
    return Signal(value, scale, parts)


@observations.register()
def joints(view: EnvView) -> Signal:
    """What encoders give: joint positions and rates, in the robot's order."""
    size = view.joint_pos.shape[1]
    parts = (Part("joint_pos", "rad", size, measured=True), Part("joint_vel", "rad/s", size, measured=True))
    return Signal(np.concatenate([view.joint_pos, view.joint_vel], axis=1), np.repeat((0.3, 3.0), size), parts)


@observations.register()
def imu(view: EnvView) -> Signal:
    """What an inertial sensor gives: the direction of gravity (3) and the angular velocity (3), in the body frame.

    Neither heading nor velocity are among it.
    """
    gravity = quat_rotate_inverse(view.base_quat, view.down)
    parts = (Part("gravity_b", "1", 3, measured=True), Part("base_angvel_b", "rad/s", 3, measured=True))
    return Signal(np.concatenate([gravity, view.base_angvel_b], axis=1), np.repeat((0.1, 1.0), 3), parts)


@observations.register()
def heading(view: EnvView) -> Signal:
    """How far the base is turned about the vertical, to the left of the track (1), from -pi to pi.

    What an inertial sensor integrates, or what a person who steers corrects.
    """
    yaw = quat_to_rpy(view.base_quat)[:, 2:]
    return Signal(yaw, np.full(1, 0.1), (Part("heading", "rad", 1, measured=True),))


@observations.register()
def last_action(view: EnvView) -> Signal:
    """The policy's last action, which may not have reached the servos yet; 0 before the first."""
    size = view.action.shape[1]
    return Signal(view.action, np.full(size, 0.1), (Part("last_action", "1", size, sensed=False),))


@observations.register()
def clock(view: EnvView) -> Signal:
    """Sine and cosine of the phase between oracle queries (paper: c_t)."""
    angle = 2.0 * np.pi * view.phase / view.period
    value = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    return Signal(value, np.full(2, 0.7), (Part("clock_sin", "1", 1), Part("clock_cos", "1", 1)))


@observations.register()
@looks_ahead(lambda points, spacing: points * spacing)
@parameter_units(spacing="m")
def height_scan(view: EnvView, points: int, spacing: float) -> Signal:
    """Terrain heights ahead of the base, relative to the terrain under it, from -1 to 1 m (paper: h_t).

    :param points: how many, along +x of the world, the first under the base
    :param spacing: m
    """
    if not 1 <= points <= MAX_POINTS:
        raise ValueError(f"observation 'height_scan' needs 1 to {MAX_POINTS} of 'points', found {points}.")
    heights = height_at(view.terrain, scan_points(view.base_pos_w, points, spacing))
    relative = np.clip(heights - view.ground_height[:, None], -DEEPEST, DEEPEST)
    return Signal(relative, np.full(points, 0.1), (Part("height_scan", "m", points),))


@observations.register()
def reference_error(view: EnvView) -> Signal:
    """Robot's state minus the oracle's present reference (12), in the world frame; what the bound is about.

    The error of the orientation is the rotation vector from the reference to the base. For ``critic_observations``: a
    robot hardly knows where it is.
    """
    turned = quat_to_rotvec(quat_multiply(quat_conjugate(view.reference_quat), view.base_quat))
    error = view.state - view.reference
    parts = (
        Part("rotation_error", "rad", 3),
        Part("position_error", "m", 3),
        Part("angvel_error", "rad/s", 3),
        Part("linvel_error", "m/s", 3),
    )
    return Signal(np.concatenate([turned, error[:, 3:]], axis=1), np.repeat((0.1, 0.1, 1.0, 0.3), 3), parts)


@observations.register()
def commanded_speed(view: EnvView) -> Signal:
    """The heading speed that the mode asks for where the robot is (1): a pace's ``v``, as a joystick would give it."""
    return Signal(view.commanded_speed[:, None], np.full(1, 0.3), (Part("commanded_speed", "m/s", 1),))


@observations.register()
def mode_latent(view: EnvView, both_sides: bool = False) -> Signal:
    """What the task's encoder makes of the coming reference (paper: z_t).

    :param both_sides: also what it makes of the reference's mirror image, so that the observation has one
    """
    size = view.latent.shape[1]
    parts = [Part("mode_latent", "1", size // 2 if both_sides else size)]
    if both_sides:
        parts.append(Part("mirrored_mode_latent", "1", size // 2))
    return Signal(view.latent, np.full(size, 0.5), tuple(parts))
