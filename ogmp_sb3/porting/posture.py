"""The pose that a robot stands in: a keyframe of its file, or a crouch with its feet flat under its centre of mass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from ogmp_sb3.env.ground_contacts import geom_extents, touching, with_all_below
from ogmp_sb3.env.servos import ONE_AXIS
from ogmp_sb3.guidance.rotations import quat_conjugate, quat_multiply, quat_to_rotvec
from ogmp_sb3.porting.anatomy import Anatomy, Leg, lowest_point

HOME = "home"  # the keyframe that Menagerie's robots stand in
BENT = 0.02  # share of its length by which a leg is shorter where it does not count as straight
LOWER = {2: 0.12, 4: 0.25}  # how much lower than on straight legs, in leg lengths, by the number of legs
WITH_ANKLE = 3  # joints of a leg that bend it forwards: hip, knee, and an ankle that keeps the sole level
BEND = 0.6  # rad: of a knee, to begin with
SIDEWAYS = 0.8  # cosine between the axis of a joint and the y axis, from which it bends the leg forwards
FLAT = 0.1  # m: how much a foot that is turned by 1 rad counts, beside one that is elsewhere
DAMPING = 1e-4
STEPS, TURN = 200, 0.2  # of the search; rad at most in one of them
LEVEL = 0.02  # share of a leg's height: what is lower than this above the lowest of a foot is of its sole
CLOSE = 0.003  # leg lengths that a foot may be from where it should stand
MARGIN = 0.02  # of a joint's range, that it keeps from its ends
COM_ROUNDS = 6


@dataclass(frozen=True)
class Posture:
    """A pose on flat ground."""

    source: str
    """where it is from, for people"""
    qpos: np.ndarray
    """positions of all joints, with the base where it stands"""
    height: float
    """of the base over the ground, m"""


def find_posture(model: mujoco.MjModel, anatomy: Anatomy) -> Posture:
    """The keyframe ``home``; else the first one on bent legs; else a crouch.

    :raises ValueError: if the legs cannot reach a crouch
    """
    names = sorted((model.key(i).name for i in range(model.nkey)), key=lambda name: name != HOME)
    poses = [keyframe(model, anatomy, name) for name in names]
    for name, pose in zip(names, poses, strict=True):
        if name == HOME or _bent(model, anatomy, pose.qpos) > BENT:
            return pose
    return crouch(model, anatomy, poses[0].qpos if poses else model.qpos0)


def keyframe(model: mujoco.MjModel, anatomy: Anatomy, name: str) -> Posture:
    """A pose of the model's file."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(name).id)
    return _standing(model, data, anatomy, f"keyframe '{name}'")


def crouch(model: mujoco.MjModel, anatomy: Anatomy, start: np.ndarray) -> Posture:
    """A crouch from a pose on straight legs: every foot as it was turned, under the centre of mass.

    :param start: positions of all joints, shape (nq,)
    :raises ValueError: if the legs cannot reach there
    """
    data = mujoco.MjData(model)
    data.qpos[:] = upright(model, anatomy, start)
    mujoco.mj_kinematics(model, data)
    length = leg_length(model, data, anatomy.legs[0])
    lower = LOWER[4 if len(anatomy.legs) > 2 else 2] * length
    soles = [_sole(model, data, leg) for leg in anatomy.legs]
    targets = np.array([_place(model, data, sole) for sole in soles])
    targets[:, 2] += lower
    turned = [data.xquat[sole.body].copy() for sole in soles]
    for leg in anatomy.legs:
        _bend(model, data, leg)
    for _ in range(COM_ROUNDS):
        off = [_reach(model, data, *of) for of in zip(anatomy.legs, soles, targets, turned, strict=True)]
        mujoco.mj_comPos(model, data)
        middle = np.mean([_place(model, data, sole)[0] for sole in soles])
        targets[:, 0] += data.subtree_com[model.body(anatomy.base).id, 0] - middle
    if max(off) > CLOSE * length:
        foot = anatomy.legs[int(np.argmax(off))].foot
        raise ValueError(
            f"the legs do not reach a crouch: foot '{foot}' stays {max(off):.3f} m from where it should stand. "
            f"Give the feet (feet=[...]) if '{foot}' is none, or the model a keyframe '{HOME}' in which it stands."
        )
    return _standing(model, data, anatomy, f"crouch, {lower:.2f} m below straight legs")


def upright(model: mujoco.MjModel, anatomy: Anatomy, qpos: np.ndarray) -> np.ndarray:
    """A pose with the base level and heading along x, wherever the file has it."""
    qpos = qpos.copy()
    at = model.jnt_qposadr[model.body(anatomy.base).jntadr[0]]
    qpos[at + 3 : at + 7] = 1.0, 0.0, 0.0, 0.0
    return qpos


