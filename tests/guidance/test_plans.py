"""The oracle's answers, asked for and followed knot by knot."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance.course import Course
from ogmp_sb3.guidance.plans import Plans, segment_set_points, start_state
from ogmp_sb3.guidance.rotations import rpy_to_quat
from ogmp_sb3.guidance.sampling import ModeCall, flat_ground
from ogmp_sb3.guidance.set_points import set_points
from ogmp_sb3.guidance.srb import POS, RPY, STATE_SIZE

ENVS = 3
HORIZON = 5


def begun() -> tuple[Plans, Course]:
    """Plans for robots that were just put down on a track."""
    task = load_task("parkour", {"horizon": HORIZON})
    course = Course(task, ENVS)
    for row in range(ENVS):
        course.begin(row, np.random.default_rng(row), level=1.0)
    return Plans(task, ENVS, course.most_steps), course


def standing() -> np.ndarray:
    states = np.zeros((ENVS, STATE_SIZE))
    states[:, POS.start + 2] = 0.55
    return states


def test_a_query_is_due_when_the_reference_is_at_its_end() -> None:
    plans, course = begun()
    every = np.arange(ENVS)
    plans.query(every, standing(), course)
    for _ in range(HORIZON):
        assert len(plans.due(every)) == 0
        plans.advance()
    np.testing.assert_array_equal(plans.due(every), every)
    np.testing.assert_array_equal(plans.due(every[1:]), every[1:])
    plans.advance()
    np.testing.assert_array_equal(plans.phase, HORIZON)  # rows that nobody asks for any more stay at the last knot


def test_a_query_changes_the_rows_that_ask_and_no_others() -> None:
    plans, course = begun()
    plans.query(np.arange(ENVS), standing(), course)
    plans.advance()
    before = {name: values.copy() for name, values in plans.arrays().items()}
    moved = standing()[1:2]
    moved[:, POS.start] = 0.1
    plans.query(np.array([1]), moved, course)
    for name, values in plans.arrays().items():
        np.testing.assert_array_equal(values[[0, 2]], before[name][[0, 2]])
    assert plans.reference[1, 0, POS.start] == 0.1
    assert plans.phase.tolist() == [1, 0, 1]


def test_orientations_and_latents_are_those_of_the_references() -> None:
    plans, course = begun()
    plans.query(np.arange(ENVS), standing(), course)
    np.testing.assert_array_equal(plans.quat[:, : HORIZON + 1], rpy_to_quat(plans.reference[:, : HORIZON + 1, RPY]))
    assert (np.abs(plans.latent).sum(axis=1) > 0).all()


def test_states_that_are_not_fed_back_do_not_reach_the_oracle() -> None:
    plans, course = begun()
    tilted = standing()
    tilted[:, RPY] = 0.3
    plans.query(np.arange(ENVS), standing(), course)
    level = plans.reference.copy()
    plans.query(np.arange(ENVS), tilted, course)
    np.testing.assert_array_equal(plans.reference, level)


def test_modes_by_themselves_are_asked_for_as_a_course_asks_for_them() -> None:
    task = load_task("parkour", {"curriculum": None})
    segments = [ModeCall("jump", {"w": 0.4, "h": 0.2}).segment(), flat_ground(0.8, 5.0).segment()]
    x0 = start_state(task, segments[0])
    points = segment_set_points(task, segments, x0, HORIZON)
    assert points.state.shape == (1, HORIZON + 1, STATE_SIZE)
    course = Course(task, 1)
    for call in (ModeCall("jump", {"w": 0.4, "h": 0.2}), flat_ground(0.8, 5.0)):
        course.command(0, call)
    course.begin(0, np.random.default_rng(0), level=1.0)
    laid = set_points(course.spans, np.array([False]), x0, np.array([HORIZON]), task.control_dt, task.gait)
    np.testing.assert_array_equal(points.state, laid.state)
    np.testing.assert_array_equal(points.stance, laid.stance)


def test_a_robot_starts_a_mode_on_the_ground_where_the_mode_begins() -> None:
    task = load_task("dive")
    state = start_state(task, ModeCall("flip", {"r": "left", "h": 1.3}).segment())
    assert state[0, POS.start + 2] == task.robot_config.nominal_height + 1.3
    assert np.count_nonzero(state) == 1
