"""The oracle's answers, asked for and followed knot by knot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ogmp_sb3.config.answers import FunctionFailed
from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance.course import Course
from ogmp_sb3.guidance.plans import CheckedOracle, Plans, segment_set_points, start_state
from ogmp_sb3.guidance.rotations import quat_to_rpy, rpy_to_quat
from ogmp_sb3.guidance.sampling import ModeCall, flat_ground
from ogmp_sb3.guidance.set_points import Reference, SetPoints, set_points
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


@pytest.mark.parametrize("feedback", [["pitch"], ["roll", "pitch", "yaw"]])
def test_a_body_beyond_a_quarter_turn_is_fed_back_as_it_turned(feedback: list[str]) -> None:
    """The state of a body pitched by 1.8 rad has half a turn of roll and yaw; no oracle should plan these back."""
    task = load_task("dive", {"feedback": feedback, "oracle": "lqr"})
    course = Course(task, 1)
    course.begin(0, np.random.default_rng(0), level=1.0)
    plans = Plans(task, 1, course.most_steps)
    states = np.zeros((1, STATE_SIZE))
    states[0, RPY] = quat_to_rpy(rpy_to_quat(np.array([0.0, 1.8, 0.0])))
    plans.query(np.arange(1), states, course)
    np.testing.assert_allclose(plans.reference[0, 0, RPY], [0.0, 1.8, 0.0], atol=1e-9)
    assert np.abs(states[0, RPY.start]) == pytest.approx(np.pi)  # what was given is left alone


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


ROWS, KNOTS = 2, 4
POINTS = SetPoints(
    np.zeros((ROWS, KNOTS + 1, STATE_SIZE)),
    np.ones((ROWS, KNOTS), dtype=bool),
    np.zeros((ROWS, KNOTS), dtype=int),
    np.full(ROWS, KNOTS),
    blend=8.0,
)
RIGHT = Reference(POINTS.state, POINTS.steps)
WRONG = {
    "nothing": (None, "what oracle 'mine' returns must be a Reference, .* it is nothing"),
    "states alone": (POINTS.state, r"must be a Reference, .* it is an array of shape \(2, 5, 12\) of float64"),
    "a knot short": (
        replace(RIGHT, state=np.zeros((2, 4, 12))),
        r"the state .* shape \(2, 5, 12\); it is .*\(2, 4, 12\)",
    ),
    "integers": (replace(RIGHT, state=np.zeros((2, 5, 12), int)), "the state of the Reference .* it is .* of int64"),
    "list": (replace(RIGHT, state=[0.0]), "the state .* it is the list"),  # type: ignore[arg-type]
    "NaN": (replace(RIGHT, state=np.full((2, 5, 12), np.nan)), "the state .*'mine' must be finite; it holds nan"),
    "one number of steps": (replace(RIGHT, steps=4), "the steps .* it is the number 4"),  # type: ignore[arg-type]
    "halves of steps": (replace(RIGHT, steps=np.full(2, 0.5)), "the steps of the Reference .* it is .* of float64"),
    "steps of each knot": (replace(RIGHT, steps=np.zeros((2, 5), int)), r"the steps .* shape \(2,\); it is .*\(2, 5\)"),
}


@pytest.mark.parametrize("case", WRONG)
def test_an_oracle_answers_with_a_finite_reference_for_each_row(case: str) -> None:
    answer, message = WRONG[case]
    oracle = CheckedOracle("mine", lambda points, x0: answer)  # type: ignore[arg-type, return-value]
    for _ in range(2):  # a wrong answer stays wrong
        with pytest.raises((TypeError, ValueError), match=message):
            oracle(POINTS, np.zeros((ROWS, STATE_SIZE)))


def test_only_the_first_answer_is_looked_at_and_only_where_the_state_is_finite() -> None:
    spoilt = replace(RIGHT, state=POINTS.state.copy())
    spoilt.state[1] = np.nan
    x0 = np.zeros((ROWS, STATE_SIZE))
    x0[1, 3] = np.inf
    answers: Any = iter([spoilt, None])
    oracle = CheckedOracle("mine", lambda points, x0: next(answers))
    assert oracle(POINTS, x0) is spoilt
    assert oracle(POINTS, x0) is None


def test_an_exception_of_an_oracle_names_it_and_its_line() -> None:
    def fails(points: SetPoints, x0: np.ndarray) -> Reference:
        raise RuntimeError("no plan")

    with pytest.raises(FunctionFailed, match=r"^oracle 'mine' failed in line \d+ of guidance/test_plans.py: .* no pl"):
        CheckedOracle("mine", fails)(POINTS, np.zeros((ROWS, STATE_SIZE)))
