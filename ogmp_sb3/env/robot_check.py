"""Compare robot.yaml with the MuJoCo model: mass, inertia and height, and whether the robot stands on its servos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ogmp_sb3.config.robot import SRB, RobotConfig
from ogmp_sb3.env.ground_contacts import foot_geoms
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.simulation import Simulation
from ogmp_sb3.guidance.rotations import quat_rotate
from ogmp_sb3.guidance.terrain import geom_boxes

INTERVAL = 0.01  # s, about, between two looks at what touches the ground
GROUND = (-10.0, 10.0, -10.0, 10.0, 0.0)  # a terrain box, m
FARTHEST = 100.0  # m, of a foot from the ground


@dataclass(frozen=True)
class Stand:
    """How a robot stands whose servos hold the nominal pose."""

    height: float
    """of the base above the ground, m"""
    tilt: float
    """of the trunk from upright, rad"""
    body_contact: bool
    """whether anything but a foot has touched the ground"""
    feet_contact: bool
    """whether the ground carries a foot in the end"""
    unstable: bool
    """whether MuJoCo warned, or the state is not finite"""


def model_srb(robot: RobotConfig, model: mujoco.MjModel) -> SRB:
    """The whole robot at its nominal pose as one rigid body: what ``srb`` in robot.yaml should say.

    :param robot: the robot
    :param model: its model, of :func:`~ogmp_sb3.env.robot_model.build_model`
    """
    data = nominal_data(robot, model)
    mujoco.mj_comPos(model, data)
    base = model.body(robot.base).id
    centre, axes = data.subtree_com[base], data.xmat[base].reshape(3, 3)
    inertia = np.zeros((3, 3))  # about the centre of mass, world axes
    for body in np.flatnonzero(model.body_rootid == base):
        offset, own = data.xipos[body] - centre, data.ximat[body].reshape(3, 3)
        inertia += own @ np.diag(model.body_inertia[body]) @ own.T
        inertia += model.body_mass[body] * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    ixx, iyy, izz = (float(value) for value in np.diag(axes.T @ inertia @ axes))
    return SRB(mass=float(model.body_subtreemass[base]), inertia=(ixx, iyy, izz))


def foot_clearance(robot: RobotConfig, physics_dt: float) -> float:
    """Height of the lowest foot over flat ground in the nominal pose at the nominal height, m; below 0 if under it."""
    model = build_model(robot, physics_dt, 1)
    box = model.geom("terrain_0").id
    (model.geom_pos[box],), (model.geom_size[box],) = geom_boxes(np.array([GROUND]))
    data = nominal_data(robot, model)
    feet = foot_geoms(model, robot)
    distances = [mujoco.mj_geomDistance(model, data, foot, box, FARTHEST, None) for foot in feet.tolist()]
    return float(np.min(distances - model.geom_margin[feet]))


def nominal_data(robot: RobotConfig, model: mujoco.MjModel) -> mujoco.MjData:
    """A robot in its nominal pose at its nominal height."""
    data = mujoco.MjData(model)
    base = model.jnt_qposadr[model.body(robot.base).jntadr[0]]
    data.qpos[base : base + 7] = 0.0, 0.0, robot.nominal_height, 1.0, 0.0, 0.0, 0.0
    for name, angle in zip(robot.joints, robot.nominal_joints, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_kinematics(model, data)
    return data


def stand(robot: RobotConfig, physics_dt: float, lifts: Sequence[float], seconds: float = 1.0) -> list[Stand]:
    """Put a robot down in its nominal pose on flat ground, and let its servos hold the pose.

    :param robot: the robot
    :param physics_dt: physics step, s
    :param lifts: from how far above its nominal height it falls, m; one robot each
    :param seconds: how long
    :return: one for each of ``lifts``
    """
    sim = Simulation(robot, len(lifts), physics_dt, terrain_boxes=1, threads=1)
    rows = np.arange(len(lifts))
    sim.set_terrain(rows, np.tile(GROUND, (len(lifts), 1, 1)))
    start = np.zeros((len(lifts), 3))
    start[:, 2] = robot.nominal_height + np.array(lifts)
    sim.place(rows, start, np.array(robot.nominal_joints))
    touched = np.zeros(len(lifts), dtype=bool)
    substeps = max(1, round(INTERVAL / physics_dt))
    for _ in range(round(seconds / (substeps * physics_dt))):
        sim.step(None, substeps)
        touched |= sim.body_contact()
    pose = sim.qpos[:, sim.base_qpos : sim.base_qpos + 7]
    tilt = np.arccos(np.clip(quat_rotate(pose[:, 3:], np.array([0.0, 0.0, 1.0]))[:, 2], -1.0, 1.0))
    carried = [_carries_a_foot(sim, row, robot) for row in rows.tolist()]
    ends = zip(pose[:, 2], tilt, touched, carried, sim.unstable(), strict=True)
    return [Stand(float(h), float(angle), bool(body), feet, bool(bad)) for h, angle, body, feet, bad in ends]


def _carries_a_foot(sim: Simulation, row: int, robot: RobotConfig) -> bool:
    model, data = sim.mj.get_model(row), sim.mj.get_data(row)
    mujoco.mj_forward(model, data)
    forces = data.contact.efc_address >= 0
    return bool(np.isin(data.contact.geom[forces], foot_geoms(model, robot)).any())
