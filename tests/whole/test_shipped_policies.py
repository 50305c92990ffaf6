"""The policies that ship do what their cards say, on a few episodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ogmp_sb3.config.scenes import task_for_test
from ogmp_sb3.evaluation.episodes import play_episodes
from ogmp_sb3.evaluation.metrics import flip_and_land, max_heading_speed_mps, track_displacement
from ogmp_sb3.runs.policies import load_policy


def test_parkour_runs_its_tracks_without_a_fall() -> None:
    loaded = load_policy("parkour")
    task = replace(loaded.task.for_evaluation(), episode_steps=200)
    records = play_episodes(loaded.policy, task, episodes=8, seed=7000)
    assert sum(record.termination == "time_limit" for record in records) >= 7
    assert np.median([track_displacement(record) for record in records]) > 5.0
    assert np.median([max_heading_speed_mps(record) for record in records]) > 1.5


@pytest.mark.parametrize("height", [1.0, 2.0])
@pytest.mark.parametrize("direction", ["front", "back", "left", "right"])
def test_dive_lands_a_flip_in_every_direction_from_every_height(direction: str, height: float) -> None:
    loaded, changes = load_policy("dive"), [f"modes.flip.r={direction}", f"modes.flip.h={height}"]
    task = task_for_test(loaded.task_data, loaded.task_path, changes, None, "test")
    (record,) = play_episodes(loaded.policy, task.for_evaluation(), episodes=1, seed=7000)
    assert flip_and_land(record) == 1.0
