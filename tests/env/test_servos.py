"""Servos against plain MuJoCo: torque, limits and targets at the joint; actuators that are no position servos."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from helpers.robots import COMPILER, JOINTS, KNEE, OPTION, PUP, SERVOS, variant, with_attributes
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.servos import Servos, read_servos
from ogmp_sb3.env.simulation import Simulation

DT = 0.002  # s
NOMINAL = np.array(PUP.nominal_joints)


def servos(robot: RobotConfig) -> Servos:
    return read_servos(build_model(robot, DT, 1), robot)


def in_the_air(robot: RobotConfig, num_envs: int = 1) -> Simulation:
    sim = Simulation(robot, num_envs, DT, 1, 1)
    sim.place(np.arange(num_envs), np.tile([0.0, 0.0, 5.0], (num_envs, 1)), NOMINAL)
    return sim


def joint_torques(sim: Simulation, row: int) -> np.ndarray:
    """What MuJoCo's actuators do at the joints, N m."""
    model, data = sim.mj.get_model(row), sim.mj.get_data(row)
    mujoco.mj_forward(model, data)
    return data.qfrc_actuator[sim.joint_qvel].copy()


GEARED = [
    '<position kp="0.4" kv="0.008" gear="10" forcerange="-1.5 1.5"/>',
    '<position kp="10" kv="0.2" gear="-2 5 7 0 0 0" forcerange="-7.5 7.5"/>',
    '<general gainprm="40" biastype="affine" biasprm="0 -40 -0.8" forcerange="-15 15"/>',
]


@pytest.mark.parametrize("servo", GEARED)
def test_a_gear_changes_nothing_at_the_joint(servo: str, tmp_path: Path) -> None:
    """Three ways to write the example's servos: kp 40, kv 0.8, at most 15 N m."""
    changes = [(SERVOS, servo)] + ([("<position name", "<general name")] if "general" in servo else [])
    robot = variant(tmp_path, *changes)
    found, plain = servos(robot), servos(PUP)
    for name in ("kp", "kd", "torque_low", "torque_high", "target_low", "target_high", "time_constant"):
        np.testing.assert_allclose(getattr(found, name), getattr(plain, name), err_msg=name)
    states = []
    for each in (robot, PUP):
        sim = in_the_air(each)
        for k in range(20):
            sim.set_targets(NOMINAL + 0.3 * np.sin(k + np.arange(12.0)))
            sim.step(None, 5)
        states.append(np.concatenate([sim.qpos[0], sim.qvel[0]]))
    assert np.abs(states[0][7:19] - NOMINAL).max() > 0.05
    np.testing.assert_allclose(*states, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "servo",
    [
        '<position kp="0.4" kv="0.008" gear="10"/>',
        '<position kp="10" kv="0.2" gear="-2"/>',
        '<position kp="40" dampratio="1"/>',
        '<position kp="40" kv="0.8" ctrlrange="-1.6 0.9"/>',
        '<position kp="10" kv="0.2" gear="-2" ctrlrange="-1.8 3.2"/>',
        '<position kp="40" kv="0.8" inheritrange="0.9"/>',
        '<position kp="40" kv="0.8" timeconst="0.05"/>',
        '<position kp="10" kv="0.2" gear="-2" timeconst="0.05" ctrlrange="-1.8 3.2"/>',
    ],
)
def test_torques_are_those_that_mujoco_brings_to_the_joints(servo: str, tmp_path: Path) -> None:
    """Gains vary, targets leave the range that servos follow, and filters are on their way."""
    sim = in_the_air(variant(tmp_path, (SERVOS, servo)), 3)
    rows = np.arange(3)
    masses = np.array([1.0, 1.3, 0.9])[:, None] * sim.model.body_mass
    sim.vary(rows, {"body_mass": masses, "gains": np.repeat([[0.5], [1.0], [1.4]], len(NOMINAL), axis=1)})
    rng = np.random.default_rng(0)
    sim.set_targets(NOMINAL + rng.uniform(-1.5, 1.5, (3, 12)))
    sim.step(None, 10)
    torque = sim.torque(rows, sim.qpos[:, sim.joint_qpos], sim.qvel[:, sim.joint_qvel])
    assert np.abs(torque).max() > 5.0
    for row in rows:
        np.testing.assert_allclose(torque[row], joint_torques(sim, row), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("joint", "servo", "low", "high"),
    [
        ('actuatorfrcrange="-15 15"', '<position kp="40"/>', -15, 15),
        ('actuatorfrcrange="-15 15"', '<position kp="40" forcerange="-10 20"/>', -10, 15),
        ('actuatorfrcrange="-4 6"', '<position kp="40" gear="10" forcerange="-1.5 0.5"/>', -4, 5),
        ("", '<position kp="40" gear="-10" forcerange="-1.5 0.5"/>', -5, 15),
        ("", '<position kp="40" gear="-10" forcerange="-1.5 0.5" forcelimited="false"/>', -np.inf, np.inf),
        ('actuatorfrcrange="-4 6" actuatorfrclimited="false"', '<position kp="40"/>', -np.inf, np.inf),
    ],
)
def test_limits_are_those_that_hold_back_the_joints(
    joint: str, servo: str, low: float, high: float, tmp_path: Path
) -> None:
    robot = variant(tmp_path, (SERVOS, servo), (JOINTS, with_attributes(JOINTS, joint)))
    found = servos(robot)
    np.testing.assert_allclose(found.torque_low, low)
    np.testing.assert_allclose(found.torque_high, high)
    for far, limit in ((-100.0, low), (100.0, high)):
        sim = in_the_air(robot)
        sim.set_targets(NOMINAL + far)
        free = sim.torque(np.arange(1), sim.qpos[:, sim.joint_qpos], sim.qvel[:, sim.joint_qvel])[0]
        np.testing.assert_allclose(joint_torques(sim, 0), limit if np.isfinite(limit) else free)


