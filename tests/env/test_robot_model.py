"""A robot's MJCF as a compiled model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from ogmp_sb3.config.load import load_robot
from ogmp_sb3.env.robot_model import VISUAL_GROUP, build_model
from ogmp_sb3.env.simulation import Simulation

HECTOR = load_robot("hector")


PHYSICS_DT = 0.002  # s


SUBSTEPS = 15


def test_visual_geoms_go_and_the_state_evolves_the_same_without_them() -> None:
    lean, full = (build_model(HECTOR, PHYSICS_DT, 1, visual=visual) for visual in (False, True))
    assert not (lean.geom_group == VISUAL_GROUP).any()
    assert (full.geom_group == VISUAL_GROUP).sum() == full.ngeom - lean.ngeom > 0
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
    with pytest.raises(ValueError, match=r"10 actuators, but robot\.yaml names 9 joints"):
        build_model(fewer, PHYSICS_DT, 1)


def test_a_missing_mjcf_file_is_one_sentence(tmp_path: object) -> None:
    with pytest.raises(ValueError, match=r"nowhere\.xml") as caught:
        build_model(replace(HECTOR, mjcf="nowhere.xml"), PHYSICS_DT, 1)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("found", "written", "message"),
    [
        ('<position name="L_knee"', '<motor name="L_knee"', "'L_knee' must be a position servo of joint 'L_knee'"),
        ('joint="L_knee"', 'joint="R_knee"', "'L_knee' must be a position servo of joint 'L_knee'"),
        ("<worldbody>", '<worldbody><geom name="floor" type="plane" size="5 5 1"/>', "geom 'floor' of the world"),
        ('<contact name="L_calf_contact" body1="L_calf"', '<contact name="x" body1="trunk"', "body 'L_calf' can touch"),
    ],
)
def test_a_model_that_would_not_do_what_the_task_asks_is_refused(
    found: str, written: str, message: str, tmp_path: Path
) -> None:
    mjcf = HECTOR.mjcf_path.read_text(encoding="utf-8")
    assert found in mjcf
    (tmp_path / "model.xml").write_text(mjcf.replace(found, written, 1), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        Simulation(replace(HECTOR, mjcf=str(tmp_path / "model.xml")), 1, PHYSICS_DT, 1, 1)