def bends_forwards(model: mujoco.MjModel, anatomy: Anatomy, qpos: np.ndarray) -> bool:
    """Whether the legs of three joints or more have two that bend them forwards, along x."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    return all(len(leg.joints) < WITH_ANKLE or len(_bending(model, data, leg)) > 1 for leg in anatomy.legs)


def leg_length(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> float:
    """Length of a straight leg, from the joint that swings it forwards to its sole, m."""
    bending = _bending(model, data, leg) or [model.joint(name).id for name in leg.joints]
    mujoco.mj_kinematics(model, data)
    sole = _place(model, data, _sole(model, data, leg))
    points = data.xanchor[bending]
    if len(bending) < WITH_ANKLE:  # the last link points to the sole, however it is bent
        points = np.vstack([points, sole])
    links = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return links + float(points[-1, 2] - lowest_point(model, data, with_all_below(model, model.body(leg.foot).id)))


def _bent(model: mujoco.MjModel, anatomy: Anatomy, qpos: np.ndarray) -> float:
    """By how much of its length the first leg is shorter in a pose than it is straight."""
    data, leg = mujoco.MjData(model), anatomy.legs[0]
    data.qpos[:] = upright(model, anatomy, qpos)
    length = leg_length(model, data, leg)
    hip = (_bending(model, data, leg) or [model.joint(leg.joints[0]).id])[0]
    sole = lowest_point(model, data, with_all_below(model, model.body(leg.foot).id))
    return 1.0 - float(data.xanchor[hip, 2] - sole) / length


def _standing(model: mujoco.MjModel, data: mujoco.MjData, anatomy: Anatomy, source: str) -> Posture:
    """The pose of some data, with the base upright over its own ground."""
    base = model.jnt_qposadr[model.body(anatomy.base).jntadr[0]]
    data.qpos[base : base + 7] = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    mujoco.mj_kinematics(model, data)
    bodies = [b for leg in anatomy.legs for b in with_all_below(model, model.body(leg.foot).id)]
    height = -lowest_point(model, data, bodies)
    data.qpos[base + 2] = height
    return Posture(source, data.qpos.copy(), height)


def _within_ranges(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Positions with every joint of one axis within its range."""
    qpos = qpos.copy()
    for joint in np.flatnonzero(model.jnt_limited):
        if int(model.jnt_type[joint]) in ONE_AXIS:
            low, high = model.jnt_range[joint]
            at = model.jnt_qposadr[joint]
            qpos[at] = np.clip(qpos[at], low + MARGIN * (high - low), high - MARGIN * (high - low))
    return qpos


def _bending(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> list[int]:
    """The joints of a leg that swing it or parts of it forwards, from the base down."""
    mujoco.mj_kinematics(model, data)
    joints = [model.joint(name).id for name in leg.joints]
    return [joint for joint in joints if abs(data.xaxis[joint, 1]) > SIDEWAYS]


def _bend(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> None:
    """Bend the knee towards the middle of its range, and hip and ankle half as far against it."""
    bending = _bending(model, data, leg)
    if len(bending) < 2:
        return
    sign = np.sign(data.xaxis[bending, 1])
    at = model.jnt_qposadr[bending]
    middle = model.jnt_range[bending[1]].mean() if model.jnt_limited[bending[1]] else 0.0
    towards = np.sign(middle - data.qpos[at[1]]) if abs(middle - data.qpos[at[1]]) > 0.1 else sign[1]
    data.qpos[at[1]] += BEND * towards
    for i in (0, 2)[: len(bending) - 1]:
        data.qpos[at[i]] -= 0.5 * BEND * towards * sign[1] * sign[i]
    data.qpos[:] = _within_ranges(model, data.qpos)


class Sole(NamedTuple):
    """The middle of what a foot stands on."""

    body: int
    """the foot"""
    point: np.ndarray
    """in its frame, shape (3,), m"""


def _sole(model: mujoco.MjModel, data: mujoco.MjData, leg: Leg) -> Sole:
    """The middle of the boxes around what reaches down farthest; at their height where an ankle keeps them level."""
    foot = model.body(leg.foot).id
    of_it = np.isin(model.geom_bodyid, with_all_below(model, foot)) & touching(model)
    boxes = np.stack(geom_extents(data, np.flatnonzero(of_it)), axis=1)  # low and high corners
    lowest = boxes[:, 0, 2].min()
    height = data.xanchor[model.joint(leg.joints[0]).id, 2] - lowest
    low = boxes[boxes[:, 0, 2] < lowest + LEVEL * height]
    middle = 0.5 * (low[:, 0].min(axis=0) + low[:, 1].max(axis=0))
    if len(_bending(model, data, leg)) >= WITH_ANKLE:
        middle[2] = lowest
    return Sole(foot, data.xmat[foot].reshape(3, 3).T @ (middle - data.xpos[foot]))


def _place(model: mujoco.MjModel, data: mujoco.MjData, sole: Sole) -> np.ndarray:
    """Where a sole is, world frame, m."""
    place: np.ndarray = data.xpos[sole.body] + data.xmat[sole.body].reshape(3, 3) @ sole.point
    return place


def _reach(
    model: mujoco.MjModel, data: mujoco.MjData, leg: Leg, sole: Sole, place: np.ndarray, turned: np.ndarray
) -> float:
    """Move a leg until its sole is at a place, and turned as it was if it has an ankle for it (damped least squares).

    :return: how far off it is in the end, m
    """
    joints = np.array([model.joint(name).id for name in leg.joints])
    at, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    weight = np.repeat((1.0, FLAT if len(_bending(model, data, leg)) >= WITH_ANKLE else 0.0), 3)
    jacobian = np.zeros((6, model.nv))
    error = np.zeros(6)
    for _ in range(STEPS):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        now = _place(model, data, sole)
        error[:3] = place - now
        error[3:] = quat_to_rotvec(quat_multiply(turned, quat_conjugate(data.xquat[sole.body])))
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], now, sole.body)
        own = weight[:, None] * jacobian[:, dofs]
        step = own.T @ np.linalg.solve(own @ own.T + DAMPING * np.eye(6), weight * error)
        data.qpos[at] += np.clip(step, -TURN, TURN)
        data.qpos[:] = _within_ranges(model, data.qpos)
        if np.abs(step).max() < 1e-6:
            break
    mujoco.mj_kinematics(model, data)
    return float(np.linalg.norm(place - _place(model, data, sole)))
