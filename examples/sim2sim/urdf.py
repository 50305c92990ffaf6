"""A robot's compiled MuJoCo model as URDF: used once, by prepare.py, where MuJoCo is installed.

One link a body, with its mass, principal inertias and shapes; one joint a link, with axis, range, damping and friction.
What URDF cannot say is refused in a sentence rather than dropped: armature, springs, joints with an offset of their
angle, several joints in a body, meshes that collide, equalities and tendons.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from typing import Any

import mujoco
import numpy as np

JOINTS = {mujoco.mjtJoint.mjJNT_HINGE: "revolute", mujoco.mjtJoint.mjJNT_SLIDE: "prismatic"}
SPEED_LIMIT = 1000.0  # rad/s; URDF wants one, MuJoCo has none


def robot_urdf(model: mujoco.MjModel, base: str, torque: dict[str, float]) -> str:
    """The robot below a base as URDF.

    :param model: compiled, with its pictures
    :param base: the body with the free joint
    :param torque: greatest torque of each joint that has a servo, N m
    :raises ValueError: for what URDF cannot say
    """
    if model.neq or model.ntendon:
        raise ValueError("the robot has equalities or tendons, which URDF has no word for.")
    root = ET.Element("robot", name=base)
    for i in of_robot(model, base):
        link = ET.SubElement(root, "link", name=model.body(i).name)
        _inertial(link, model, i)
        for geom in np.flatnonzero(model.geom_bodyid == i):
            _shape(link, model, int(geom), _anchor(model, i, base))
        if model.body(i).name != base:
            _joint(root, model, i, base, torque)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def of_robot(model: mujoco.MjModel, base: str) -> list[int]:
    """The bodies of the robot, parents first."""
    return np.flatnonzero(model.body_rootid == model.body(base).id).tolist()


def meetings(model: mujoco.MjModel, base: str, ground: int) -> dict[str, dict[str, Any]]:
    """What each link with collision shapes can touch, and its friction.

    :param ground: a geom of the terrain
    :raises ValueError: if the shapes of one link differ in what they meet, or in friction
    """
    bits: dict[int, set[tuple[int, int, float]]] = {}
    for i in of_robot(model, base):
        geoms = np.flatnonzero((model.geom_bodyid == i) & ((model.geom_contype | model.geom_conaffinity) != 0))
        for g in geoms:
            key = (int(model.geom_contype[g]), int(model.geom_conaffinity[g]), float(model.geom_friction[g, 0]))
            bits.setdefault(i, set()).add(key)
        if len(bits.get(i, ())) > 1:
            raise ValueError(f"body '{model.body(i).name}': its shapes differ in contype, conaffinity or friction.")
    of_ground = (int(model.geom_contype[ground]), int(model.geom_conaffinity[ground]))
    found: dict[str, dict[str, Any]] = {}
    for i, ((contype, conaffinity, friction),) in bits.items():
        mine = (contype, conaffinity)
        found[model.body(i).name] = {
            "friction": friction,
            "ground": _meet(mine, of_ground),
            "links": [
                model.body(j).name
                for j, ((other, affinity, _),) in bits.items()
                if j != i and i != model.body_parentid[j] and j != model.body_parentid[i]
                if _meet(mine, (other, affinity))
            ],
        }
    return found


def _meet(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """MuJoCo's rule for two geoms, from their contype and conaffinity."""
    return bool(one[0] & other[1] or other[0] & one[1])


def _anchor(model: mujoco.MjModel, i: int, base: str) -> np.ndarray:
    """Where the frame of a URDF link is in the body: at the joint, through which its axis goes."""
    if model.body(i).name == base or not model.body_jntnum[i]:
        return np.zeros(3)
    return np.array(model.jnt_pos[model.body_jntadr[i]])


def _inertial(link: ET.Element, model: mujoco.MjModel, i: int) -> None:
    base = model.body(model.body_rootid[i]).name
    inertial = ET.SubElement(link, "inertial")
    _origin(inertial, model.body_ipos[i] - _anchor(model, i, base), model.body_iquat[i])
    ET.SubElement(inertial, "mass", value=_text(model.body_mass[i]))
    xx, yy, zz = (_text(value) for value in model.body_inertia[i])
    ET.SubElement(inertial, "inertia", ixx=xx, iyy=yy, izz=zz, ixy="0", ixz="0", iyz="0")