def test_a_filter_starts_at_the_pose_and_follows_by_its_time_constant(tmp_path: Path) -> None:
    robot = variant(tmp_path, (SERVOS, '<position kp="10" kv="0.2" gear="-2" timeconst="0.05"/>'))
    np.testing.assert_allclose(servos(robot).time_constant, 0.05)
    sim = in_the_air(robot)
    assert np.abs(joint_torques(sim, 0)).max() < 1e-9
    sim.set_targets(NOMINAL + 0.1)
    sim.step(None, 25)
    _, data = sim.mj.get_model(0), sim.mj.get_data(0)
    np.testing.assert_allclose(data.act / -2, NOMINAL + 0.1 * (1 - np.exp(-1)))
    sim.place(np.arange(1), np.array([[0.0, 0.0, 5.0]]), NOMINAL)
    assert np.abs(joint_torques(sim, 0)).max() < 1e-9


def test_controls_that_are_not_clipped_have_no_range(tmp_path: Path) -> None:
    servo = '<position kp="40" kv="0.8" ctrlrange="-1 1"/>'
    robot = variant(tmp_path, (SERVOS, servo), (OPTION, 'cone="pyramidal"><flag clampctrl="disable"/></option>'))
    assert np.isinf(servos(robot).target_low).all()


def test_actuators_are_found_by_their_joints(tmp_path: Path) -> None:
    robot = variant(tmp_path, ('<position name="FL_', '<position name="motor_'), (KNEE.replace("FL_", "motor_", 1), ""),
                    ("</actuator>", '<position joint="FL_knee"/></actuator>'))  # fmt: skip
    model = build_model(robot, DT, 1)
    np.testing.assert_array_equal(read_servos(model, robot).ids, [0, 1, 11, *range(2, 11)])


OTHERS = [
    ('<motor name="FL_knee" joint="FL_knee"/>', "'FL_knee' is a motor"),
    ('<general name="FL_knee" joint="FL_knee" gainprm="40" biastype="none"/>', "'FL_knee' is a motor"),
    ('<velocity name="FL_knee" joint="FL_knee" kv="1"/>', r"gives 1 \* control \+ \(0 \+0 \* position -1 \* velocity"),
    ('<general name="FL_knee" joint="FL_knee" gainprm="40" biastype="affine" biasprm="2 -40 -1"/>', r"\(2 -40 \* pos"),
    ('<general name="FL_knee" joint="FL_knee" gainprm="40" biastype="affine" biasprm="0 -30 -1"/>', "gives 40"),
    ('<position name="FL_knee" joint="FL_knee" kp="0"/>', "has kp = 0"),
    ('<position name="FL_knee" joint="FL_knee" gear="0"/>', "has a gear of 0"),
    ('<position name="FL_knee" joint="FL_knee" delay="0.01" nsample="8"/>', r"delay of 0\.01 s"),
    ('<intvelocity name="FL_knee" joint="FL_knee" kp="40" actrange="-3 3"/>', r"state of its own \(dyntype integrator"),
    ('<muscle name="FL_knee" joint="FL_knee" lengthrange="0 1"/>', "dyntype muscle"),
    ('<pid name="FL_knee" joint="FL_knee" kp="40" kv="1"/>', "is of another kind"),
    ('<position name="FL_knee" tendon="cord"/>', "it has no actuator"),
    ("", "it has no actuator"),
    (f'{KNEE}<velocity name="brake" joint="FL_knee" kv="1"/>', "it has 2: actuator 'FL_knee', actuator 'brake'"),
]


