"""Mirror images: of joints by their place, of observations by what terms make of them, and of motion in MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from helpers.robots import PUP, variant
from ogmp_sb3 import load_task
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.mirror import Mirror, joint_mirror, mirror_error, mirrors, observation_mirror
from ogmp_sb3.env.observations import Signal
from ogmp_sb3.env.robot_model import build_model

BOTH_SIDES = {"observations.mode_latent.both_sides": True}


def test_hector_s_joints_mirror_each_other_and_turn_against_each_other_about_x_and_z() -> None:
    robot = load_robot("hector")
    mirror = joint_mirror(robot, build_model(robot, 0.002, 0))
    pairs = {
        name: (robot.joints[j], sign) for name, j, sign in zip(robot.joints, mirror.source, mirror.sign, strict=True)
    }
    for joint, sign in (("hip_yaw", -1), ("hip_roll", -1), ("thigh_pitch", 1), ("knee", 1), ("ankle", 1)):
        assert pairs[f"L_{joint}"] == (f"R_{joint}", sign)
        assert pairs[f"R_{joint}"] == (f"L_{joint}", sign)


def test_a_quadruped_s_front_legs_mirror_each_other_and_not_its_hind_legs() -> None:
    mirror = joint_mirror(PUP, build_model(PUP, 0.002, 0))
    assert [PUP.joints[j] for j in mirror.source[:3]] == ["FR_hip_roll", "FR_hip_pitch", "FR_knee"]
    assert [PUP.joints[j] for j in mirror.source[9:]] == ["RL_hip_roll", "RL_hip_pitch", "RL_knee"]
    np.testing.assert_array_equal(mirror.sign.reshape(4, 3), [[-1, 1, 1]] * 4)


def test_a_mirror_image_of_a_mirror_image_is_the_vector_itself() -> None:
    critic = {"critic_observations": {"reference_error": {}}}
    for mirror in mirrors(BatchEnv(load_task("parkour", {**BOTH_SIDES, **critic}), 2)):
        vector = np.random.default_rng(0).normal(size=(3, len(mirror.sign)))
        np.testing.assert_array_equal(mirror(mirror(vector)), vector)
        assert not np.array_equal(mirror(vector), vector)


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_mirrored_actions_give_mirrored_observations(name: str) -> None:
    """MuJoCo is the truth: what a robot does is seen in the mirror by one that does the opposite.

    HECTOR's hips differ a little from side to side, so that they part slowly.
    """
    task = load_task(name, {**BOTH_SIDES, "curriculum": None, "restarts": None, "initial": None})
    one, other = BatchEnv(task, 4, seed=3, threads=1), BatchEnv(task, 4, seed=3, threads=1)
    observation, action, _ = mirrors(one)
    if name == "dive":  # the same flips: mirrored left ones are right ones
        one, other = (BatchEnv(load_task(name, {**BOTH_SIDES, "modes.flip.r": r}), 4, 3) for r in ("left", "right"))
    seen, image = one.reset(), other.reset()
    rng = np.random.default_rng(0)
    for step in range(4):  # then they land, which magnifies it
        scale = one.observation_scale
        np.testing.assert_allclose(image / scale, observation(seen) / scale, atol=0.01 * (1 + step))
        actions = 0.1 * rng.normal(size=(4, 10))
        seen, image = one.step(actions).observation, other.step(action(actions)).observation
    assert np.abs(seen / scale - observation(seen) / scale).max() > 0.5, "the motion itself must not be symmetric"


def test_a_robot_whose_leg_is_elsewhere_has_no_mirror_image(tmp_path: Path) -> None:
    robot = variant(tmp_path, ('<body name="FR_hip" pos="0.15 -0.05 0">', '<body name="FR_hip" pos="0.10 -0.05 0">'))
    with pytest.raises(ValueError, match=r"^robot 'pup' is not symmetric: joint 'FL_hip_roll' has no counterpart"):
        joint_mirror(robot, build_model(robot, 0.002, 0))


def test_a_nominal_pose_that_is_not_symmetric_is_refused() -> None:
    robot = replace(PUP, nominal_joints=(0.05, *PUP.nominal_joints[1:]))
    with pytest.raises(ValueError, match="not symmetric in its nominal pose: compare 'FL_hip_roll' and 'FR_hip_roll'"):
        joint_mirror(robot, build_model(robot, 0.002, 0))


def test_an_observation_of_one_side_alone_has_no_mirror_image() -> None:
    env = BatchEnv(load_task("parkour"), 2)
    joints = joint_mirror(env.task.robot_config, env.sim.model)
    left = {"left_knee": lambda view: Signal(view.joint_pos[:, 3:4], np.ones(1))}
    with pytest.raises(
        ValueError, match=r"^observation 'left_knee' has no mirror image: seen from the other side, its"
    ):
        observation_mirror(left, env.view(), np.zeros(12), joints, both_sides=False)
    knees = {"knees": lambda view: Signal(view.joint_pos[:, [3, 8]], np.ones(2))}
    mirror = observation_mirror(knees, env.view(), np.zeros(12), joints, both_sides=False)
    assert (mirror.source.tolist(), mirror.sign.tolist()) == ([1, 0], [1, 1])


def test_the_latent_has_a_mirror_image_only_with_that_of_the_mirrored_reference() -> None:
    with pytest.raises(ValueError, match="'mode_latent'"):
        mirrors(BatchEnv(load_task("dive", {"observations.mode_latent.both_sides": False}), 2))
    mirrors(BatchEnv(load_task("dive", BOTH_SIDES), 2))


@pytest.mark.parametrize("robot, least, most", [("hector", 1e-5, 0.01), ("pup", 0.0, 1e-9)])
def test_how_far_a_robot_is_from_its_mirror_image(robot: str, least: float, most: float) -> None:
    config = PUP if robot == "pup" else load_robot(robot)
    model = build_model(config, 0.002, 0)
    assert least <= mirror_error(config, model, joint_mirror(config, model)) <= most


def test_a_weight_on_one_side_shows_in_the_mirror_error() -> None:
    model = build_model(PUP, 0.002, 0)
    joints = joint_mirror(PUP, model)
    model.body("FL_foot").mass[:] += 0.5
    mujoco.mj_setConst(model, mujoco.MjData(model))
    assert mirror_error(PUP, model, joints) > 0.01


def test_a_mirror_swaps_and_turns() -> None:
    assert Mirror(np.array([1, 0, 2]), np.array([1.0, 1.0, -1.0]))(np.array([3.0, 4.0, 5.0])).tolist() == [
        4.0,
        3.0,
        -5.0,
    ]
