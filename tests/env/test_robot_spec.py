"""A robot's model beside its file: held joints, servos of robot.yaml, floors."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from helpers.robots import GEOMS, PUP, SERVOS, variant
from ogmp_sb3.config.robot import ServoConfig
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.robot_spec import robot_spec
from ogmp_sb3.env.servos import read_servos
from ogmp_sb3.env.simulation import Simulation

PHYSICS_DT = 0.002
WORLD = "<worldbody>"
FLOOR = '<geom name="floor" type="plane" size="5 5 1"/>'
MOTORS = '<motor ctrlrange="-9 9"/>'


def poses(model: mujoco.MjModel, joints: dict[str, float]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Place and axes of every body in the world, with joints at these positions."""
    data = mujoco.MjData(model)
    for name, value in joints.items():
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    return {model.body(i).name: (data.xpos[i].copy(), data.xmat[i].copy()) for i in range(model.nbody)}


def without(*names: str) -> dict[str, Any]:
    """robot.yaml without some joints."""
    kept = [name for name in PUP.joints if name not in names]
    nominal = dict(zip(PUP.joints, PUP.nominal_joints, strict=True))
    return {"joints": tuple(kept), "nominal_joints": tuple(nominal[name] for name in kept)}


@pytest.mark.parametrize(
    "joint",
    [
        '<joint name="FL_knee" class="knee"/>',
        '<joint name="FL_knee" class="knee" pos="0.02 0.01 -0.03" axis="0.3 1 0.2" ref="0.4"/>',
        '<joint name="FL_knee" class="knee" type="slide" axis="0.3 0 1"/>',
    ],
    ids=["plain", "off the axes", "slide"],
)
def test_a_held_joint_is_where_the_joint_would_be(joint: str, tmp_path: Path) -> None:
    change = ('<joint name="FL_knee" class="knee"/>', joint)
    robot = variant(tmp_path, change, hold={"FL_knee": -0.9}, **without("FL_knee"))
    file, held = mujoco.MjModel.from_xml_path(str(robot.mjcf_path)), build_model(robot, PHYSICS_DT, 1)
    others = {"FL_hip_pitch": 0.5, "RR_knee": -1.2}
    expected, found = poses(file, {"FL_knee": -0.9, **others}), poses(held, others)
    for name, (pos, axes) in expected.items():
        np.testing.assert_allclose(found[name][0], pos, atol=1e-12)
        np.testing.assert_allclose(found[name][1], axes, atol=1e-12)
    assert held.nu == file.nu - 1 and held.nv == file.nv - 1 and held.njnt == file.njnt - 1
    np.testing.assert_allclose(held.body_mass.sum(), file.body_mass.sum())


def test_what_measures_or_keeps_a_held_joint_goes_with_it(tmp_path: Path) -> None:
    sensors = '<jointpos joint="FL_knee"/><actuatorfrc actuator="FL_knee"/><jointpos joint="FR_knee"/>'
    key = f'</actuator><keyframe><key name="home" qpos="{" ".join(["0"] * 19)}"/></keyframe>'
    changes = ("<sensor>", f"<sensor>{sensors}"), ("</actuator>", key)
    plain = build_model(variant(tmp_path, *changes), PHYSICS_DT, 1)
    held = build_model(variant(tmp_path, *changes, hold={"FL_knee": -1.5}, **without("FL_knee")), PHYSICS_DT, 1)
    assert (plain.nsensor - held.nsensor, plain.nkey, held.nkey) == (2, 1, 0)


def test_held_joints_are_neither_driven_nor_observed(tmp_path: Path) -> None:
    robot = variant(tmp_path, hold={"FL_knee": -1.5, "FR_knee": -1.5}, **without("FL_knee", "FR_knee"))
    sim = Simulation(robot, 2, PHYSICS_DT, 1, threads=1)
    assert sim.joint_qpos.shape == (10,) and sim.ctrl.shape == (2, 10)


@pytest.mark.parametrize("torque", [None, tuple([7.0] * 12)])
def test_motors_become_servos_with_the_gains_of_the_file(torque: tuple[float, ...] | None, tmp_path: Path) -> None:
    """At rest a servo gives kp times the error, and no more than the motor did: 9 times a gear of 2, or as given."""
    gears = ('<position name="FL_knee"', '<motor gear="2" name="FL_knee"'), ("<position name=", "<motor name=")
    kp, kd = tuple(10.0 + i for i in range(12)), tuple(0.1 * i for i in range(12))
    robot = variant(tmp_path, (SERVOS, MOTORS), *gears, servos=ServoConfig(kp=kp, kd=kd, torque=torque))
    servos = read_servos(build_model(robot, PHYSICS_DT, 1), robot)
    np.testing.assert_allclose(servos.kp, kp)
    np.testing.assert_allclose(servos.kd, kd)
    limits = [18.0 if name == "FL_knee" else 9.0 for name in PUP.joints] if torque is None else torque
    np.testing.assert_allclose(servos.torque_high, limits)
    np.testing.assert_allclose(servos.torque_low, -np.array(limits))
    assert np.isinf(servos.target_high).all()


