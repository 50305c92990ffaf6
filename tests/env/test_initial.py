"""Initial states: what is drawn, that tracks stay, that four are one, and that no robot begins in the ground."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from helpers.batches import OPEN, SEED, actions, assert_same, at_full_level, ended, play
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.guidance.rotations import quat_to_rpy
from ogmp_sb3.guidance.srb import POS, VEL

SMALL = {
    "x": [-0.02, 0.02],
    "y": [-0.03, 0.03],
    "yaw": [-0.2, 0.2],
    "joint_pos": [-0.05, 0.05],
    "velocity": [-0.1, 0.1],
}
ROWS = 40


def task(name: str = "parkour", **initial: Any) -> TaskConfig:
    return at_full_level(load_task(name, {**OPEN, **{f"initial.{key}": value for key, value in initial.items()}}))


def begun(task: TaskConfig, num_envs: int = ROWS) -> BatchEnv:
    env = BatchEnv(task, num_envs, SEED, threads=1)
    env.reset()
    return env


def drawn(env: BatchEnv) -> dict[str, np.ndarray]:
    """What the robots begin with, of each key the values that it draws."""
    sim, p, v = env.sim, env.sim.base_qpos, env.sim.base_qvel
    rpy = quat_to_rpy(sim.qpos[:, p + 3 : p + 7])
    np.testing.assert_allclose(rpy[:, :2], 0.0, atol=1e-12)
    np.testing.assert_array_equal(np.delete(sim.qvel, np.s_[v : v + 3], axis=1), 0.0)
    return {
        "x": sim.qpos[:, p],
        "y": sim.qpos[:, p + 1],
        "yaw": rpy[:, 2],
        "joint_pos": sim.qpos[:, sim.joint_qpos] - np.array(env.task.robot_config.nominal_joints),
        "velocity": sim.qvel[:, v : v + 3],
    }


# ---- what is drawn ----


@pytest.mark.parametrize("key", SMALL)
@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_a_key_draws_what_it_names_within_its_range_and_nothing_else(name: str, key: str) -> None:
    low, high = SMALL[key]
    values = drawn(begun(task(name, **{key: [low, high]})))
    for other, value in values.items():
        if other != key:
            np.testing.assert_allclose(value, 0.0, atol=1e-12, err_msg=other)
    spread = values[key].ravel()
    assert low <= spread.min() < 0.8 * low < 0.8 * high < spread.max() <= high
    assert len(np.unique(spread)) == spread.size  # each robot, joint and axis has its own


def test_a_number_is_fixed() -> None:
    values = drawn(begun(task(x=0.1, yaw=-1.0, velocity=0.3), 2))
    for key, value in {"x": 0.1, "yaw": -1.0, "velocity": 0.3}.items():
        np.testing.assert_allclose(values[key], value, atol=1e-12)


def test_joints_stay_within_their_limits() -> None:
    env = begun(task(joint_pos=[-1.0, 1.0]))
    model = env.sim.model
    low, high = np.array([model.joint(name).range for name in env.task.robot_config.joints]).T
    position = env.sim.qpos[:, env.sim.joint_qpos]
    assert (low <= position).all() and (position <= high).all()
    assert (position == high).any()  # or the test would not see them


def test_an_oracle_plans_from_where_the_robot_is() -> None:
    env = begun(task(x=0.3, y=0.2, velocity=0.5), 1)
    np.testing.assert_allclose(env.plan(0)[0, POS][:2], [0.3, 0.2], atol=1e-12)
    np.testing.assert_allclose(env.plan(0)[0, VEL], 0.5, atol=1e-12)


def test_every_episode_is_drawn_anew() -> None:
    env = begun(task(**SMALL), 1)
    first = env.sim.qpos.copy()
    env.reset()
    assert (np.abs(env.sim.qpos - first)[0, [0, 1, *env.sim.joint_qpos]] > 0).all()


def test_the_test_has_initial_states_of_its_own() -> None:
    overrides = {"initial": {"x": 0.1}, "evaluation.initial": {"yaw": 0.2}}
    tested = load_task("parkour", {**overrides, "evaluation.initial.x": None}).for_evaluation()
    assert tested.initial is not None
    assert (tested.initial.x, tested.initial.yaw.low) == (None, 0.2)  # type: ignore[union-attr]


@pytest.mark.parametrize("name", ["parkour", "dive", "stairs"])
def test_the_shipped_tasks_begin_trainings_alike_and_tests_each_a_little_differently(name: str) -> None:
    shipped = load_task(name)
    assert shipped.initial is None
    env = begun(load_task(name, {"modes.flip": {"r": "front", "h": 1.0}} if name == "dive" else {}).for_evaluation(), 8)
    assert len(np.unique(env.sim.qpos, axis=0)) == 8


# ---- the ground ----


def deepest(env: BatchEnv, row: int) -> float:
    """How deep a robot is in its terrain by MuJoCo's own collisions, m; 0 if nothing touches."""
    model, data = env.sim.mj.get_model(row), mujoco.MjData(env.sim.model)
    data.qpos[:] = env.sim.qpos[row]
    mujoco.mj_forward(model, data)
    of_terrain = model.geom_bodyid[data.contact.geom] == 0
    return max(0.0, -float(data.contact.dist[of_terrain.any(axis=1)].min(initial=0.0)))


