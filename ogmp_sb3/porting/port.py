"""A robot of this package made of a model: all that its robot.yaml says, and where each of it is from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import mujoco

from ogmp_sb3.config.model_file import model_file
from ogmp_sb3.config.robot import SRB, RobotConfig, ServoConfig
from ogmp_sb3.env.robot_check import foot_clearance, model_srb
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.robot_spec import bare_spec, set_free
from ogmp_sb3.env.servos import has_servo
from ogmp_sb3.porting.anatomy import Anatomy, find_anatomy, find_base
from ogmp_sb3.porting.gains import REACH, servo_gains
from ogmp_sb3.porting.posture import HOME, Posture, bends_forwards, find_posture, leg_length

PHYSICS_DT = 0.002  # s, of what is measured here
UNKNOWN = SRB(mass=1.0, inertia=(1.0, 1.0, 1.0))  # until the model is there
AIR = 0.002  # m under the feet at the nominal height


class Given(NamedTuple):
    """What a person knows better than the model says; None: by the rules."""

    base: str | None = None
    feet: tuple[str, ...] = ()
    kp: float | None = None
    kd: float | None = None
    torque: float | None = None


@dataclass(frozen=True)
class Port:
    """A robot, and how it came about."""

    robot: RobotConfig
    """what robot.yaml says"""
    anatomy: Anatomy
    """its parts"""
    posture: Posture
    """its nominal pose"""
    servos: str
    """where its servos are from, for people"""
    forwards: bool
    """whether its legs bend along x, as they should"""


def port(mjcf: str, name: str, folder: Path, given: Given) -> Port:
    """Find out all that robot.yaml says of a robot.

    :param mjcf: its model, as robot.yaml names it from ``folder``
    :param name: of the robot
    :param folder: where its robot.yaml will be
    :param given: what is known
    :raises ValueError: if the model cannot be read, or is no robot with legs that we can simulate
    """
    file = model_file(mjcf, folder)
    try:
        spec = bare_spec(file)
        base = find_base(spec, given.base)
        set_free(spec, base)
        model = spec.compile()
        data = mujoco.MjData(model)
        names = [model.key(i).name for i in range(model.nkey)]
        if names:
            mujoco.mj_resetDataKeyframe(model, data, names.index(HOME) if HOME in names else 0)
        at = model.jnt_qposadr[model.body(base).jntadr[0]]
        data.qpos[at + 3 : at + 7] = 1.0, 0.0, 0.0, 0.0
        mujoco.mj_kinematics(model, data)
        anatomy = find_anatomy(model, data, base, given.feet)
        posture = find_posture(model, anatomy)
        servos, told = _servos(model, posture, anatomy, given)
    except (ValueError, OSError) as error:
        raise ValueError(f"{file}: {' '.join(str(error).split())}") from None
    data.qpos[:] = posture.qpos
    length = leg_length(model, data, anatomy.legs[0])
    robot = RobotConfig(
        name=name,
        mjcf=mjcf,
        source=f"Ported by ogmp-robot from {mjcf}; `srb` is computed from the compiled model.",
        base=base,
        joints=anatomy.joints,
        feet=anatomy.feet,
        nominal_height=posture.height,
        nominal_joints=tuple(_value(data, joint) for joint in anatomy.joints),
        leg_length=round(length, 3),
        srb=UNKNOWN,
        servos=servos,
        hold={joint: _value(data, joint) for joint in anatomy.others},
        path=folder / "robot.yaml",
    )
    try:
        clearance = foot_clearance(robot, PHYSICS_DT)
    except ValueError as error:
        raise ValueError(f"{file}, in the pose of its {posture.source}: {error}") from None
    height = robot.nominal_height - clearance
    air, digits = min(AIR, 0.01 * height), 10 ** max(3, 2 - math.floor(math.log10(height)))
    robot = replace(robot, nominal_height=math.ceil(digits * (height + air)) / digits)
    body = model_srb(robot, build_model(robot, PHYSICS_DT, 1))
    inertia = tuple(_digits(value) for value in body.inertia)
    robot = replace(robot, srb=SRB(mass=_digits(body.mass), inertia=inertia))  # type: ignore[arg-type]
    return Port(robot, anatomy, posture, told, bends_forwards(model, anatomy, posture.qpos))


def _digits(value: float) -> float:
    return float(f"{value:.6g}")


def _servos(model: mujoco.MjModel, posture: Posture, anatomy: Anatomy, given: Given) -> tuple[ServoConfig | None, str]:
    """Servos of the legs, or None if the model's own are kept; and where they are from."""
    by_hand = {key: value for key in ("kp", "kd", "torque") if (value := getattr(given, key)) is not None}
    if not by_hand and all(has_servo(model, joint) for joint in anatomy.joints):
        return None, "the model's own"
    servos = servo_gains(model, posture.qpos, anatomy.joints, **by_hand)
    own = [has_servo(model, joint) for joint in anatomy.joints]
    rule = "the model's own" if all(own) else f"by torque limits ({REACH:g} rad) and inertia"
    if any(own) and not all(own):
        rule = f"the model's own of {sum(own)} joints, {rule} of {len(own) - sum(own)}"
    return servos, rule if not by_hand else ", ".join(f"{key} given" for key in by_hand) + f", else {rule}"


def _value(data: mujoco.MjData, joint: str) -> float:
    return round(float(data.joint(joint).qpos[0]), 4) + 0.0
