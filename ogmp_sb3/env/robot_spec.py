"""A robot's model file as it is simulated: without a floor of its own, with joints held and driven as robot.yaml says.

The file itself stays as it is; all changes are made to MuJoCo's specification of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np

from ogmp_sb3.config.catalogue import shown_path
from ogmp_sb3.config.messages import Where, did_you_mean
from ogmp_sb3.config.robot import RobotConfig, ServoConfig
from ogmp_sb3.env.servos import OF_JOINTS, ONE_AXIS, ROUNDING, joint_actuators
from ogmp_sb3.guidance.rotations import quat_multiply, quat_rotate

FLOORS = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)


def robot_spec(robot: RobotConfig) -> mujoco.MjSpec:
    """The specification of a robot, to be compiled.

    :raises ValueError: if its file cannot be read, or cannot be changed as robot.yaml says
    """
    with in_the_file(robot):
        spec = bare_spec(robot.mjcf_path)
    set_free(spec, robot.base)
    if robot.hold:
        _hold(spec, robot)
    if robot.servos is not None:
        _drive(spec, robot, robot.servos)
    return spec


def bare_spec(path: Path) -> mujoco.MjSpec:
    """The specification of a model without a floor of its own, with all its bodies, be they feet without a joint.

    :raises ValueError: if a file cannot be read
    """
    spec = read_mjcf(path)
    spec.compiler.fusestatic = False
    drop_floors(spec)
    return spec


def set_free(spec: mujoco.MjSpec, base: str) -> None:
    """Give a body of the world a free joint if it has no joint, as the root of a URDF has none."""
    for body in spec.worldbody.bodies:
        if body.name == base and not body.joints:
            body.add_freejoint(name=f"{base}_free")


def read_mjcf(path: Path) -> mujoco.MjSpec:
    """A model's file and all that it reads, as they are now.

    :raises ValueError: if one of them cannot be read
    """
    mujoco.mj_clearCache(mujoco.mj_getCache())  # where a mesh that changed twice in a second is still the first
    # From a relative path MuJoCo does not find what an included file includes from beside itself.
    return mujoco.MjSpec.from_file(str(path.absolute()))


@contextmanager
def in_the_file(robot: RobotConfig) -> Iterator[None]:
    """Say of MuJoCo's errors in which file, and on one line."""
    try:
        yield
    except (ValueError, OSError) as error:
        sentence = " ".join(str(error).split()).partition(" The visual elements of the spec were discarded")[0]
        raise ValueError(f"{robot.mjcf_path}: {sentence}") from None


# ------------------------------------------------------------------ floors


def drop_floors(spec: mujoco.MjSpec) -> None:
    """Remove planes and height fields of the world: the ground is the task's. Who could touch them meets it instead."""
    floors = [geom for geom in spec.worldbody.geoms if geom.type in FLOORS]
    names = {geom.name for geom in floors if geom.name}
    for pair in list(spec.pairs):
        ends = {pair.geomname1, pair.geomname2}
        if ends & names:
            for name in ends - names:
                _meet_the_ground(spec.geom(name), pair)
            spec.delete(pair)
    _delete_sensors(spec, mujoco.mjtObj.mjOBJ_GEOM, names)
    for geom in floors:
        spec.delete(geom)


def _meet_the_ground(geom: mujoco.MjsGeom, pair: mujoco.MjsPair) -> None:
    """Have a geom touch any ground as it would have touched the floor that it was paired with."""
    geom.conaffinity |= 1
    geom.condim, geom.solref, geom.solimp = pair.condim, pair.solref, pair.solimp
    geom.friction = np.array(pair.friction)[[0, 2, 3]]  # tangential, torsional, rolling: a pair has two of most


# ------------------------------------------------------------------ joints that are held


def _hold(spec: mujoco.MjSpec, robot: RobotConfig) -> None:
    """Make joints stiff at a position: their bodies are turned and shifted there, and the joints are no more."""
    known = [joint.name for joint in spec.joints]
    for name in robot.hold:
        if name not in known:
            raise ValueError(f"{_where(robot)} has no joint '{name}'{did_you_mean(name, known)}")
    for key in list(spec.keys):  # of all joints
        spec.delete(key)
    with in_the_file(robot):
        compiled = spec.copy().compile()
    for body in spec.bodies:
        held = [joint for joint in body.joints if joint.name in robot.hold]
        if not held:
            continue
        others = [joint.name for joint in body.joints if joint.name not in robot.hold]
        if others:
            raise ValueError(
                f"{_where(robot)} has joint '{held[0].name}', but not '{others[0]}', which moves the same body."
            )
        pos, quat = _held_pose(compiled, body.name, robot)
        body.pos, body.quat = pos, quat
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    _delete_actuators(spec, robot.hold)
    _delete_sensors(spec, mujoco.mjtObj.mjOBJ_JOINT, robot.hold)
    for joint in list(spec.joints):
        if joint.name in robot.hold:
            spec.delete(joint)


