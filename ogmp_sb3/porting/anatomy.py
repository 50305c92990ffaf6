"""What the parts of a robot are, found in its model: base, legs with joints and feet, and what else it can move."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.env.ground_contacts import geom_extents, touching
from ogmp_sb3.env.servos import ONE_AXIS, joint_actuators

HEEL = 0.02  # share of the robot's height: what reaches down about as far as a toe is of the same foot
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
    """driven joints of one axis that are of no leg: waist, arms, head, hands"""
    passive: tuple[str, ...]
    """joints below the base that nothing drives, or that have more than one axis: they move as the physics has it"""

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
    for body in roots:
        if not body.name and base is None:
            raise ValueError("a body of the world has no name: robot.yaml names the base.")
    free = [body.name for body in roots if any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints)]
    could = free or [body.name for body in roots if not body.joints and body.bodies]
    if base is not None:
        if base not in could:
            raise ValueError(f"'base': no body '{base}' of the world that is free{did_you_mean(base, could)}")
        return base
    if len(could) != 1:
        has = f"has {len(could)} ({', '.join(could)}): one robot each" if could else "has none, and nothing that could"
        raise ValueError(f"a robot's base is the one body of the world with a free joint; this model {has}.")
    return str(could[0])


def find_anatomy(model: mujoco.MjModel, data: mujoco.MjData, base: str, feet: tuple[str, ...] = ()) -> Anatomy:
    """The parts of a robot.

    Feet are the ends of limbs that can touch something, and reach down about as far as the lowest of them; a foot with
    toes is one foot.

    :param model: the robot alone
    :param data: of it, in a pose in which it stands
    :param base: the body with the free joint
    :param feet: the bodies that stand on the ground, if they are known
    :raises ValueError: if nothing of it can touch the ground, a foot is not there, a leg has no joint of its own that
        is driven, or a part has no name
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
    legs: list[Leg] = []
    owners: dict[int, int] = {}  # of joints: the feet
    for end, chain in zip(ends, chains, strict=True):
        own = [joint for joint in chain if joint not in shared and _driven(model, joint)]
        if not own:
            raise ValueError(f"the leg to '{names[end]}' has no joint of its own that an actuator of joints moves.")
        for joint in own:
            if joint in owners:
                both = f"'{names[owners[joint]]}' and '{names[end]}'"
                raise ValueError(f"{both} are feet of one leg, as joint '{model.joint(joint).name}' moves both.")
            owners[joint] = end
        legs.append(Leg(tuple(_named(model, joint) for joint in own), _body_name(model, end)))
    below = [i for i in range(model.njnt) if model.jnt_bodyid[i] != model.body(base).id]
    others = [i for i in below if i not in owners and _driven(model, i)]
    passive = [i for i in below if not _driven(model, i)]
    return Anatomy(
        base,
        tuple(legs),
        tuple(_named(model, joint) for joint in others),
        tuple(model.joint(joint).name or "(without a name)" for joint in passive),
    )


def _named(model: mujoco.MjModel, joint: int) -> str:
    name = str(model.joint(joint).name)
    if not name:
        body = model.body(int(model.jnt_bodyid[joint])).name or "without a name"
        raise ValueError(f"a joint of body '{body}' has no name: robot.yaml names all that it moves.")
    return name


def _body_name(model: mujoco.MjModel, body: int) -> str:
    name = str(model.body(body).name)
    if not name:
        above = model.body(int(model.body_parentid[body])).name
        raise ValueError(f"the body below '{above}' that stands on the ground has no name: robot.yaml names the feet.")
    return name


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int]) -> float:
    """How far down what can touch something reaches, m; infinity if nothing of these bodies can."""
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies) & touching(model))
    low, _ = geom_extents(data, geoms)
    return float(low[:, 2].min(initial=np.inf))


def _lowest_ends(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> list[int]:
    """The feet: of limbs that can touch something, of those that reach down to the ground.

    Of several bodies of one limb that reach as far down, as a foot and its toes, the first.
    """
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
    feet = [body for body in ends if reach[body] <= lowest + LOW * (data.xpos[base, 2] - lowest)]
    same = HEEL * (data.xpos[base, 2] - lowest)
    return list(dict.fromkeys(_with_heel(model, data, body, base, same) for body in feet))


def _with_heel(model: mujoco.MjModel, data: mujoco.MjData, body: int, base: int, same: float) -> int:
    """The foot that a toe is of: the highest body above it that reaches as far down, but for some m."""
    down, foot = lowest_point(model, data, [body]), body
    while (body := int(model.body_parentid[body])) not in (base, 0):
        if lowest_point(model, data, [body]) <= down + same:
            foot = body
    return foot


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
    """Whether an actuator moves a joint of one axis, or none moves any (as in a URDF, which has no actuators)."""
    if int(model.jnt_type[joint]) not in ONE_AXIS:
        return False
    if not model.nu:
        return True
    return bool(joint_actuators(model, joint))
