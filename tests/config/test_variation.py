"""The curriculum: every environment has a level of its own, moved by how long its episodes last. Initial states."""

import re
from typing import Any

import numpy as np
import pytest

from helpers.batches import OPEN, SEED, TASKS, last, put_upright, with_levels
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv


def test_a_level_starts_at_zero_and_rises_by_a_step_after_an_episode_that_lasted() -> None:
    env = with_levels(2)
    env.reset()
    np.testing.assert_array_equal(env.level, 0.0)
    for expected in (0.25, 0.5, 0.75, 1.0, 1.0):
        last(env, 9)
        env.reset()
        np.testing.assert_array_equal(env.level, expected)


@pytest.mark.parametrize("steps, change", [(1, -0.25), (2, -0.25), (3, 0.0), (8, 0.0), (9, 0.25), (10, 0.25)])
def test_a_level_moves_with_the_share_of_the_time_limit_survived(steps: int, change: float) -> None:
    env = with_levels(1)
    env.reset()
    env.level[:] = 0.5
    last(env, steps)
    env.reset()
    assert env.level[0] == 0.5 + change


def test_a_level_stays_above_zero_and_only_rows_that_ended_change() -> None:
    env = with_levels(3)
    env.reset()
    env.level[:] = [0.1, 0.5, 0.9]
    last(env, 1)
    env.reset(np.array([0]))
    np.testing.assert_array_equal(env.level, [0.0, 0.5, 0.9])
    last(env, 8)
    env.reset(np.array([2]))
    np.testing.assert_array_equal(env.level, [0.0, 0.5, 1.0])


@pytest.mark.parametrize("steps", [0, 1])
def test_an_episode_that_is_broken_off_is_no_failure(steps: int) -> None:
    env = with_levels(2)
    env.reset()
    env.level[:] = 0.5
    for _ in range(steps):
        assert not env.step(np.zeros((2, 10))).terminated.any()
    env.reset()
    np.testing.assert_array_equal(env.level, 0.5)


def test_an_episode_that_ends_by_its_time_limit_raises_the_level() -> None:
    env = with_levels(1)
    env.reset()
    while not env.step(np.zeros((1, 10))).truncated[0]:
        pass
    env.reset()
    assert env.level[0] == 0.25


@pytest.mark.parametrize("name", [name for name in TASKS if load_task(name).curriculum is not None])
@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_a_level_draws_from_the_ranges_between_the_easy_ones_and_the_task_s(name: str, level: float) -> None:
    task = load_task(name, OPEN)
    env = BatchEnv(task, 1, SEED, threads=1)
    env.level[:] = level
    env.reset()
    assert env.level[0] == level
    put_upright(env, np.array([100.0]))
    env.step(np.zeros((1, 10)))
    for call in env.modes[0]:
        easy = task.curriculum.modes.get(call.name, {})
        for key, value in call.parameters.items():
            full = task.mode_ranges[call.name][key]
            start = easy.get(key, full)
            assert start.low + level * (full.low - start.low) <= value <= start.high + level * (full.high - start.high)
    drawn = {call.name for call in env.modes[0]}
    weights = {mode: task.curriculum.weights.get(mode, 1.0) for mode in task.mode_ranges}
    assert drawn == {mode for mode in task.mode_ranges if level > 0 or weights[mode] > 0}


def test_without_a_curriculum_every_episode_is_the_whole_task() -> None:
    env = with_levels(2, curriculum=None)
    env.reset()
    last(env, 1)
    env.reset()
    np.testing.assert_array_equal(env.level, 1.0)


# ---- initial states ----


@pytest.mark.parametrize(
    "initial, message",
    [
        ({"yaw": 180}, "'initial': 'yaw' must lie between -3.15 and 3.15, found 180."),
        ({"x": [-2, 0]}, "'initial': 'x' must lie between -1 and 1, found -2."),
        ({"y": [-1.0, 0]}, "'initial.y' must lie on the track, which is 2 m wide, found -1 to 0."),
        ({"joint_pos": "front"}, "'initial': 'joint_pos' must be a number or [low, high], found front."),
        ({"velocity": [0.1, -0.1]}, "'initial.velocity' is a reversed range"),
        ({"z": 0.1}, "'initial.z' is not a known key (allowed: joint_pos, velocity, x, y, yaw)."),
        (0.1, "'initial' must be a mapping, found the number 0.1."),
    ],
)
@pytest.mark.parametrize("place", ["", "evaluation."])
def test_an_initial_state_that_cannot_be_is_one_sentence(initial: Any, message: str, place: str) -> None:
    message = message.replace("'initial", f"'{place}initial")
    with pytest.raises((ValueError, TypeError, KeyError), match=re.escape(message)):
        load_task("parkour", {f"{place}initial": initial})