def _where(robot: RobotConfig) -> Where:
    return Where(shown_path(robot.path)) / "hold"


def _held_pose(model: mujoco.MjModel, name: str, robot: RobotConfig) -> tuple[np.ndarray, np.ndarray]:
    """Position and orientation of a body in its parent, with all its joints where they are held."""
    body = model.body(name)
    pos, quat = body.pos.copy(), body.quat.copy()
    for joint in range(body.jntadr[0], body.jntadr[0] + body.jntnum[0]):
        kind, axis, anchor = int(model.jnt_type[joint]), model.jnt_axis[joint], model.jnt_pos[joint]
        if kind not in ONE_AXIS:
            raise ValueError(f"{_where(robot)} has '{model.joint(joint).name}', which is no joint of one axis.")
        low, high = model.jnt_range[joint]
        at = robot.hold[model.joint(joint).name]
        if model.jnt_limited[joint] and not low - ROUNDING <= at <= high + ROUNDING:
            name = model.joint(joint).name
            raise ValueError(f"{_where(robot)} has '{name}' at {at:g}, outside the joint's range, {low:g} to {high:g}.")
        moved = robot.hold[model.joint(joint).name] - model.qpos0[model.jnt_qposadr[joint]]
        if kind == mujoco.mjtJoint.mjJNT_SLIDE:
            pos = pos + quat_rotate(quat, moved * axis)
        else:
            turn = np.concatenate([[np.cos(0.5 * moved)], np.sin(0.5 * moved) * axis])
            pos = pos + quat_rotate(quat, anchor - quat_rotate(turn, anchor))
            quat = quat_multiply(quat, turn)
    return pos, quat


# ------------------------------------------------------------------ servos


def _drive(spec: mujoco.MjSpec, robot: RobotConfig, servos: ServoConfig) -> None:
    """Give the robot's joints position servos, in place of what drives them in the file."""
    with in_the_file(robot):
        compiled = spec.copy().compile()
    known = [joint.name for joint in spec.joints]
    limits = servos.torque or [torque_limit(compiled, name) if name in known else None for name in robot.joints]
    _delete_actuators(spec, robot.joints)
    for name, kp, kd, torque in zip(robot.joints, servos.kp, servos.kd, limits, strict=True):
        servo = spec.add_actuator(mujoco.MjSpec().default, name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=kp, kv=kd)
        if torque is not None:
            servo.forcelimited, servo.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-torque, torque]


def torque_limit(model: mujoco.MjModel, name: str) -> float | None:
    """Greatest torque that what drives a joint in the file gives; None: no limit but the joint's, if it has one."""
    found = []
    for i in joint_actuators(model, model.joint(name).id):
        gear, motor = abs(model.actuator_gear[i, 0]), model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE
        if model.actuator_forcelimited[i]:
            found.append(gear * np.abs(model.actuator_forcerange[i]).max())
        if motor and model.actuator_ctrllimited[i]:
            found.append(gear * abs(model.actuator_gainprm[i, 0]) * np.abs(model.actuator_ctrlrange[i]).max())
    return float(min(found)) if found else None


# ------------------------------------------------------------------ what goes with it


def _delete_actuators(spec: mujoco.MjSpec, joints: Iterable[str]) -> None:
    """Remove what drives some joints, and the sensors of it."""
    gone = [a for a in spec.actuators if a.trntype in OF_JOINTS and a.target in set(joints)]
    _delete_sensors(spec, mujoco.mjtObj.mjOBJ_ACTUATOR, {actuator.name for actuator in gone})
    for actuator in gone:
        spec.delete(actuator)


def _delete_sensors(spec: mujoco.MjSpec, kind: mujoco.mjtObj, names: Iterable[str]) -> None:
    """Remove the sensors of some things."""
    names = set(names) - {""}
    for sensor in list(spec.sensors):
        of = (sensor.objtype, sensor.objname), (sensor.reftype, sensor.refname)
        if any(which == kind and name in names for which, name in of):
            spec.delete(sensor)
