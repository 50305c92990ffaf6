"""A robot's MJCF as a compiled model."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from helpers.robots import COMPILER, FEET, GEOMS, JOINTS, OPTION, PUP, variant, with_attributes
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.env.robot_model import build_model

HECTOR = load_robot("hector")
PHYSICS_DT = 0.002  # s
SUBSTEPS = 15


def test_visual_geoms_go_and_the_state_evolves_the_same_without_them() -> None:
    lean, full = (build_model(HECTOR, PHYSICS_DT, 1, visual=visual) for visual in (False, True))
    assert not (lean.geom_group == 1).any()
    assert (full.geom_group == 1).sum() == full.ngeom - lean.ngeom > 0
    states = []
    for model in (lean, full):
        data = mujoco.MjData(model)
        box = model.geom("terrain_0").id
        model.geom_pos[box], model.geom_size[box] = (0, 0, -1), (5, 5, 1)
        model.geom_rbound[box] = np.sqrt(51)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        rng, contacts = np.random.default_rng(0), 0
        for _ in range(20):
            data.ctrl[:] = rng.uniform(-1, 1, 10)
            mujoco.mj_step(model, data, SUBSTEPS)
            contacts += data.ncon
        assert contacts > 0
        states.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_array_equal(*states)


EYE = '<geom contype="0" conaffinity="0" group="1" mass="0"/>'
TRUNK = '<geom name="trunk" type="box"'
MASSES = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_subtreemass", "dof_M0", "dof_armature", "qpos0")


@pytest.mark.parametrize(
    "changes",
    [
        [],
        [(GEOMS, with_attributes(GEOMS, 'group="1"'))],
        [(EYE, EYE.replace('group="1" mass="0"', 'group="2" density="0"'))],
        [(EYE, EYE.replace('group="1" mass="0"', 'group="2" density="500"'))],
        [(TRUNK, with_attributes(TRUNK, 'contype="0" conaffinity="0" group="1"'))],
        [(COMPILER, with_attributes(COMPILER, 'inertiafromgeom="true"'))],
        [(COMPILER, with_attributes(COMPILER, 'discardvisual="true"'))],
        [(COMPILER, with_attributes(COMPILER, 'inertiagrouprange="0 0"')), (EYE, EYE.replace('mass="0"', 'mass="1"'))],
        [(COMPILER, with_attributes(COMPILER, 'settotalmass="9"'))],
        [(COMPILER, with_attributes(COMPILER, 'fusestatic="true" alignfree="true"'))],
    ],
    ids=lambda changes: " ".join(written[:60] for _, written in changes) or "as it is",
)
@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass'")
def test_a_robot_has_the_geoms_that_collide_and_all_its_mass(changes: list[tuple[str, str]], tmp_path: Path) -> None:
    unfused = [(found, written.replace('fusestatic="true" alignfree="true"', "")) for found, written in changes]
    truth = mujoco.MjModel.from_xml_path(str(variant(tmp_path, *unfused).mjcf_path))
    robot = variant(tmp_path, *changes)
    lean, full = (build_model(robot, PHYSICS_DT, 1, visual=visual) for visual in (False, True))
    for model in (lean, full):
        for name in MASSES:
            np.testing.assert_allclose(getattr(model, name), getattr(truth, name), rtol=1e-12, atol=1e-15, err_msg=name)
    colliding = [(m.geom_contype | m.geom_conaffinity).astype(bool) & (m.geom_bodyid > 0) for m in (truth, lean, full)]
    for model, of_it in zip((lean, full), colliding[1:], strict=True):
        np.testing.assert_array_equal(model.geom_size[of_it], truth.geom_size[colliding[0]])
    assert full.ngeom - 1 == truth.ngeom or "discardvisual" in str(changes)
    assert lean.ngeom < full.ngeom or "inertiafromgeom" in str(changes)


def test_geoms_that_are_only_seen_stay_where_something_names_them(tmp_path: Path) -> None:
    eye = ('<geom class="eye" type="box"', '<geom name="nose" class="eye" type="box"')
    names = ("<sensor>", '<sensor><framepos objtype="geom" objname="nose"/>')
    model = build_model(variant(tmp_path, eye, names), PHYSICS_DT, 1)
    assert model.geom("nose").contype[0] == model.geom("nose").conaffinity[0] == 0


def test_pictures_show_a_robot_of_hidden_groups_and_no_floor_of_its_own(tmp_path: Path) -> None:
    hidden = [(GEOMS, with_attributes(GEOMS, 'group="3"')), (EYE, EYE.replace('"1" mass', '"4" mass'))]
    floor = ("<worldbody>", '<worldbody><geom type="plane" size="5 5 1" contype="0" conaffinity="0" group="3"/>')
    model = build_model(variant(tmp_path, *hidden, floor), PHYSICS_DT, 0, visual=True)
    assert not (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any()
    assert (model.geom_group == 0).all()


def test_terrain_is_the_same_whatever_the_defaults_of_a_robot(tmp_path: Path) -> None:
    odd = 'condim="4" solref="0.004 1" margin="0.01" quat="0 1 0 0" priority="3" surfacevel="1 0 0 0 0 0" group="5"'
    grounds = [
        build_model(robot, PHYSICS_DT, 2).geom("terrain_1")
        for robot in (PUP, variant(tmp_path, (GEOMS, with_attributes(GEOMS, odd))))
    ]
    for name in ("condim", "solref", "margin", "quat", "priority", "group", "friction", "contype", "conaffinity"):
        np.testing.assert_array_equal(*(getattr(ground, name) for ground in grounds), err_msg=name)


def test_every_terrain_box_is_there_with_the_physics_step_asked_for() -> None:
    model = build_model(HECTOR, 0.001, 5)
    names = [model.geom(i).name for i in range(model.ngeom)]
    assert [n for n in names if n.startswith("terrain_")] == [f"terrain_{i}" for i in range(5)]
    assert model.opt.timestep == 0.001


@pytest.mark.parametrize(
    "change, message",
    [
        ({"base": "trunck"}, r"no body 'trunck' .*Did you mean 'trunk'\?$"),
        ({"feet": ("L_toe", "R_tow")}, r"no body 'R_tow' .*Did you mean 'R_toe'\?$"),
        ({"joints": (*HECTOR.joints[:-1], "R_ankel")}, r"no joint 'R_ankel' .*Did you mean 'R_ankle'\?$"),
    ],
)
def test_a_name_that_the_mjcf_lacks_is_one_sentence_with_the_closest_match(
    change: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        build_model(replace(HECTOR, **change), PHYSICS_DT, 1)
    assert "hector.xml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_joint_left_out_of_robot_yaml_is_an_error() -> None:
    fewer = replace(HECTOR, joints=HECTOR.joints[:-1], nominal_joints=HECTOR.nominal_joints[:-1])
    with pytest.raises(
        ValueError, match=r"actuator 'R_ankle' moves joint 'R_ankle', which is neither among the 'joints'"
    ):
        build_model(fewer, PHYSICS_DT, 1)


def test_a_missing_mjcf_file_is_one_sentence(tmp_path: object) -> None:
    with pytest.raises(ValueError, match=r"nowhere\.xml") as caught:
        build_model(replace(HECTOR, mjcf="nowhere.xml"), PHYSICS_DT, 1)
    assert "\n" not in str(caught.value)


WORLD = "<worldbody>"
BALL = '<body name="ball" pos="1 0 1"><freejoint/><geom size="0.1"/></body>'
FLOOR = '<geom name="floor" type="plane" size="5 5 1"/>'
ROOT_JOINT = '<freejoint name="root"/>'


@pytest.mark.parametrize(
    ("found", "written", "message"),
    [
        (WORLD, f'{WORLD}<geom name="step" type="box" size="1 1 1"/>', "geom 'step' of the world collides"),
        (WORLD, f'{WORLD}<body name="stage">{FLOOR}</body>', "geom 'floor' of body 'stage' collides"),
        (WORLD, f'{WORLD}<body name="wall" mocap="true"><geom size="1"/></body>', "geom '0' of body 'wall' collides"),
        (WORLD, WORLD + BALL, "body 'ball' moves, but is not of the robot"),
        (ROOT_JOINT, '<joint type="slide" axis="0 0 1"/>', "the base 'trunk' must have a free joint"),
        (
            "<sensor>",
            '<equality><weld name="stand" body1="trunk"/></equality><sensor>',
            "'stand' ties the robot to what is not",
        ),
        (
            "<sensor>",
            '<equality><connect body1="FL_foot" body2="world" anchor="0 0 0"/></equality><sensor>',
            "'0' ties the robot to what",
        ),
        (
            WORLD,
            f'<equality><weld body1="trunk" body2="post"/></equality>{WORLD}<body name="post"/>',
            "equality '0' ties the robot to what is not of the robot",
        ),
        (
            'name="trunk" pos',
            'name="trunk" quat="1 1 0 0" pos',
            "z axis of the base 'trunk' must .* tilted by 90° there",
        ),
        (COMPILER, with_attributes(COMPILER, 'inertiagrouprange="1 1"'), r"larger than mjMINVAL .* line 58$"),
        ('name="trunk" pos', 'name="trunk" gravcomp="1" pos', "body 'trunk' has gravcomp"),
        (
            OPTION,
            'cone="pyramidal" gravity="0 0 -1.62"/>',
            r"option gravity is 0 0 -1\.62; oracles plan with 0 0 -9\.81",
        ),
        (OPTION, 'cone="pyramidal" gravity="0 -9.81 0"/>', "option gravity is 0 -9.81 0"),
        *(
            (OPTION, f'cone="pyramidal"><flag {flag}="disable"/></option>', f"option flag '{flag}' is disabled")
            for flag in ("contact", "constraint", "actuation", "gravity")
        ),
        ('name="trunk" type="box"', 'name="terrain_0" type="box"', "repeated name 'terrain_0'"),
    ],
)
def test_a_model_that_would_not_do_what_the_task_asks_is_refused(
    found: str, written: str, message: str, tmp_path: Path
) -> None:
    robot = variant(tmp_path, (found, written))
    with pytest.raises(ValueError, match=message) as caught:
        build_model(robot, PHYSICS_DT, 1)
    assert str(caught.value).startswith(f"{robot.mjcf_path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("end", "refused"), [("up", True), ("front", False)])
def test_a_tendon_may_tie_the_robot_to_itself_alone(end: str, refused: bool, tmp_path: Path) -> None:
    tendon = f'<tendon><spatial name="cord"><site site="{end}"/><site site="back"/></spatial></tendon><sensor>'
    sites = (TRUNK, f'<site name="front" pos="0.2 0 0"/><site name="back"/>{TRUNK}')
    robot = variant(tmp_path, ("<sensor>", tendon), sites, (WORLD, f'{WORLD}<site name="up" pos="0 0 2"/>'))
    with pytest.raises(ValueError, match="tendon 'cord' ties the robot to") if refused else nullcontext():
        build_model(robot, PHYSICS_DT, 1)


@pytest.mark.parametrize("foot", ["world", "post"])
def test_a_foot_is_of_the_robot(foot: str, tmp_path: Path) -> None:
    robot = variant(tmp_path, (WORLD, f'{WORLD}<body name="post"/>'), feet=("FL_foot", foot))
    with pytest.raises(ValueError, match=f"foot '{foot}' is not of the robot"):
        build_model(robot, PHYSICS_DT, 1)


def test_what_a_pair_lets_collide_with_the_world_is_refused(tmp_path: Path) -> None:
    step = (WORLD, f'{WORLD}<geom name="step" type="box" size="1 1 1" contype="0" conaffinity="0"/>')
    pair = ("<sensor>", '<contact><pair geom1="step" geom2="trunk"/></contact><sensor>')
    with pytest.raises(ValueError, match="geom 'step' of the world collides"):
        build_model(variant(tmp_path, step, pair), PHYSICS_DT, 1)


@pytest.mark.parametrize(
    "changes",
    [
        [(WORLD, f'{WORLD}<body name="goal" mocap="true"><geom size="1" contype="0" conaffinity="0"/></body>')],
        [("<sensor>", '<equality><weld body1="trunk" active="false"/></equality><sensor>')],
        [("<sensor>", '<equality><connect body1="FL_foot" body2="FR_foot" anchor="0 0 0"/></equality><sensor>')],
        [('name="trunk" pos', 'name="trunk" quat="1 0 0 1" pos')],
        [("<sensor>", '<equality><joint joint1="FL_hip_roll" joint2="FR_hip_roll"/></equality><sensor>')],
        [(OPTION, 'cone="elliptic" gravity="0 0 -9.8" impratio="10"/>'), ("implicitfast", "RK4")],
        [(JOINTS, with_attributes(JOINTS, 'stiffness="2" springref="0.1"'))],
        [(FEET, with_attributes(FEET, 'margin="0.001" condim="6" priority="1"'))],
    ],
)
def test_a_model_that_does_what_the_task_asks_is_not_refused(changes: list[tuple[str, str]], tmp_path: Path) -> None:
    build_model(variant(tmp_path, *changes), PHYSICS_DT, 1)


def test_flags_that_would_blind_or_stop_a_simulation_are_the_simulator_s(tmp_path: Path) -> None:
    flags = 'cone="pyramidal"><flag sensor="disable" sleep="enable" autoreset="enable" midphase="enable"/></option>'
    option = build_model(variant(tmp_path, (OPTION, flags)), PHYSICS_DT, 1).opt
    disable = mujoco.mjtDisableBit
    assert not option.disableflags & disable.mjDSBL_SENSOR
    assert not option.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP
    assert option.disableflags & disable.mjDSBL_AUTORESET and option.disableflags & disable.mjDSBL_MIDPHASE
