"""Tasks on tracks without end."""

from __future__ import annotations

import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.endless import SLOWEST, endless


def test_a_robot_at_the_slowest_speed_just_gets_there() -> None:
    task = endless(load_task("parkour").for_evaluation(), 50.0)
    assert (task.track.length, task.evaluation.track_length) == (None, None)
    assert task.episode_steps * task.control_dt * SLOWEST == pytest.approx(50.0, abs=task.control_dt * SLOWEST)
    assert "episode_length_fraction" not in task.evaluation.metrics
    assert "distance_m" in task.evaluation.metrics
