"""Robots whose robot.yaml was written by hand, found again in their models; and models that differ from them."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from helpers.robots import PUP, SERVOS
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.robot_check import foot_clearance, stand
from ogmp_sb3.porting.port import Given, port
from ogmp_sb3.porting.robot_yaml import robot_yaml

HECTOR = load_robot("hector")


def changed(robot: RobotConfig, folder: Path, *changes: tuple[str, str]) -> str:
    """The MJCF of a robot with changes, as a file of a folder."""
    mjcf = robot.mjcf_path.read_text(encoding="utf-8")
    for found, written in changes:
        assert found in mjcf, found
        mjcf = mjcf.replace(found, written)
    (folder / "model.xml").write_text(mjcf, encoding="utf-8")
    return "model.xml"


@pytest.mark.parametrize("robot", [HECTOR, PUP], ids=["hector", "pup"])
def test_a_robot_is_found_as_a_person_described_it(robot: RobotConfig, tmp_path: Path) -> None:
    found = port(str(robot.mjcf_path), robot.name, tmp_path, Given()).robot
    assert (found.base, found.joints, found.feet) == (robot.base, robot.joints, robot.feet)
    assert (found.servos, found.hold) == (None, {})
    assert found.srb.mass == pytest.approx(robot.srb.mass, abs=1e-3)
    assert found.leg_length == pytest.approx(robot.leg_length, rel=0.06)
    assert found.nominal_height == pytest.approx(robot.nominal_height, abs=0.01)
    np.testing.assert_allclose(found.nominal_joints, robot.nominal_joints, atol=0.1)


def test_a_crouch_has_level_feet_under_the_centre_of_mass_and_stands(tmp_path: Path) -> None:
    """A quadruped, of whose model no pose is known but its straight legs."""
    robot = port(str(PUP.mjcf_path), "pup", tmp_path, Given()).robot
    model = mujoco.MjModel.from_xml_path(str(PUP.mjcf_path))
    data = mujoco.MjData(model)
    for name, value in zip(robot.joints, robot.nominal_joints, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_forward(model, data)
    feet = np.array([data.body(foot).xpos for foot in robot.feet])
    np.testing.assert_allclose(feet[:, 2], feet[0, 2], atol=1e-3)
    np.testing.assert_allclose(feet.mean(axis=0)[:2], data.subtree_com[model.body("trunk").id][:2], atol=2e-3)
    assert 0.001 < foot_clearance(robot, 0.002) < 0.004
    (standing,) = stand(robot, 0.002, (0.0,))
    assert standing.tilt < 0.1 and not standing.body_contact and standing.feet_contact


def test_what_is_written_is_what_was_found(tmp_path: Path) -> None:
    arm = (
        '<body name="FL_hip"',
        '<body name="arm" pos="0.1 0 0.1"><joint name="wrist" axis="0 1 0" range="-1 1"/>'
        '<geom size="0.02" mass="0.1"/></body><body name="FL_hip"',
    )
    motors = (SERVOS, '<motor ctrlrange="-15 15"/>'), ("<position name=", "<motor name=")
    drive = ("</actuator>", '<motor name="wrist" joint="wrist"/></actuator>')
    found = port(changed(PUP, tmp_path, arm, *motors, drive), "mule", tmp_path, Given())
    (tmp_path / "robot.yaml").write_text(robot_yaml(found), encoding="utf-8")
    assert load_robot(str(tmp_path / "robot.yaml")) == replace(found.robot, path=tmp_path / "robot.yaml")
    assert found.robot.hold == {"wrist": 0.0} and found.robot.servos is not None
    assert set(found.robot.servos.kp) == {15.0} and set(found.robot.servos.torque or ()) == {15.0}
    (standing,) = stand(found.robot, 0.002, (0.0,))
    assert standing.tilt < 0.2 and standing.feet_contact


def test_numbers_that_are_given_are_taken(tmp_path: Path) -> None:
    given = Given(kp=40.0, kd=0.8, torque=9.0, feet=("FL_shank", "FR_shank", "RL_shank", "RR_shank"))
    bodies = {body.name for body in mujoco.MjSpec.from_file(str(PUP.mjcf_path)).bodies}
    assert set(given.feet) <= bodies, bodies
    robot = port(str(PUP.mjcf_path), "pup", tmp_path, given).robot
    assert robot.servos is not None and robot.feet == given.feet
    assert (set(robot.servos.kp), set(robot.servos.kd), set(robot.servos.torque or ())) == ({40.0}, {0.8}, {9.0})


URDF = """<robot name="hopper">
  <link name="trunk">
    <inertial><mass value="5"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>
  </link>
  {legs}
