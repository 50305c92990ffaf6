"""Metrics on episodes made by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.records import DIRECTIONS, STEPS, ramp, record, turn
from ogmp_sb3.config import registry
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.metrics import (
    flip_and_land,
    flip_angle,
    highest_objective,
    highest_return,
    limited,
    limits_of,
    track_displacement,
)
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.guidance.modes import FLIP_SPEED, flip

LAST_SECOND = 33  # control steps of 0.03 s


def metric(name: str, record: EpisodeRecord) -> float:
    return float(registry.metrics.get(name)(record))


def spike(row: int, value: list[float]) -> np.ndarray:
    array = np.zeros((STEPS + 1, 3))
    array[row] = value
    return array


# ---- parkour ----


def test_heading_acceleration_is_the_largest_norm_in_g() -> None:
    assert metric("max_heading_acceleration_g", record(base_linacc_w=spike(7, [6.0, -2.0, -9.0]))) == pytest.approx(
        11.0 / 9.81
    )


def test_heading_speed_is_the_largest_along_the_track_and_not_backwards() -> None:
    velocity = spike(7, [1.5, 8.0, 8.0]) + spike(9, [-3.0, 0.0, 0.0])
    assert metric("max_heading_speed_mps", record(base_linvel_w=velocity)) == 1.5


def test_the_froude_number_is_that_of_the_largest_heading_speed() -> None:
    velocity = spike(7, [2.0, 0.0, 0.0])
    assert metric("max_froude", record(base_linvel_w=velocity)) == pytest.approx(4.0 / (9.81 * 0.459))


def test_episode_length_is_the_share_of_the_time_limit() -> None:
    assert metric("episode_length_fraction", record()) == 1.0
    assert metric("episode_length_fraction", record(max_steps=400)) == 150 / 400


@pytest.mark.parametrize("cause, survived", [("time_limit", 1), ("max_distance", 1), ("fall", 0), ("unstable", 0)])
def test_no_fall_is_the_time_limit_or_the_distance_asked_for(cause: str, survived: int) -> None:
    assert metric("no_fall_fraction", record(termination=cause)) == survived


def test_distance_is_the_displacement_along_the_track() -> None:
    position = np.outer(np.linspace(0, 1, STEPS + 1), [4.0, 9.0, 9.0]) + 100.0
    assert metric("distance_m", record(base_pos_w=position)) == pytest.approx(4.0)
    assert track_displacement(record(base_pos_w=position)) == pytest.approx(4.0)


def test_the_true_objective_of_a_track_ends_where_the_track_does_unlike_the_distance() -> None:
    position = np.outer(np.linspace(0, 1, STEPS + 1), [13.6, 0.0, 0.0])
    protocol = load_task("parkour").for_evaluation()
    there = record(base_pos_w=position, track_length=protocol.track.length)
    assert track_displacement(there) == highest_objective(protocol) == 10.0
    assert metric("distance_m", there) == pytest.approx(13.6)
    assert track_displacement(record(base_pos_w=0.5 * position, track_length=10.0)) == pytest.approx(6.8)


def test_the_return_is_the_sum_of_rewards() -> None:
    reward = np.arange(STEPS + 1, dtype=float)
    assert metric("return", record(reward=reward)) == STEPS * (STEPS + 1) / 2
    assert record(reward=reward).steps == STEPS


def test_the_surrogate_objective_sums_the_errors_after_each_step() -> None:
    error = np.full(STEPS + 1, 0.5)
    error[0] = 1e6  # before the first step
    assert metric("surrogate_objective", record(state_error=error)) == pytest.approx(0.5 * STEPS)


# ---- dive ----


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("total", [0.0, 1.0, np.pi, 2 * np.pi, -2 * np.pi, 4 * np.pi])
def test_the_flip_angle_is_the_angle_turned_in_the_sense_of_the_flip(direction: str, total: float) -> None:
    assert flip_angle(turn(direction, ramp(total)), direction) == pytest.approx(total, abs=1e-9)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_flip_angle_has_the_sense_of_the_mode_s_set_points(direction: str) -> None:
    """The mode turns the base at rates about the world's axes and moves it where the head goes."""
    span = flip(direction, 1.0).spans[-1]
    roll_rate, pitch_rate = span.rates[1]
    rotation = Rotation.from_rotvec(np.outer(np.linspace(0, 0.3, 11), [roll_rate, pitch_rate, 0.0]))
    assert flip_angle(rotation.as_quat()[:, [3, 0, 1, 2]], direction) > 0.5
    head = rotation.apply([0.0, 0.0, 1.0])[1]
    np.testing.assert_allclose(head[:2] / np.linalg.norm(head[:2]), np.array(span.velocity) / FLIP_SPEED, atol=1e-12)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_flip_angle_does_not_depend_on_heading_nor_on_the_quaternion_s_sign(direction: str) -> None:
    start = Rotation.from_euler("z", 2.0)
    quat = turn(direction, ramp(2 * np.pi), start)
    quat[::3] *= -1.0
    assert flip_angle(quat, direction) == pytest.approx(2 * np.pi)


@pytest.mark.parametrize(
    "direction, other", [("front", "left"), ("back", "right"), ("left", "back"), ("right", "front")]
)
def test_a_turn_about_the_other_axis_or_the_vertical_is_no_flip(direction: str, other: str) -> None:
    assert flip_angle(turn(other, ramp(2 * np.pi)), direction) == pytest.approx(0.0, abs=1e-9)
    spin = Rotation.from_rotvec(np.outer(ramp(2 * np.pi), [0, 0, 1])).as_quat()[:, [3, 0, 1, 2]]
    assert flip_angle(spin, direction) == pytest.approx(0.0, abs=1e-9)


