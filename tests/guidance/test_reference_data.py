"""The references that an encoder is trained on are those that policies ask for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance.plans import make_oracle
from ogmp_sb3.guidance.reference_data import SPREAD, ReferenceData, collect, reference_data
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.set_points import set_points, span_array, span_row
from ogmp_sb3.guidance.srb import POS, STATE_SIZE, VEL

X, Y, Z = range(POS.start, POS.stop)
PARKOUR = load_task("parkour", {"curriculum": None})
DIVE = load_task("dive")


@pytest.fixture(scope="module")
def courses() -> ReferenceData:
    return reference_data(PARKOUR, 200, np.random.SeedSequence(7))


def drawn(task, references: int, seed: int = 7) -> ReferenceData:
    return reference_data(task, references, np.random.SeedSequence(seed))


def test_robots_ask_from_anywhere_on_a_course_and_at_any_height_and_velocity(courses: ReferenceData) -> None:
    start = courses.state[:, 0]
    begun = start[:, X] == 0.0
    assert begun.sum() == 20  # 300 steps of an episode, 30 between queries
    np.testing.assert_array_equal(np.flatnonzero(begun), np.arange(0, 200, 10))
    np.testing.assert_array_equal(start[begun][:, [Y, VEL.start, VEL.start + 1]], 0.0)
    moving = start[~begun]
    assert moving[:, X].max() > 9.0 and np.median(moving[:, X]) > 4.0
    assert (moving[:, Z] > 0.8).mean() > 0.1  # over blocks of 0.2 m and more
    ends = courses.state[:-1, -1][np.diff(courses.state[:, 0, X]) != 0]
    strayed = (courses.state[1:, 0] - courses.state[:-1, -1])[~begun[1:]]
    assert len(ends) >= len(strayed) == 180
    assert (np.abs(strayed.std(axis=0) - SPREAD) < 0.2 * SPREAD + 1e-12).all()


def test_the_references_are_those_of_the_modes_around_the_robot() -> None:
    ranges = {"modes.leap": None, "modes.pace": None, "modes.jump": {"w": 0.4, "h": 0.3, "v": 1.2, "run_up": 0.45}}
    task = load_task("parkour", {"curriculum": None, **ranges})
    data = drawn(task, 20)
    jump = ModeCall("jump", {"w": 0.4, "h": 0.3, "v": 1.2, "run_up": 0.45}).segment()
    rows = [span_row(span, i * jump.length) for i in range(30) for span in jump.spans]
    # A span ends with the one before it if that goes on further, unless it leads to higher ground.
    spans, x0, steps = span_array(rows)[None].repeat(20, axis=0), data.state[:, 0], data.steps
    points = set_points(spans, np.zeros(20, dtype=bool), x0, steps, task.control_dt, task.gait)
    np.testing.assert_allclose(data.state, make_oracle(task)(points, x0).state, atol=1e-9)
    over_block = (x0[:, X] % jump.length) > 0.45
    assert over_block.any() and set(data.modes) == {"jump"}


def test_modes_are_drawn_as_the_task_says(courses: ReferenceData) -> None:
    assert set(courses.modes) == {"pace", "jump", "leap"}
    for call in courses.calls:
        for key, range_ in PARKOUR.mode_ranges[call.name].items():
            assert range_.low <= call.parameters[key] <= range_.high
    weighted = load_task("parkour", {"curriculum": None, "sampling.weights.leap": 0.0})
    assert set(drawn(weighted, 60).modes) == {"pace", "jump"}


def test_a_curriculum_is_drawn_at_every_level(courses: ReferenceData) -> None:
    heights = [call.parameters["h"] for call in drawn(load_task("parkour"), 200).calls if call.name == "jump"]
    assert min(heights) < 0.12 and max(heights) > 0.25
    assert min(call.parameters["h"] for call in courses.calls if call.name == "jump") >= 0.2


def test_timed_modes_follow_each_other_from_where_the_robot_is() -> None:
    data = drawn(DIVE, 12)
    assert data.modes.tolist() == ["flip", "settle", "settle"] * 4
    for row in range(0, 12, 3):
        flip, h = data.steps[row], float(data.calls[row].parameters["h"])
        expected = np.zeros(STATE_SIZE)
        expected[Z] = h + DIVE.robot_config.nominal_height
        np.testing.assert_array_equal(data.state[row, 0], expected)
        strayed = data.state[row + 1, 0] - data.state[row, flip]
        assert (np.abs(strayed[POS]) < 6 * SPREAD[POS]).all() and (np.abs(strayed[VEL]) < 6 * SPREAD[VEL]).all()
        assert (strayed[np.r_[POS, VEL]] != 0.0).all()


def test_an_episode_goes_on_for_as_long_as_one_of_a_training() -> None:
    data = drawn(replace(PARKOUR, episode_steps=61), 12)
    np.testing.assert_array_equal(np.flatnonzero(data.state[:, 0, X] == 0.0), [0, 3, 6, 9])


def test_a_seed_repeats_and_its_children_share_no_course() -> None:
    np.testing.assert_array_equal(drawn(PARKOUR, 30).state, drawn(PARKOUR, 30).state)
    one, other = (reference_data(PARKOUR, 30, seeds) for seeds in np.random.SeedSequence(7).spawn(2))
    calls = [{tuple(call.parameters.values()) for call in data.calls} for data in (one, other)]
    assert not calls[0] & calls[1]


def test_the_encoder_that_a_task_names_need_not_be_there_yet() -> None:
    assert len(drawn(load_task("parkour", {"encoder": "not_trained_yet"}), 3).steps) == 3


def test_shorter_references_are_padded_with_their_last_state() -> None:
    short, long = np.full((3, STATE_SIZE), 1.0), np.full((5, STATE_SIZE), 2.0)
    short[-1] = 7.0
    data = collect([(short, ModeCall("a", {})), (long, ModeCall("b", {}))])
    assert data.steps.tolist() == [2, 4] and data.modes.tolist() == ["a", "b"]
    assert (data.state[0, 2:] == 7.0).all()
    assert data.mask.tolist() == [[True] * 3 + [False] * 2, [True] * 5]