</robot>"""
LEG = """<link name="{s}_thigh"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="{s}_shank"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="{s}_foot"><inertial><mass value="0.1"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.16 0.06 0.02"/></geometry></collision></link>
  <joint name="{s}_hip" type="revolute"><parent link="trunk"/><child link="{s}_thigh"/>
    <origin xyz="0 {y} -0.1"/><axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="40" velocity="10"/></joint>
  <joint name="{s}_knee" type="revolute"><parent link="{s}_thigh"/><child link="{s}_shank"/>
    <origin xyz="0 0 -0.2"/><axis xyz="0 1 0"/><limit lower="0" upper="2.5" effort="60" velocity="10"/></joint>
  <joint name="{s}_ankle" type="revolute"><parent link="{s}_shank"/><child link="{s}_foot"/>
    <origin xyz="0 0 -0.2"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="20" velocity="10"/></joint>"""


def test_a_urdf_has_neither_actuators_nor_a_free_base_and_gets_both(tmp_path: Path) -> None:
    """A biped of planar legs: its effort limits make the servos, the leg is 2 x 0.2 m and half a sole."""
    text = URDF.format(legs=LEG.format(s="left", y=0.1) + LEG.format(s="right", y=-0.1))
    (tmp_path / "hopper.urdf").write_text(text, encoding="utf-8")
    robot = port("hopper.urdf", "hopper", tmp_path, Given()).robot
    assert robot.base == "trunk" and robot.feet == ("left_foot", "right_foot")
    assert robot.joints == tuple(f"{side}_{joint}" for side in ("left", "right") for joint in ("hip", "knee", "ankle"))
    assert robot.servos is not None and robot.servos.torque == (40.0, 60.0, 20.0) * 2
    assert robot.servos.kp == (40.0, 60.0, 20.0) * 2
    assert robot.leg_length == pytest.approx(0.41, abs=1e-3)
    hip, knee, ankle = robot.nominal_joints[:3]
    assert knee > 0.3 and hip + knee + ankle == pytest.approx(0.0, abs=0.02)  # the sole is level
    assert robot.nominal_height == pytest.approx(
        0.1 + 0.2 * (np.cos(hip) + np.cos(hip + knee)) + 0.01 + 0.002, abs=2e-3
    )


def test_gains_that_are_given_replace_no_others(tmp_path: Path) -> None:
    """The model's servos have kp 40 and kd 0.8."""
    robot = port(str(PUP.mjcf_path), "pup", tmp_path, Given(kd=2.0)).robot
    assert robot.servos is not None
    assert (set(robot.servos.kp), set(robot.servos.kd), set(robot.servos.torque or ())) == ({40.0}, {2.0}, {15.0})


def test_joints_without_a_servo_get_one_beside_those_that_have_theirs(tmp_path: Path) -> None:
    motor = ('<position name="FL_knee" joint="FL_knee"/>', '<motor name="FL_knee" joint="FL_knee" ctrlrange="-15 15"/>')
    found = port(changed(PUP, tmp_path, motor), "pup", tmp_path, Given())
    assert found.robot.servos is not None
    gains = dict(zip(found.robot.joints, found.robot.servos.kp, strict=True))
    assert gains.pop("FL_knee") == 15.0 and set(gains.values()) == {40.0}
    assert found.servos == "the model's own of 11 joints, by torque limits (1 rad) and inertia of 1"


TOE = (
    '<body name="FL_toe" pos="0.04 0 0"><joint name="FL_toe" axis="0 1 0" range="-1 1"/>'
    '<geom type="sphere" size="0.02" mass="0.01"/></body>'
)


def with_toe() -> tuple[str, str]:
    """A change that puts a toe onto the first foot."""
    mjcf = PUP.mjcf_path.read_text(encoding="utf-8")
    foot = mjcf[mjcf.index('<body name="FL_foot"') :]
    foot = foot[: foot.index("</body>")]
    return foot, foot + TOE


def test_a_foot_with_toes_is_one_foot_and_what_nothing_drives_is_said(tmp_path: Path) -> None:
    found = port(changed(PUP, tmp_path, with_toe()), "pup", tmp_path, Given())
    assert found.robot.feet == PUP.feet and found.robot.joints == PUP.joints
    assert found.anatomy.passive == ("FL_toe",) and found.robot.hold == {}


def test_a_shank_whose_box_alone_reaches_down_to_the_sole_is_no_foot(tmp_path: Path) -> None:
    """A diamond, turned until a corner of its box is below."""
    vertices = "0.1 0 0  -0.1 0 0  0 0.02 0  0 -0.02 0  0 0 0.09  0 0 -0.09"
    diamond = f'<mesh name="diamond" vertex="{vertices}"/></asset>'
    turned = '<geom type="mesh" mesh="diamond" pos="0 0 -0.05" euler="0 0.785398 0" mass="0.01"/>'
    changes = ("</asset>", diamond), ('<body name="FL_foot"', turned + '<body name="FL_foot"')
    found = port(changed(PUP, tmp_path, *changes), "pup", tmp_path, Given())
    assert found.robot.feet == PUP.feet


@pytest.mark.parametrize("euler", ["0 0 1.2", "1.2 0 0"])
def test_how_the_file_turns_the_base_does_not_matter(euler: str, tmp_path: Path) -> None:
    """In a keyframe, where it lies on its side, or turned away from x."""
    quat = {"0 0 1.2": "0.825 0 0 0.565", "1.2 0 0": "0.825 0.565 0 0"}[euler]
    pose = f"0 0 0.5 {quat} " + " ".join(["0 0.75 -1.5"] * 4)
    key = ("</actuator>", f'</actuator><keyframe><key name="lying" qpos="{pose}"/></keyframe>')
    robot = port(changed(PUP, tmp_path, key), "pup", tmp_path, Given()).robot
    assert robot.joints == PUP.joints and robot.hold == {}
    np.testing.assert_allclose(robot.nominal_joints, PUP.nominal_joints, atol=1e-6)


