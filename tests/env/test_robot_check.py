"""Robots that stand and robots that fall; rigid bodies against MuJoCo's joint-space inertia."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from helpers.paths import ROOT
from helpers.robots import FEET, GEOMS, variant, with_attributes
from ogmp_sb3.commands.check import height, rigid_body, stance
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.robot import SRB, RobotConfig
from ogmp_sb3.env.robot_check import Stand, foot_clearance, model_srb, stand
from ogmp_sb3.env.robot_model import build_model

STANDING = Stand(height=0.5, tilt=0.0, body_contact=False, feet_contact=True, unstable=False)
PUP = ROOT / "examples" / "ogmp_pup" / "ogmp_pup" / "robots" / "pup" / "robot.yaml"


@pytest.fixture(scope="module")
def pup() -> RobotConfig:
    return load_robot(str(PUP))


@pytest.mark.parametrize("name", ["hector", str(PUP)])
def test_the_rigid_body_is_that_of_the_joint_space_inertia(name: str) -> None:
    robot = load_robot(name)
    model = build_model(robot, 0.002, 1)
    data = mujoco.MjData(model)
    for joint, angle in zip(robot.joints, robot.nominal_joints, strict=True):
        data.joint(joint).qpos = angle
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    for column, unit in zip(full, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    offset = data.body(robot.base).subtree_com - data.body(robot.base).xpos
    inertia = full[3:6, 3:6] - full[0, 0] * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    found = model_srb(robot, model)
    assert found.mass == pytest.approx(full[0, 0])
    np.testing.assert_allclose(found.inertia, np.diag(inertia), rtol=1e-9)


def test_a_quadruped_stands_and_survives_a_drop(pup: RobotConfig) -> None:
    standing, dropped = stand(pup, 0.002, (0.0, 0.1))
    for found in (standing, dropped):
        assert found.height == pytest.approx(pup.nominal_height, abs=0.02)
        assert found.tilt < 0.02
        assert not found.body_contact and not found.unstable
    assert stance(standing) == "base at 0.25 m, tilted 0°, on its feet"


def test_a_drop_from_high_up_is_felt_by_more_than_the_feet(pup: RobotConfig) -> None:
    assert stand(pup, 0.002, (1.5,))[0].body_contact


@pytest.mark.parametrize("physics_dt", [0.002, 0.003, 0.025])
def test_a_robot_in_the_air_falls_freely(pup: RobotConfig, physics_dt: float) -> None:
    (found,) = stand(pup, physics_dt, (2.0,), seconds=0.5)
    assert found.height == pytest.approx(pup.nominal_height + 2.0 - 0.5 * 9.81 * 0.5 * (0.5 + physics_dt), abs=0.03)


def test_a_biped_sags_and_falls() -> None:
    (found,) = stand(load_robot("hector"), 0.002, (0.0,))
    assert found.height < 0.3


def test_what_the_file_must_say_can_be_copied(pup: RobotConfig) -> None:
    model = model_srb(pup, build_model(pup, 0.002, 1))
    assert rigid_body(pup, model) == "6.2 kg, 12 joints, srb as in the model"
    light = replace(pup, srb=SRB(mass=5.0, inertia=pup.srb.inertia))
    assert rigid_body(light, model) == (
        "srb in robot.yaml should be {mass: 6.2, inertia: [0.056597, 0.129835, 0.134894]}"
    )


def test_an_unstable_simulation_is_said() -> None:
    assert stance(replace(STANDING, unstable=True)) == "the simulation is unstable"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, "on its feet"),
        ({"height": -0.2}, "fell through the ground"),
        ({"height": -0.2, "body_contact": True}, "fell through the ground"),
        ({"body_contact": True}, "other bodies than feet touched the ground"),
        ({"feet_contact": False}, "no foot touches the ground"),
        ({"tilt": 1.6}, "fallen over"),
    ],
)
def test_only_a_robot_upright_on_its_feet_is_on_its_feet(change: dict[str, float], said: str) -> None:
    assert stance(replace(STANDING, **change)).endswith(f"°, {said}")


def test_a_robot_whose_feet_alone_meet_the_ground_falls_through_it_if_it_falls(tmp_path: Path) -> None:
    soft = [
        (GEOMS, GEOMS.replace('conaffinity="1"', 'conaffinity="0"')),
        (FEET, with_attributes(FEET, 'conaffinity="1"')),
    ]
    lame = ('kp="40" kv="0.8" forcerange="-15 15"', 'kp="40" kv="0.8" forcerange="-0.1 0.1"')
    robot = variant(tmp_path, *soft, lame)
    (found,) = stand(robot, 0.002, (0.0,), seconds=2.0)
    assert found.height < 0.0 and not found.body_contact
    assert "fell through the ground" in stance(found)


def test_a_robot_in_the_air_is_on_no_foot(pup: RobotConfig) -> None:
    (found,) = stand(pup, 0.002, (2.0,), seconds=0.1)
    assert not found.feet_contact


def test_the_feet_are_as_far_from_the_ground_as_the_legs_say(pup: RobotConfig) -> None:
    legs = 0.16 * np.cos(0.75) + 0.16 * np.cos(0.75 - 1.5) + 0.02  # thigh, shank, radius of the foot
    assert foot_clearance(pup, 0.002) == pytest.approx(pup.nominal_height - legs, abs=1e-6)
    assert foot_clearance(replace(pup, nominal_height=0.1), 0.002) == pytest.approx(0.1 - legs, abs=1e-6)
    assert foot_clearance(replace(pup, nominal_height=3.0), 0.002) == pytest.approx(3.0 - legs, abs=1e-6)


def test_a_foot_begins_with_its_margin(tmp_path: Path) -> None:
    robot = variant(tmp_path, (FEET, with_attributes(FEET, 'margin="0.05"')))
    (found,) = stand(robot, 0.002, (0.05,))
    assert found.height - robot.nominal_height == pytest.approx(-foot_clearance(robot, 0.002), abs=0.01)


def test_a_height_that_keeps_the_feet_off_the_ground_is_corrected(pup: RobotConfig) -> None:
    assert height(pup, foot_clearance(pup, 0.002)) is None
    assert height(load_robot("hector"), foot_clearance(load_robot("hector"), 0.002)) is None
    said = [
        height(robot, foot_clearance(robot, 0.002)) for robot in (replace(pup, nominal_height=h) for h in (0.1, 0.9))
    ]
    assert said == [
        "0.254 in robot.yaml puts the feet on the ground; they are 0.15 m under the ground",
        "0.254 in robot.yaml puts the feet on the ground; they are 0.65 m above the ground",
    ]
