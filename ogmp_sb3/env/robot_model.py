"""Compile a robot's MJCF with terrain boxes, and check that it holds what robot.yaml names."""

from __future__ import annotations

import mujoco
import numpy as np

from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.guidance.terrain import NOTHING

TERRAIN_FRICTION = (1.0, 0.005, 0.0001)  # sliding, torsional, rolling: MuJoCo's defaults
VISUAL_GROUP = 1  # geoms that are only seen; physics runs without them, 20 % faster


def build_model(robot: RobotConfig, physics_dt: float, terrain_boxes: int, visual: bool = False) -> mujoco.MjModel:
    """Compile a robot with a pool of static terrain boxes.

    :param robot: the robot
    :param physics_dt: physics step, s
    :param terrain_boxes: number of boxes, named ``terrain_0``, ...
    :param visual: keep the geoms that are only seen, for rendering; the state is the same either way
    :raises ValueError: if the robot's MJCF is unreadable or lacks what robot.yaml names
    """
    try:
        # From a relative path MuJoCo does not find what an included file includes from beside itself.
        spec = mujoco.MjSpec.from_file(str(robot.mjcf_path.absolute()))
    except (ValueError, OSError) as error:
        raise ValueError(f"{robot.mjcf_path}: {' '.join(str(error).split())}") from None
    spec.option.timestep = physics_dt
    # Terrain boxes move at run time, but the bounding volumes of static geoms are made at compile time.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for geom in spec.geoms:
        if geom.group == VISUAL_GROUP and not visual:
            spec.delete(geom)
    for i in range(terrain_boxes):
        spec.worldbody.add_geom(
            name=f"terrain_{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[1.0, 1.0, 1.0],
            pos=[0.0, 0.0, NOTHING],
            contype=1,
            conaffinity=1,
            friction=TERRAIN_FRICTION,
            rgba=[0.72, 0.70, 0.66, 1.0],
        )
    try:
        model = spec.compile()
    except ValueError as error:
        raise ValueError(f"{robot.mjcf_path}: {' '.join(str(error).split())}") from None
    _check_names(model, robot)
    _check_servos(model, robot)
    _check_ground(model, robot)
    return model


def _check_names(model: mujoco.MjModel, robot: RobotConfig) -> None:
    bodies = [model.body(i).name for i in range(model.nbody)]
    joints = [model.joint(i).name for i in range(model.njnt)]
    actuators = [model.actuator(i).name for i in range(model.nu)]
    for kind, wanted, names in (
        ("body", (robot.base, *robot.feet), bodies),
        ("joint", robot.joints, joints),
        ("actuator", robot.joints, actuators),
    ):
        for name in wanted:
            if name not in names:
                raise ValueError(f"{robot.mjcf_path}: no {kind} '{name}'{did_you_mean(name, names)}")
    if len(robot.joints) != model.nu:
        raise ValueError(f"{robot.mjcf_path}: {model.nu} actuators, but robot.yaml names {len(robot.joints)} joints.")


def _check_servos(model: mujoco.MjModel, robot: RobotConfig) -> None:
    for name in robot.joints:
        servo = model.actuator(name)
        kp = servo.gainprm[0]
        of_joint = servo.trntype[0] == mujoco.mjtTrn.mjTRN_JOINT and servo.trnid[0] == model.joint(name).id
        if not (of_joint and kp > 0 and servo.biasprm[1] == -kp):
            raise ValueError(
                f"{robot.mjcf_path}: actuator '{name}' must be a position servo of joint '{name}', e.g. "
                f'<position name="{name}" joint="{name}" kp="30" kv="1"/>.'
            )


def _check_ground(model: mujoco.MjModel, robot: RobotConfig) -> None:
    for geom in map(model.geom, np.flatnonzero(model.geom_bodyid == 0)):
        if not geom.name.startswith("terrain_") and (geom.contype[0] or geom.conaffinity[0]):
            raise ValueError(
                f"{robot.mjcf_path}: geom '{geom.name or geom.id}' of the world collides; remove it: "
                "the ground is the task's."
            )