BODY = '<mujoco><worldbody><body {base} pos="0 0 1"><freejoint/><geom size="0.1"/>{legs}</body></worldbody></mujoco>'
UNNAMED_LEG = '<body {foot} pos="0 {y} -0.2"><joint {joint} axis="0 1 0"/><geom size="0.02" pos="0 0 -0.2"/></body>'


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"base": ""}, "a body of the world has no name: robot.yaml names the base"),
        ({"foot": ""}, "the body below 'trunk' that stands on the ground has no name"),
        ({"joint": ""}, "a joint of body 'leg.*' has no name: robot.yaml names all that it moves"),
    ],
)
def test_parts_without_a_name_are_asked_for_one(names: dict[str, str], message: str, tmp_path: Path) -> None:
    legs = "".join(
        UNNAMED_LEG.format(y=y, foot=names.get("foot", f'name="leg{i}"'), joint=names.get("joint", f'name="hip{i}"'))
        for i, y in enumerate((0.1, -0.1))
    )
    (tmp_path / "m.xml").write_text(BODY.format(base=names.get("base", 'name="trunk"'), legs=legs), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        port("m.xml", "m", tmp_path, Given(torque=10.0))


def test_a_robot_that_looks_along_y_is_told_so(tmp_path: Path) -> None:
    sideways = ('axis="1 0 0"', 'axis="0 -1 0"'), ('axis="0 1 0"', 'axis="1 0 0"')
    found = port(changed(PUP, tmp_path, *sideways), "pup", tmp_path, Given())
    assert not found.forwards and port(str(PUP.mjcf_path), "pup", tmp_path, Given()).forwards


def test_a_small_robot_keeps_its_digits(tmp_path: Path) -> None:
    """A twentieth of the length: inertia falls with the fifth power of it, at the same density."""
    tiny = tmp_path / "tiny.xml"
    spec = mujoco.MjSpec.from_file(str(PUP.mjcf_path))
    for body in spec.bodies:
        body.pos *= 0.05
    for geom in spec.geoms:
        geom.pos, geom.size, geom.mass = 0.05 * geom.pos, 0.05 * geom.size, 0.05**3 * geom.mass
        if np.isfinite(geom.fromto).all():
            geom.fromto *= 0.05
    tiny.write_text(spec.to_xml(), encoding="utf-8")
    small = port(str(tiny), "tiny", tmp_path, Given()).robot
    large = port(str(PUP.mjcf_path), "pup", tmp_path, Given()).robot
    np.testing.assert_allclose(small.srb.inertia, 0.05**5 * np.array(large.srb.inertia), rtol=1e-3)
    assert small.nominal_height == pytest.approx(0.05 * large.nominal_height, rel=0.02)


def bent(knee: str) -> tuple[str, str]:
    """A change that gives the model a keyframe with its knees at an angle."""
    pose = "0 0 0.3 1 0 0 0 " + " ".join([f"0 0.75 {knee}"] * 4)
    return "</actuator>", f'</actuator><keyframe><key name="home" qpos="{pose}"/></keyframe>'


@pytest.mark.parametrize(
    ("changes", "given", "message"),
    [
        (
            [],
            Given(feet=("FL_foot", "FL_shank", "FR_foot")),
            "'FL_foot' and 'FL_shank' are feet of one leg, as joint 'FL_hip_roll'",
        ),
        (
            [('<freejoint name="root"/>', "<joint/>")],
            Given(),
            "the one body of the world with a free joint; this model has none",
        ),
        ([], Given(base="trnk"), r"'base': no body 'trnk' .*Did you mean 'trunk'\?"),
        ([], Given(feet=("FL_fot",)), r"'feet': no body 'FL_fot' .*Did you mean 'FL_foot'\?"),
        ([], Given(feet=("trunk",)), "foot 'trunk': no joint is between it and the base 'trunk'"),
        ([('conaffinity="1"', 'conaffinity="0"')], Given(), "no limb of the robot has a geom that can touch anything"),
        (
            [(SERVOS, "<motor/>"), ("<position name=", "<motor name=")],
            Given(),
            "joint 'FL_hip_roll' has no limit of its torque in the model, .*give torque=<N m>",
        ),
        ([("<worldbody>", "<worldbdy>")], Given(), "model.xml: .*worldbdy"),
        (
            [bent("-0.05")],
            Given(),
            "model.xml, in the pose of its keyframe 'home': .*'FL_knee' is at -0.05 rad, outside",
        ),
    ],
)
def test_what_is_no_robot_is_one_sentence(
    changes: list[tuple[str, str]], given: Given, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        port(changed(PUP, tmp_path, *changes), "pup", tmp_path, given)
    assert "\n" not in str(caught.value)