@pytest.mark.parametrize(("actuator", "reason"), OTHERS)
def test_what_is_no_position_servo_is_refused(actuator: str, reason: str, tmp_path: Path) -> None:
    cord = '<tendon><fixed name="cord"><joint joint="FL_knee" coef="1"/></fixed></tendon><actuator>'
    robot = variant(tmp_path, (KNEE, actuator), ("<actuator>", cord))
    with pytest.raises(ValueError, match=reason) as caught:
        build_model(robot, DT, 1)
    message = str(caught.value)
    assert message.startswith(f"{robot.mjcf_path}: joint 'FL_knee' must have a position servo, e.g. <position ")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("actuator", "moved"),
    [('<position name="x" tendon="cord"/>', "a tendon"), ('<position name="x" joint="tail"/>', "joint 'tail'")],
)
def test_an_actuator_of_anything_else_is_named(actuator: str, moved: str, tmp_path: Path) -> None:
    tail = '<body><joint name="tail" range="-1 1"/><geom size="0.01" mass="0.1"/></body><body name="FL_hip"'
    cord = '<tendon><fixed name="cord"><joint joint="FL_knee" coef="1"/></fixed></tendon><actuator>'
    change = (("<actuator>", cord), ('<body name="FL_hip"', tail), ("</actuator>", f"{actuator}</actuator>"))
    with pytest.raises(
        ValueError, match=rf"actuator 'x' moves {moved}, which is neither among the 'joints' of robot\.yaml"
    ):
        build_model(variant(tmp_path, *change), DT, 1)


def test_an_actuator_that_is_switched_off_is_named(tmp_path: Path) -> None:
    off = (OPTION, 'cone="pyramidal" actuatorgroupdisable="3"/>')
    with pytest.raises(ValueError, match="'FL_knee' is in group 3, which 'actuatorgroupdisable' turns off"):
        build_model(variant(tmp_path, (KNEE, KNEE.replace("/>", ' group="3"/>')), off), DT, 1)


def test_joints_of_more_than_one_axis_are_named(tmp_path: Path) -> None:
    ball = ('<joint name="FL_hip_roll" class="roll"/>', '<joint name="FL_hip_roll" type="ball"/>')
    with pytest.raises(ValueError, match=r"robot\.yaml: 'joints': 'FL_hip_roll' is a ball joint"):
        build_model(variant(tmp_path, ball), DT, 1)


def pose(**angles: float) -> tuple[float, ...]:
    return tuple({**dict(zip(PUP.joints, PUP.nominal_joints, strict=True)), **angles}.values())


NO_RANGE = (
    'class="knee">\n      <joint axis="0 1 0" range="-2.6 -0.1"/>',
    'class="knee">\n      <joint axis="0 1 0"/>',
)


@pytest.mark.parametrize(
    ("changes", "angles", "sentence"),
    [
        (
            (),
            {"FL_knee": 1.5},
            r"'FL_knee' is at 1\.5 rad, outside the joint's range, -2\.6 to -0\.1 rad \(.*pup\.xml\)\.$",
        ),
        ((), {"RR_hip_roll": -43.0}, r"'RR_hip_roll' is at -43 rad, outside .*, -0\.7 to 0\.7 rad .* in degrees\?$"),
        ((NO_RANGE,), {"FL_knee": -86.0}, r"'FL_knee' is at -86 rad, over a whole turn\. Is it in degrees\?$"),
        (
            ((SERVOS, '<position kp="40" ctrlrange="-1 1"/>'),),
            {},
            r"'FL_knee' is at -1\.5 rad, outside what .*, -1 to 1 ",
        ),
        (((SERVOS, '<position kp="40" gear="-2" ctrlrange="-2 3"/>'),), {"FL_hip_pitch": 1.1}, r", -1\.5 to 1 rad"),
    ],
)
def test_a_nominal_pose_out_of_reach_is_named(
    changes: tuple[tuple[str, str], ...], angles: dict[str, float], sentence: str, tmp_path: Path
) -> None:
    robot = variant(tmp_path, *changes, nominal_joints=pose(**angles))
    with pytest.raises(ValueError, match=sentence) as caught:
        build_model(robot, DT, 1)
    assert "robot.yaml: 'nominal_joints': joint " in str(caught.value)


def test_a_nominal_pose_at_the_end_of_a_range_in_degrees_is_right(tmp_path: Path) -> None:
    build_model(variant(tmp_path, nominal_joints=pose(FL_knee=-0.1, FR_knee=-2.6005)), DT, 1)


def test_limits_that_are_switched_off_keep_no_pose_away(tmp_path: Path) -> None:
    off = (OPTION, 'cone="pyramidal"><flag limit="disable"/></option>')
    build_model(variant(tmp_path, off, nominal_joints=pose(FL_knee=1.5)), DT, 1)


def test_force_limits_need_no_autolimits(tmp_path: Path) -> None:
    limits = JOINTS, with_attributes(JOINTS, 'actuatorfrcrange="-9 9" actuatorfrclimited="true" limited="false"')
    robot = variant(
        tmp_path, (COMPILER, '<compiler angle="radian" autolimits="false"/>'), limits, (SERVOS, '<position kp="40"/>')
    )
    np.testing.assert_allclose(servos(robot).torque_high, 9.0)
