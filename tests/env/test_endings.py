"""Which rule ends an episode of BatchEnv, over every shipped task."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.batches import OPEN, SEED, TASKS, actions, at_full_level, ended
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("rho", [0.05, 0.1])
def test_an_episode_ends_by_the_bound_if_and_only_if_the_deviation_exceeds_rho(name: str, rho: float) -> None:
    task = at_full_level(load_task(name, {"rho": rho}))
    env = BatchEnv(task, 6, SEED, threads=1)
    env.reset()
    causes = set()
    for command in actions(40, 6):
        result = env.step(command)
        weighted = (result.view.state - result.view.reference) * np.array(task.bound_weights)
        np.testing.assert_allclose(result.view.deviation, np.linalg.norm(weighted, axis=1), atol=1e-12)
        np.testing.assert_array_equal(result.termination == "bound", result.view.deviation > rho)
        assert result.terminated[result.termination == "bound"].all()
        causes |= set(result.termination.tolist())
        if len(ended(result)):
            env.reset(ended(result))
    assert "bound" in causes
    assert len(causes) > 1  # both sides were seen


@pytest.mark.parametrize("name", TASKS)
def test_every_other_cause_is_what_the_step_shows(name: str) -> None:
    task = at_full_level(load_task(name, {"rho": None, "episode_steps": 40, "min_step_reward": 0.5}))
    task = replace(task, terminations={"fall": {"min_height": 0.4}})
    env = BatchEnv(task, 4, SEED, threads=1)
    env.reset()
    causes = set()
    for command in actions(90, 4, scale=0.1):
        count = env.step_count + 1
        result = env.step(command)
        view = result.view
        low = view.base_pos_w[:, 2] - np.maximum(view.ground_height, 0.0) < 0.4
        poor = result.reward < 0.5
        expected = np.select([low, poor, count >= 40], ["fall", "low_reward", "time_limit"], "")
        np.testing.assert_array_equal(result.termination, expected)
        causes |= set(expected.tolist())
        if len(ended(result)):
            env.reset(ended(result))
    assert {"", "fall"} <= causes


@pytest.mark.parametrize("name", TASKS)
def test_the_time_limit_is_a_truncation_at_exactly_the_step_asked_for(name: str) -> None:
    env = BatchEnv(replace(load_task(name, {**OPEN, "episode_steps": 7}), terminations={}), 2, SEED, threads=1)
    for _ in range(2):
        env.reset()
        for step in range(1, 8):
            result = env.step(np.zeros((2, 10)))
            np.testing.assert_array_equal(result.truncated, step == 7)
            assert not result.terminated.any()
        np.testing.assert_array_equal(result.termination, "time_limit")


@pytest.mark.parametrize("name", TASKS)
def test_an_unguided_episode_never_ends_by_the_bound(name: str) -> None:
    env = BatchEnv(load_task(name, {"rho": None, "min_step_reward": None}), 4, SEED, threads=1)
    env.reset()
    furthest = 0.0
    for command in actions(100, 4, scale=1.0):
        result = env.step(command)
        furthest = max(furthest, result.view.deviation.max())
        assert not (result.termination == "bound").any()
        assert not (result.termination == "low_reward").any()
    assert furthest > 0.3


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("field, value", [("qvel", np.nan), ("qpos", np.nan), ("qvel", 1e12)])
def test_a_row_that_explodes_ends_as_unstable_and_no_other_row_changes(name: str, field: str, value: float) -> None:
    task, commands = at_full_level(load_task(name)), actions(12, 3, 0.02)
    env, control = (BatchEnv(task, 3, SEED, threads=1) for _ in range(2))
    env.reset(), control.reset()
    for step, command in enumerate(commands):
        if step == 4:
            getattr(env.sim, field)[1, 2] = value
        result, expected = env.step(command), control.step(command)
        assert np.isfinite(result.observation).all()
        assert np.isfinite(result.reward).all()
        for name_ in ("observation", "reward", "termination"):
            np.testing.assert_array_equal(getattr(result, name_)[[0, 2]], getattr(expected, name_)[[0, 2]])
        if step == 4:
            assert result.termination[1] == "unstable"
            assert result.terminated[1]
            assert np.isfinite(env.reset(np.array([1]))).all()
        else:
            assert result.termination[1] != "unstable"


@pytest.mark.parametrize("name", TASKS)
def test_an_action_that_is_not_a_number_ends_its_own_row(name: str) -> None:
    env = BatchEnv(load_task(name), 2, SEED, threads=1)
    env.reset()
    command = np.zeros((2, 10))
    command[1, 3] = np.nan
    result = env.step(command)
    np.testing.assert_array_equal(result.termination, ["", "unstable"])
    assert np.isfinite(result.reward).all()


@pytest.mark.parametrize("name", TASKS)
def test_the_test_protocol_ends_only_by_a_fall_or_its_time_limit(name: str) -> None:
    task = load_task(name).for_evaluation()
    env = BatchEnv(task, 4, SEED, threads=1)
    env.reset()
    causes = set()
    for command in actions(120, 4, 0.1):
        result = env.step(command)
        causes |= set(result.termination.tolist())
        if len(ended(result)):
            env.reset(ended(result))
    assert causes <= {"", *task.terminations, "time_limit"}
    assert "fall" in causes
    np.testing.assert_array_equal(env.level, 1.0)
