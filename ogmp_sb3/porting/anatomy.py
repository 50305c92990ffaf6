"""What the parts of a robot are, found in its model: base, legs with joints and feet, and what else it can move."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from ogmp_sb3.config.messages import did_you_mean

ONE_AXIS = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
OF_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
LOW = 0.15  # feet are what reaches within this share of the robot's height above its lowest point


@dataclass(frozen=True)
class Leg:
    """A leg."""

    joints: tuple[str, ...]
    """those that move this leg alone, from the base down"""
    foot: str
    """the body that stands on the ground"""


@dataclass(frozen=True)
class Anatomy:
    """The parts of a robot."""

    base: str
    """the body with the free joint"""
    legs: tuple[Leg, ...]
    """in the order of the model"""
    others: tuple[str, ...]
    """joints of one axis that are of no leg: waist, arms, head, hands"""

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints of all legs."""
        return tuple(joint for leg in self.legs for joint in leg.joints)

    @property
    def feet(self) -> tuple[str, ...]:
        """The feet of all legs."""
        return tuple(leg.foot for leg in self.legs)


def find_base(spec: mujoco.MjSpec, base: str | None = None) -> str:
    """The body with the free joint; or the one that could have it, where none has, as in a URDF.

    :param base: its name, if it is known
    :raises ValueError: if there is none, or more than one
    """
    roots = list(spec.worldbody.bodies)
    free = [body.name for body in roots if any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints)]
    could = free or [body.name for body in roots if not body.joints and body.bodies]
    if base is not None:
        if base not in could:
            raise ValueError(f"'base': no body '{base}' of the world that is free{did_you_mean(base, could)}")
        return base
    if len(could) != 1:
        has = f"has {len(could)} ({', '.join(could)}): give base=<body>" if could else "has none"
        raise ValueError(f"a robot's base is the one body of the world with a free joint; this model {has}.")
    return str(could[0])


def find_anatomy(model: mujoco.MjModel, data: mujoco.MjData, base: str, feet: tuple[str, ...] = ()) -> Anatomy:
    """The parts of a robot.

    Feet are the last bodies of limbs that can touch something, and reach down about as far as the lowest of them.

    :param model: the robot alone
    :param data: of it, in a pose in which it stands
    :param base: the body with the free joint
    :param feet: the bodies that stand on the ground, if they are known
    :raises ValueError: if nothing of it can touch the ground, or a foot is not there, or not below a joint
    """
    names = [model.body(i).name for i in range(model.nbody)]
    for foot in feet:
        if foot not in names:
            raise ValueError(f"'feet': no body '{foot}'{did_you_mean(foot, names)}")
    ends = [model.body(foot).id for foot in feet] if feet else _lowest_ends(model, data, model.body(base).id)
    chains = [_joints_above(model, end, model.body(base).id) for end in ends]
    for end, chain in zip(ends, chains, strict=True):
        if not chain:
            raise ValueError(f"foot '{names[end]}': no joint is between it and the base '{base}'.")
    shared = set(chains[0]).intersection(*chains[1:]) if len(chains) > 1 else set()
    legs = []
    for end, chain in zip(ends, chains, strict=True):
        joints = tuple(model.joint(joint).name for joint in chain if joint not in shared and _driven(model, joint))
        legs.append(Leg(joints, names[end]))
    of_legs = {joint for leg in legs for joint in leg.joints}
    others = tuple(
        model.joint(i).name
        for i in range(model.njnt)
        if int(model.jnt_type[i]) in ONE_AXIS and model.joint(i).name not in of_legs and _driven(model, i)
    )
    return Anatomy(base, tuple(legs), others)


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int]) -> float:
    """How far down what can touch something reaches, m; infinity if nothing of these bodies can.

    Of a mesh, the corners of its box.
    """
    low = np.inf
    for i in np.flatnonzero(np.isin(model.geom_bodyid, bodies) & touching(model)):
        centre, half = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
        down = data.geom_xmat[i].reshape(3, 3)[2]
        low = min(low, data.geom_xpos[i, 2] + down @ centre - np.abs(down) @ half)
    return float(low)


def touching(model: mujoco.MjModel) -> np.ndarray:
    """Geoms that can touch something, shape (geoms,), bool."""
    can: np.ndarray = (model.geom_contype | model.geom_conaffinity) != 0
    can[np.concatenate([model.pair_geom1, model.pair_geom2])] = True
    return can


def _lowest_ends(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> list[int]:
    """The last bodies of limbs that can touch something, of those limbs that reach down to the ground."""
    touch = np.zeros(model.nbody, dtype=bool)
    touch[model.geom_bodyid[touching(model)]] = True
    below = touch.copy()  # whether a body, or one below it, can touch something
    for body in range(model.nbody - 1, 0, -1):
        below[model.body_parentid[body]] |= below[body]
    ends = [
        body
        for body in np.flatnonzero(touch & (model.body_rootid == base)).tolist()
        if body != base and not below[np.flatnonzero(model.body_parentid == body)].any()
    ]
    if not ends:
        raise ValueError("no limb of the robot has a geom that can touch anything: give its feet some.")
    reach = {body: lowest_point(model, data, [body]) for body in ends}
    lowest = min(reach.values())
    return [body for body in ends if reach[body] <= lowest + LOW * (data.xpos[base, 2] - lowest)]


def _joints_above(model: mujoco.MjModel, body: int, base: int) -> list[int]:
    """The joints of one axis between a body and the base, from the base down."""
    chain: list[int] = []
    while body not in (base, 0):
        first = model.body_jntadr[body]
        own = range(first, first + model.body_jntnum[body])
        chain = [joint for joint in own if int(model.jnt_type[joint]) in ONE_AXIS] + chain
        body = int(model.body_parentid[body])
    return chain


def _driven(model: mujoco.MjModel, joint: int) -> bool:
    """Whether an actuator moves a joint, or none moves any (as in a URDF, which has no actuators)."""
    if not model.nu:
        return True
    of_joints = np.isin(model.actuator_trntype, OF_JOINTS)
    return bool((model.actuator_trnid[of_joints, 0] == joint).any())