def _shape(link: ET.Element, model: mujoco.MjModel, geom: int, anchor: np.ndarray) -> None:
    collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
    if not collides and model.geom_group[geom] > 2:
        return
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    name = f"shape '{model.geom(geom).name or geom}' of body '{link.get('name')}'"
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        form, values = "box", {"size": _text(2.0 * size)}
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        form, values = "sphere", {"radius": _text(size[0])}
    elif kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        form = "cylinder" if kind == mujoco.mjtGeom.mjGEOM_CYLINDER else "capsule"
        values = {"radius": _text(size[0]), "length": _text(2.0 * size[1])}
    elif collides:
        raise ValueError(f"{name} collides, and is no box, sphere, cylinder or capsule.")
    else:
        return  # only seen
    part = ET.SubElement(link, "collision" if collides else "visual")
    _origin(part, model.geom_pos[geom] - anchor, model.geom_quat[geom])
    ET.SubElement(ET.SubElement(part, "geometry"), form, values)
    if not collides:
        material = model.geom_matid[geom]
        colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        texture = ET.SubElement(part, "material", name=f"colour_{geom}")
        ET.SubElement(texture, "color", rgba=_text(colour))


def _joint(root: ET.Element, model: mujoco.MjModel, i: int, base: str, torque: dict[str, float]) -> None:
    body, parent = model.body(i), int(model.body_parentid[i])
    origin = model.body_pos[i] + _rotated(model.body_quat[i], _anchor(model, i, base)) - _anchor(model, parent, base)
    joint = ET.SubElement(root, "joint")
    _origin(joint, origin, model.body_quat[i])
    ET.SubElement(joint, "parent", link=model.body(parent).name)
    ET.SubElement(joint, "child", link=body.name)
    if not model.body_jntnum[i]:
        joint.attrib |= {"name": f"{body.name}_fixed", "type": "fixed"}
        return
    if model.body_jntnum[i] > 1:
        raise ValueError(f"body '{body.name}' has several joints, a URDF link has one.")
    j, dof = int(model.body_jntadr[i]), int(model.body_dofadr[i])
    name, kind = model.joint(j).name, mujoco.mjtJoint(int(model.jnt_type[j]))
    if kind not in JOINTS:
        raise ValueError(f"joint '{name}' is neither a hinge nor a slide.")
    for what, value in (
        ("an armature", model.dof_armature[dof]),
        ("a spring", model.jnt_stiffness[j]),
        ("a 'ref'", model.qpos0[model.jnt_qposadr[j]]),
    ):
        if np.any(value):
            raise ValueError(f"joint '{name}' has {what}, which URDF has no word for.")
    limited = bool(model.jnt_limited[j])
    joint.attrib |= {
        "name": name,
        "type": JOINTS[kind] if limited or kind != mujoco.mjtJoint.mjJNT_HINGE else "continuous",
    }
    ET.SubElement(joint, "axis", xyz=_text(model.jnt_axis[j]))
    low, high = model.jnt_range[j] if limited else (-1e3, 1e3)
    effort, speed = _text(torque.get(name, 0.0)), _text(SPEED_LIMIT)
    ET.SubElement(joint, "limit", lower=_text(low), upper=_text(high), effort=effort, velocity=speed)
    friction, damping = model.dof_frictionloss[dof], float(np.ravel(model.dof_damping[dof])[0])
    ET.SubElement(joint, "dynamics", damping=_text(damping), friction=_text(friction))


def _origin(parent: ET.Element, position: np.ndarray, quat: np.ndarray) -> None:
    ET.SubElement(parent, "origin", xyz=_text(position), rpy=_text(roll_pitch_yaw(quat)))


def roll_pitch_yaw(quat: np.ndarray) -> np.ndarray:
    """URDF's angles of a quaternion w x y z, R = Rz(yaw) Ry(pitch) Rx(roll); of a vertical x axis yaw is 0."""
    m = np.empty(9)
    mujoco.mju_quat2Mat(m, np.asarray(quat, dtype=float))
    m = m.reshape(3, 3)
    level = math.hypot(m[0, 0], m[1, 0])
    pitch = math.atan2(-m[2, 0], level)
    if level < 1e-7:
        return np.array([math.atan2(-m[1, 2], m[1, 1]), pitch, 0.0])
    return np.array([math.atan2(m[2, 1], m[2, 2]), pitch, math.atan2(m[1, 0], m[0, 0])])


def _rotated(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    result = np.empty(3)
    mujoco.mju_rotVecQuat(result, vector, quat)
    return result


def _text(values: Any) -> str:
    """Numbers to their last digit, so that nothing is lost on the way."""
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))