def test_without_servos_a_file_s_own_are_kept() -> None:
    assert [actuator.name for actuator in robot_spec(PUP).actuators] == list(PUP.joints)
    assert {float(actuator.gainprm[0]) for actuator in robot_spec(PUP).actuators} == {40.0}


def test_a_floor_of_a_robot_s_file_gives_way_to_the_task_s(tmp_path: Path) -> None:
    model = build_model(variant(tmp_path, (WORLD, WORLD + FLOOR)), PHYSICS_DT, 1)
    assert not (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any()
    plain = build_model(PUP, PHYSICS_DT, 1)
    np.testing.assert_array_equal(model.geom_contype, plain.geom_contype)


def test_who_was_paired_with_the_floor_meets_the_ground(tmp_path: Path) -> None:
    """A robot whose feet touch what they are paired with alone: it stands as on its floor."""
    feet = [f"{leg}_foot" for leg in ("FL", "FR", "RL", "RR")]
    alone = (GEOMS, GEOMS.replace('conaffinity="1"', 'conaffinity="0"'))
    grip = 'condim="4" friction="0.7 0.7 0.01 0.001 0.001"'
    pairs = "".join(f'<pair geom1="floor" geom2="{foot}" {grip}/>' for foot in feet)
    robot = variant(tmp_path, alone, (WORLD, WORLD + FLOOR), ("<sensor>", f"<contact>{pairs}</contact><sensor>"))
    text = robot.mjcf_path.read_text(encoding="utf-8")
    for foot in feet:
        head, tail = text.split(f'<body name="{foot}"', 1)
        text = head + f'<body name="{foot}"' + tail.replace("<geom ", f'<geom name="{foot}" ', 1)
    robot.mjcf_path.write_text(text, encoding="utf-8")
    model = build_model(robot, PHYSICS_DT, 1)
    for foot in feet:
        geom = model.geom(foot)
        assert (geom.conaffinity[0], geom.condim[0]) == (1, 4)
        np.testing.assert_allclose(geom.friction, [0.7, 0.01, 0.001])
    assert model.npair == 0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"hold": {"FL_kne": 0.0}}, r"'hold' has no joint 'FL_kne'.*Did you mean 'FL_knee'\?"),
        (
            {"hold": {"FL_knee": 0.3}, **without("FL_knee")},
            "'hold' has 'FL_knee' at 0.3, outside the joint's range, -2.6 to -0.1",
        ),
        ({"hold": {"root": 0.0}}, "'hold' has 'root', which is no joint of one axis"),
        (
            {"hold": {"FL_hip_roll": 0.0}, **without("FL_hip_roll")},
            "'hold' has joint 'FL_hip_roll', but not 'FL_twist', which moves the same body",
        ),
    ],
)
def test_what_cannot_be_held_is_one_sentence(fields: dict[str, Any], message: str, tmp_path: Path) -> None:
    joint = '<joint name="FL_hip_roll" class="roll"/>'
    twice = (joint, f'{joint}<joint name="FL_twist" axis="0 0 1"/>')
    with pytest.raises(ValueError, match=message):
        build_model(variant(tmp_path, twice, **fields), PHYSICS_DT, 1)


@pytest.mark.parametrize(
    ("servos", "message"),
    [
        ({"kp": (1.0,), "kd": (1.0,)}, "12 joints but 1 numbers in servos.kp"),
        ({"kp": (0.0,) * 12, "kd": (1.0,) * 12}, "'servos.kp.0' must be above 0, found 0"),
        ({"kp": (1.0,) * 12, "kd": (-1.0,) * 12}, "'servos.kd.0' must be at least 0, found -1"),
        ({"kp": (1.0,) * 12, "kd": (1.0,) * 12, "torque": (0.0,) * 12}, "'servos.torque.0' must be above 0, found 0"),
    ],
)
def test_servos_that_cannot_be_are_one_sentence(servos: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        variant(tmp_path, servos=ServoConfig(**servos))


def test_a_joint_is_moved_or_held(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'FL_knee' is among 'joints' and in 'hold'"):
        variant(tmp_path, hold={"FL_knee": 0.0})