def test_rocking_to_and_fro_is_no_flip() -> None:
    angle = np.sin(np.linspace(0, 20 * np.pi, STEPS + 1))
    assert flip_angle(turn("front", angle), "front") == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_flip_with_a_landing_succeeds(direction: str) -> None:
    assert flip_and_land(record(direction)) == 1.0
    assert metric("success_rate", record(direction)) == 1.0


@pytest.mark.parametrize("total, success", [(0.0, 0), (2 * np.pi - 0.4, 1), (2 * np.pi + 0.4, 1), (4 * np.pi, 0)])
def test_success_needs_one_full_turn(total: float, success: int) -> None:
    assert flip_and_land(record("front", total)) == success


def test_half_a_flip_and_half_a_roll_end_upright_but_are_no_success() -> None:
    half = np.linspace(0.0, np.pi, 46)
    over = Rotation.from_rotvec(np.outer(half, [0, 1, 0]))
    back_up = over[-1] * Rotation.from_rotvec(np.outer(half, [1, 0, 0]))
    quat = np.concatenate([over.as_quat(), back_up.as_quat(), np.tile(back_up[-1].as_quat(), (STEPS - 91, 1))])
    for direction in DIRECTIONS:
        assert flip_and_land(record(direction, base_quat=quat[:, [3, 0, 1, 2]])) == 0.0


@pytest.mark.parametrize("asked, done", [("front", "left"), ("right", "back"), ("front", "back"), ("left", "right")])
def test_success_needs_the_direction_asked_for(asked: str, done: str) -> None:
    other = record(asked, base_quat=turn(done, ramp(2 * np.pi)))
    assert flip_and_land(other) == 0.0


@pytest.mark.parametrize("row", [0, 40, STEPS])
def test_success_needs_the_base_high_at_every_step(row: int) -> None:
    height = np.full(STEPS + 1, 0.5)
    height[row] = 0.299  # 0.6 nominal heights
    assert flip_and_land(record(height=height)) == 0.0
    height[row] = 0.301
    assert flip_and_land(record(height=height)) == 1.0


@pytest.mark.parametrize("row, success", [(STEPS, 0), (STEPS - LAST_SECOND + 1, 0), (STEPS - LAST_SECOND, 1)])
def test_success_needs_an_upright_base_for_the_last_second(row: int, success: int) -> None:
    """A tilt to the side of 0.6 rad for one step, which adds nothing to the angle turned."""
    quat = turn("front", ramp(2 * np.pi))
    quat[row] = Rotation.from_euler("x", 0.6).as_quat()[[3, 0, 1, 2]]
    assert flip_and_land(record(base_quat=quat)) == success


@pytest.mark.parametrize("tilt, success", [(0.45, 1), (0.55, 0)])
def test_upright_means_within_half_a_radian(tilt: float, success: int) -> None:
    quat = turn("front", ramp(2 * np.pi))
    quat[-LAST_SECOND:] = Rotation.from_euler("x", tilt).as_quat()[[3, 0, 1, 2]]
    assert flip_and_land(record(base_quat=quat)) == success


@pytest.mark.parametrize("cause", ["fall", "unstable"])
def test_success_needs_the_whole_episode(cause: str) -> None:
    assert flip_and_land(record(termination=cause)) == 0.0


def test_metrics_leave_the_record_alone() -> None:
    episode = record(base_quat=-turn("left", ramp(2 * np.pi)))
    before = episode.base_quat.copy()
    for name in set(registry.metrics.names()) - {"speed_error_mps"}:  # which is for tracks
        assert np.isfinite(metric(name, episode))
    np.testing.assert_array_equal(episode.base_quat, before)


# ---- bounds ----


def test_a_metric_is_within_the_limits_that_it_declares() -> None:
    """The interval of its mean is cut off there."""
    assert limits_of(registry.metrics.get("episode_length_fraction")) == (0.0, 1.0)
    assert limits_of(registry.metrics.get("speed_error_mps")) == (0.0, None)
    assert limits_of(registry.metrics.get("distance_m")) == (None, None)  # one may go backwards
    assert limits_of(limited(most=3.0)(lambda record: 2.0)) == (None, 3.0)


def test_the_true_objective_is_measured_against_the_test_track_or_one_dive() -> None:
    assert highest_objective(load_task("parkour")) == 10.0
    assert highest_objective(load_task("parkour", {"evaluation.track_length": 7.0})) == 7.0
    assert highest_objective(load_task("parkour", {"evaluation.track_length": None})) is None
    assert highest_objective(load_task("dive")) == flip_and_land(record())


def test_an_objective_that_does_not_say_what_it_can_reach_has_no_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry.objectives._functions, "hops", lambda record: 3.0)
    assert highest_objective(load_task("parkour", {"objective": "hops"})) is None


@pytest.mark.parametrize(("task", "expected"), [("parkour", 400 * 1.0), ("dive", 150 * 1.0)])
def test_the_highest_return_is_full_reward_at_every_step_of_the_test(task: str, expected: float) -> None:
    assert highest_return(load_task(task)) == pytest.approx(expected)