@pytest.mark.parametrize(
    "name, initial",
    [
        ("parkour", SMALL),
        ("parkour", {"joint_pos": [-0.5, 0.5], "yaw": [-3.14, 3.14]}),
        ("parkour", {"x": [-1.0, 1.0], "joint_pos": [-0.2, 0.2]}),  # on blocks, and across their edges
        ("stairs", {"x": [0.5, 1.0]}),
        ("dive", SMALL),
        ("dive", {"y": [-0.3, 0.3], "joint_pos": [-0.3, 0.3]}),
    ],
)
def test_no_robot_begins_deeper_in_the_ground_than_in_the_nominal_pose(name: str, initial: dict[str, Any]) -> None:
    usual = deepest(begun(task(name), 1), 0)
    env = begun(task(name, **initial))
    depths = [deepest(env, row) for row in range(ROWS)]
    assert max(depths) <= usual + 1e-6


def test_robots_near_the_nominal_pose_are_raised_by_little() -> None:
    env = begun(task(joint_pos=[-0.02, 0.02]))
    height = env.sim.qpos[:, env.sim.base_qpos + 2] - env.task.robot_config.nominal_height
    assert (height >= 0).all() and 0 < height.max() < 0.02


# ---- streams and states ----


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_tracks_are_the_same_with_and_without(name: str) -> None:
    without, varied = (BatchEnv(task(name, **given), 3, SEED, threads=1) for given in ({}, SMALL))
    assert (without.reset() != varied.reset()).any()
    assert repr(without.modes) == repr(varied.modes)
    np.testing.assert_array_equal(without.terrain, varied.terrain)


def test_disturbances_are_the_same_with_and_without() -> None:
    friction = {
        "randomisation.friction.coefficient": [0.5, 1.5],
        "randomisation.push": {"every": 0.3, "speed": [0.1, 0.5]},
    }
    first, second = (
        BatchEnv(load_task("parkour", {**friction, "initial": initial}), 3, SEED, threads=1)
        for initial in (None, SMALL)
    )
    first.reset()
    second.reset()
    for name, values in first.disturbances.arrays().items():
        if name in ("last", "history"):  # what was observed
            continue
        np.testing.assert_array_equal(values, second.disturbances.arrays()[name])


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_ranges_of_no_size_leave_every_bit_as_it_is_without(name: str) -> None:
    nothing = dict.fromkeys(SMALL, 0.0)
    commands = actions(30, 2)
    without, neutral = (BatchEnv(task(name, **given), 2, SEED, threads=1) for given in ({}, nothing))
    assert_same(play(without, commands), play(neutral, commands))


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_four_rows_equal_four_environments_of_one(name: str) -> None:
    commands = actions(20, 4)
    four = play(BatchEnv(task(name, **SMALL), 4, SEED, threads=1), commands)
    for row in range(4):
        one = play(BatchEnv(task(name, **SMALL), 1, SEED + row, threads=1), commands[:, row : row + 1])
        assert_same(one, four, rows=[row])


@pytest.mark.parametrize("restarts", [None, {"fraction": 0.5, "before": [5, 20]}])
def test_a_saved_state_goes_on_bit_for_bit_in_another_environment(restarts: Any) -> None:
    config = load_task("parkour", {"initial": SMALL, "restarts": restarts})
    commands = actions(90, 3)
    env, other = BatchEnv(config, 3, SEED, threads=1), BatchEnv(config, 3, 77, threads=1)
    env.reset()
    other.reset()
    episodes = 0
    for step, command in enumerate(commands):
        if step == 40:
            other.set_state(*env.state())
        result = env.step(command)
        rows = ended(result)
        first = env.reset(rows) if len(rows) else None
        if step >= 40:
            np.testing.assert_array_equal(other.step(command).observation, result.observation)
            if first is not None:
                episodes += 1
                np.testing.assert_array_equal(other.reset(rows), first)
    assert episodes > 0


def test_a_state_saved_by_a_version_without_initial_states_still_fits() -> None:
    env = begun(task(), 2)
    arrays, plain = env.state()
    assert not [name for name in (*arrays, *plain) if name.startswith("initial")]
    env.set_state(arrays, plain)
