"""The oracle's answers, asked for and followed knot by knot."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance.course import Course
from ogmp_sb3.guidance.plans import Plans
from ogmp_sb3.guidance.rotations import rpy_to_quat
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
