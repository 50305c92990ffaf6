"""Episodes of an untrained policy, against the simulation they were played in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from ogmp_sb3.config import registry
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.streams import Stream
from ogmp_sb3.evaluation.episodes import play_batch, play_episodes
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.evaluation.traces import make_trace
from ogmp_sb3.guidance.srb import POS
from ogmp_sb3.report.plots.traces import plot_traces
from ogmp_sb3.sb3.policy import LstmPolicy, policy_kwargs

TASK = replace(load_task("parkour", {"horizon": 5, "bound": {"x": 0.5, "z": 2.0}}).for_evaluation(), episode_steps=18)


@pytest.fixture(scope="module")
def records() -> list[EpisodeRecord]:
    scale = BatchEnv(TASK).observation_scale
    box = spaces.Box(np.float32(-50 * scale), np.float32(50 * scale), dtype=np.float32)
    network = policy_kwargs(scale, lstm_hidden_size=8, n_lstm_layers=1)
    policy = LstmPolicy(box, spaces.Box(-1.0, 1.0, (10,), np.float32), lambda _: 0.0, **network)
    return play_episodes(policy, TASK, 3, seed=4)


def test_every_row_of_a_record_has_one_entry_per_step_and_the_start(records: list[EpisodeRecord]) -> None:
    for record in records:
        for name in ("base_pos_w", "reward", "reference_pos_w", "phase", "deviation"):
            assert len(getattr(record, name)) == record.steps + 1
        assert record.track_length == 10.0  # of the test protocol


def test_episodes_are_played_on_other_tracks_than_a_training_has() -> None:
    class Still:
        def predict(self, observation: np.ndarray, *arguments: Any, **named: Any) -> tuple[np.ndarray, None]:
            return np.zeros((len(observation), 10)), None

    def modes(stream: Stream) -> list[Any]:
        env = BatchEnv(TASK, 3, seed=4, stream=stream)
        return [record.modes for record in play_batch(Still(), env, None, lambda _: None)]  # type: ignore[arg-type]

    played = [record.modes for record in play_episodes(Still(), TASK, 3, seed=4)]  # type: ignore[arg-type]
    assert played == modes("test")
    assert played[1:] == [record.modes for record in play_episodes(Still(), TASK, 2, seed=5)]  # type: ignore[arg-type]
    assert not [pair for pair in zip(played, modes("training"), strict=True) if pair[0] == pair[1]]


def test_the_phase_counts_from_each_query_of_the_oracle(records: list[EpisodeRecord]) -> None:
    for record in records:
        steps = np.arange(1, record.steps + 1)
        np.testing.assert_array_equal(record.phase[1:], (steps - 1) % 5 + 1)


def test_the_deviation_is_the_weighted_distance_to_the_reference(records: list[EpisodeRecord]) -> None:
    for record in records:
        error = record.base_pos_w - record.reference_pos_w
        np.testing.assert_allclose(record.deviation, np.hypot(0.5 * error[:, 0], 2.0 * error[:, 2]), atol=1e-12)


def test_the_references_of_a_record_are_those_that_the_policy_followed(records: list[EpisodeRecord]) -> None:
    for record in records:
        begun = np.flatnonzero(record.phase[1:] == 1)
        assert len(record.queries) == len(begun)
        for first, (reference, call) in zip(begun, record.queries, strict=True):
            followed = record.reference_pos_w[first + 1 : first + 6]
            np.testing.assert_array_equal(reference[1 : len(followed) + 1, POS], followed)
            np.testing.assert_allclose(reference[0, POS], record.base_pos_w[first])
            assert call.name == record.modes[0]["mode"]  # they do not get far


@pytest.mark.parametrize("survived", [0, 3])
def test_an_episode_in_which_the_simulation_fails_ends_before_it_and_can_be_drawn(
    survived: int, tmp_path: Path
) -> None:
    env = BatchEnv(replace(TASK, terminations={}), 2, seed=4)

    class Breaking:
        calls = 0

        def predict(self, *_: Any, **__: Any) -> tuple[np.ndarray, None]:
            if self.calls == survived:
                env.sim.qvel[1] = np.nan
            self.calls += 1
            return np.zeros((2, env.action_size)), None

    whole, broken = play_batch(Breaking(), env, None, lambda _: None)  # type: ignore[arg-type]
    assert (whole.steps, whole.termination) == (18, "time_limit")
    assert (broken.steps, broken.termination) == (survived, "unstable")
    assert all(np.isfinite(registry.metrics.get(name)(broken)) for name in registry.metrics.names())
    plot_traces([make_trace(broken, TASK, "broken")], tmp_path / "trace")
    assert (tmp_path / "trace.png").is_file()
