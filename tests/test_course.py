"""Courses laid ahead of the robots."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.config import load_task
from ogmp_sb3.course import Course


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


def test_in_a_timed_task_the_last_mode_is_the_present_one() -> None:
    course = Course(load_task("dive"), num_envs=1)
    rng = np.random.default_rng(0)
    course.begin(0, rng, 1.0)
    assert course.mode_at(0, 0.3).name == "flip"
    course.extend(0, 0.0, rng, 1.0)
    assert course.mode_at(0, 0.3).name == "settle"
