"""Courses: what the modes ask of ground and robot, laid ahead."""

from __future__ import annotations

import numpy as np
import pytest

from ogmp_sb3.config import registry
from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance.course import REACH, Course, extent
from ogmp_sb3.guidance.sampling import ModeCall

STEADY = {"modes": {"pace": {"v": 0.8, "length": 1.0}, "jump": None, "leap": None}, "curriculum": None}


def camera(view, far: float): ...


def test_the_track_is_laid_as_far_as_any_observation_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry.observations, "_functions", dict(registry.observations._functions))
    registry.observations.register()(registry.looks_ahead(lambda far: far)(camera))
    assert extent(load_task("parkour", STEADY)).lookahead == REACH
    scan = {"points": 20, "spacing": 0.1}
    assert extent(load_task("parkour", {**STEADY, "observations.height_scan": scan})).lookahead == 2.0
    task = load_task("parkour", {**STEADY, "observations.height_scan": scan, "observations.camera": {"far": 5}})
    assert extent(task).lookahead == 5.0
    task = load_task("parkour", {**STEADY, "observations.height_scan": None, "observations.camera": {"far": 200}})
    with pytest.raises(ValueError, match=r"'horizon', or 'observations\.camera', reach 200 m ahead; at most 100 m"):
        extent(task)
    with pytest.raises(ValueError, match=r"speeds in 'modes' times 'horizon' reach 901\.2 m ahead"):
        extent(load_task("parkour", {**STEADY, "observations.height_scan": None, "modes.pace.v": 1001.0}))


def test_behind_the_end_of_a_track_the_ground_is_flat_and_the_speed_that_of_the_last_mode() -> None:
    course, rng = Course(load_task("parkour", {**STEADY, "track.length": 2.5}), num_envs=1), np.random.default_rng(0)
    course.begin(0, rng, 1.0)
    course.extend(0, 3.0, rng, 1.0)
    assert course.modes[0][3:5] == [ModeCall("pace", {"v": 0.8, "length": 1.0})] * 2


def test_every_place_on_a_track_belongs_to_the_mode_that_was_laid_there() -> None:
    course = Course(load_task("parkour", {"curriculum": None}), num_envs=1)
    rng = np.random.default_rng(0)
    course.begin(0, rng, 1.0)
    for x in np.arange(0.0, 8.0, 0.5):
        course.extend(0, float(x), rng, 1.0)
    ends = np.cumsum([call.segment().length for call in course.modes[0]])
    assert len(ends) > 8
    for call, start, end in zip(course.modes[0], [0.0, *ends], ends, strict=False):
        assert course.mode_at(0, start + 1e-6) is call
        assert course.mode_at(0, end - 1e-6) is call
    assert course.mode_at(0, -1.0) is course.modes[0][0]


@pytest.mark.parametrize(
    ("sequence", "repeat"), [(["flip", "settle"], "all"), (["flip"], "last"), (["settle", "flip"], "last")]
)
def test_a_timed_mode_with_ground_of_its_own_can_only_be_the_first(sequence: list[str], repeat: str) -> None:
    task = load_task("dive", {"sampling.sequence": sequence, "sampling.repeat": repeat})
    with pytest.raises(ValueError, match=r"'sampling.sequence' has 'flip' behind another mode"):
        Course(task, 1)


def test_a_timed_mode_with_ground_of_its_own_waits_for_the_next_variant() -> None:
    course, rng = Course(load_task("dive"), 1), np.random.default_rng(0)
    course.begin(0, rng, 1.0)
    course.command(0, ModeCall("flip", {"r": "left", "h": 1.3}))
    course.extend(0, 0.0, rng, 1.0)
    assert [call.name for call in course.modes[0]] == ["flip", "settle"]
    course.begin(0, rng, 1.0)
    assert course.modes[0][0].parameters == {"r": "left", "h": 1.3}


def test_in_a_timed_task_the_last_mode_is_the_present_one() -> None:
    course = Course(load_task("dive"), num_envs=1)
    rng = np.random.default_rng(0)
    course.begin(0, rng, 1.0)
    assert course.mode_at(0, 0.3).name == "flip"
    course.extend(0, 0.0, rng, 1.0)
    assert course.mode_at(0, 0.3).name == "settle"


def test_the_commanded_speed_is_that_of_the_mode_at_a_place() -> None:
    task = load_task("parkour", {**STEADY, "modes.pace": {"v": [0.6, 1.8], "length": [0.4, 1.2]}})
    course, rng = Course(task, num_envs=2), np.random.default_rng(0)
    for row in range(2):
        course.begin(row, rng, 1.0)
    for x in np.arange(0.0, 6.0, 0.25):
        for row in range(2):
            course.extend(row, float(x), rng, 1.0)
        places = np.array([x + 0.01, x + 0.9])
        expected = [course.mode_at(row, place).parameters["v"] for row, place in enumerate(places)]
        assert course.commanded_speed(np.arange(2), places, np.zeros(2, dtype=int)).tolist() == expected
    assert course.commanded_speed(np.array([1]), np.array([-1.0]), np.zeros(1, dtype=int)).shape == (1,)


def test_a_timed_mode_commands_a_speed_at_a_time_wherever_the_robot_is() -> None:
    course, rng = Course(load_task("dive"), num_envs=3), np.random.default_rng(0)
    for row, direction in enumerate(("front", "back", "left")):
        course.command(row, ModeCall("flip", {"r": direction, "h": 1.0}))
        course.begin(row, rng, 1.0)
    rows, x = np.arange(3), np.full(3, 50.0)
    assert course.commanded_speed(rows, x, np.array([0, 10, 5])).tolist() == [1.0, -1.0, 0.0]
    for row in range(3):
        course.extend(row, 0.0, rng, 1.0)
    assert course.commanded_speed(rows, x, np.zeros(3, dtype=int)).tolist() == [0.0, 0.0, 0.0]
