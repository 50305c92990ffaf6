"""Commanded and measured speed, on episodes made by hand and on courses as environments lay them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from helpers.records import record
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.registry import metrics
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.evaluation.speed import SpeedRow, speed_rows, stretches
from ogmp_sb3.guidance.course import Course
from ogmp_sb3.guidance.set_points import END, VX

DT = 0.03


def pace(v: float, length: float) -> dict[str, Any]:
    return {"mode": "pace", "v": v, "length": length}


def along(x: np.ndarray, *modes: dict[str, Any], track_length: float | None = None) -> EpisodeRecord:
    """An episode at some places along a track."""
    position = np.outer(x, [1.0, 0.0, 0.0])
    return record(base_pos_w=position, reward=np.zeros(len(x)), modes=modes, track_length=track_length)


def at_speeds(*parts: tuple[float, int]) -> np.ndarray:
    """Places of a robot with some speeds, m/s, each for a number of control steps."""
    return np.concatenate([[0.0], np.cumsum([v * DT for v, steps in parts for _ in range(steps)])])


def error(record: EpisodeRecord) -> float:
    return float(metrics.get("speed_error_mps")(record))


def test_who_keeps_the_pace_of_every_stretch_has_no_error() -> None:
    episode = along(at_speeds((1.0, 20), (0.5, 30)), pace(1.0, 0.6), pace(0.5, 9.0))
    assert [(part.mode, part.commanded, part.steps) for part in stretches(episode)] == [
        ("pace", 1.0, 20), ("pace", 0.5, 30),
    ]  # fmt: skip
    assert error(episode) == pytest.approx(0.0, abs=1e-12)


def test_the_error_is_the_distance_of_each_stretch_weighted_by_its_steps() -> None:
    episode = along(at_speeds((1.2, 20), (0.1, 30)), pace(1.0, 20 * 1.2 * DT), pace(0.5, 9.0))
    first, second = stretches(episode)
    assert (first.measured, second.measured) == (pytest.approx(1.2), pytest.approx(0.1))
    assert error(episode) == pytest.approx((20 * 0.2 + 30 * 0.4) / 50)


def test_going_faster_and_slower_within_every_hop_is_no_error() -> None:
    hops = 0.02 * np.sin(np.arange(67) * 2 * np.pi / 11)
    episode = along(at_speeds((1.0, 66)) + hops, pace(1.0, 9.0))
    assert np.abs(np.diff(episode.base_pos_w[:, 0]) / DT - 1.0).max() > 0.3
    assert error(episode) == pytest.approx(0.0, abs=1e-9)


def test_running_too_fast_for_seconds_does_not_make_up_for_standing() -> None:
    episode = along(at_speeds((0.0, 99), (2.0, 99)), pace(1.0, 9.0))
    assert [(part.steps, part.measured) for part in stretches(episode)] == [
        *3 * [(33, 0.0)], *3 * [(33, pytest.approx(2.0))],
    ]  # fmt: skip
    assert error(episode) == pytest.approx(1.0)
    (row,) = speed_rows([episode])
    assert (row.measured.mean, row.error.mean) == (pytest.approx(1.0), pytest.approx(1.0))


def test_successive_modes_at_one_speed_are_one_stretch() -> None:
    episode = along(at_speeds((0.8, 30)), *[pace(1.0, 0.2)] * 5)
    (stretch,) = stretches(episode)
    assert (stretch.steps, stretch.measured, error(episode)) == (30, pytest.approx(0.8), pytest.approx(0.2))


def test_the_set_points_of_a_jump_go_on_behind_its_block() -> None:
    jump = {"mode": "jump", "w": 0.4, "h": 0.2, "v": 1.2, "run_up": 0.3}
    episode = along(np.linspace(0.0, 1.2, 241), jump, pace(0.6, 9.0))
    parts = stretches(episode)
    assert list(dict.fromkeys((part.mode, part.commanded) for part in parts)) == [("jump", 1.2), ("pace", 0.6)]
    jumping = sum(part.steps for part in parts if part.mode == "jump")
    assert jumping == pytest.approx(180, abs=1)  # 0.3 m + 0.4 m + 0.2 m of 1.2 m


def test_what_lies_behind_the_end_of_the_track_does_not_count() -> None:
    episode = along(at_speeds((1.0, 50), (0.0, 50)), pace(1.0, 9.0), track_length=1.5 - 1e-6)
    assert sum(part.steps for part in stretches(episode)) == 50
    assert error(episode) == pytest.approx(0.0, abs=1e-9)
    assert error(along(at_speeds((1.0, 50), (0.0, 50)), pace(1.0, 9.0))) == pytest.approx(0.5)


def test_a_robot_that_goes_backwards_is_slower_than_one_that_stands() -> None:
    assert error(along(at_speeds((-0.5, 50)), pace(1.0, 9.0))) == pytest.approx(1.5)


def test_an_episode_without_a_step_has_not_moved_and_timed_modes_command_no_speed() -> None:
    assert error(along(np.zeros(1), pace(0.7, 9.0))) == 0.7
    assert stretches(record()) == [] == speed_rows([record()])
    with pytest.raises(ValueError, match="metric 'speed_error_mps' is for modes along a track"):
        error(record())


def test_the_command_is_that_of_the_set_points_that_environments_lay() -> None:
    course, rng = Course(load_task("parkour", {"curriculum": None}), 1), np.random.default_rng(3)
    course.begin(0, rng, 1.0)
    places, commanded = np.linspace(0.0, 12.0, 401), []
    for x in places[:-1]:
        if len(course.short_of_track(np.array([0]), np.array([x]))):
            course.extend(0, float(x), rng, 1.0)
        spans = course.spans[0]
        commanded.append(spans[np.flatnonzero(spans[:, END] > x)[0], VX])
    modes = tuple({"mode": call.name, **call.parameters} for call in course.modes[0])
    found = [part.commanded for part in stretches(along(places, *modes)) for _ in range(part.steps)]
    np.testing.assert_array_equal(found, commanded)
    assert len(set(commanded)) > 4


def test_rows_are_of_modes_and_of_bands_of_the_speeds_that_a_mode_commands() -> None:
    jump = {"mode": "jump", "w": 0.4, "h": 0.2, "v": 1.2, "run_up": 9.0}
    episodes = [
        along(at_speeds((0.9, 50)), pace(0.6, 9.0)),
        along(at_speeds((0.9, 50)), pace(0.7, 9.0)),
        along(at_speeds((1.3, 50)), pace(1.8, 9.0)),
        along(at_speeds((1.2, 50)), jump),
    ]
    jumps, paces, slow, fast = speed_rows(episodes)
    assert [(row.mode, row.band) for row in (jumps, paces, slow, fast)] == [
        ("jump", None), ("pace", None), ("pace", (0.6, 0.8)), ("pace", (1.8, 2.0)),
    ]  # fmt: skip
    assert [row.error.n for row in (jumps, paces, slow, fast)] == [1, 3, 2, 1]
    assert (slow.commanded.mean, slow.measured.mean) == (pytest.approx(0.65), pytest.approx(0.9))
    assert paces.error.mean == pytest.approx((0.3 + 0.2 + 0.5) / 3)
    assert paces.error.low >= 0.0
    for row in (paces, fast):
        assert SpeedRow.from_data(row.as_data()) == row
