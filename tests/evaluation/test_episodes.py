"""Episodes of an untrained policy, against the simulation they were played in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from gymnasium import spaces

from ogmp_sb3.config import registry
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.streams import Stream
from ogmp_sb3.evaluation.copies import digest
from ogmp_sb3.evaluation.episodes import play_batch, play_episodes, play_sets
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.evaluation.traces import make_trace
from ogmp_sb3.guidance.srb import POS
from ogmp_sb3.report.plots.traces import plot_traces
from ogmp_sb3.sb3.policy import LstmPolicy, policy_kwargs
from ogmp_sb3.sb3.threads import torch_threads

TASK = replace(load_task("parkour", {"horizon": 5, "bound": {"x": 0.5, "z": 2.0}}).for_evaluation(), episode_steps=18)


@pytest.fixture(scope="module")
def policy() -> LstmPolicy:
    scale = BatchEnv(TASK).observation_scale
    box = spaces.Box(np.float32(-50 * scale), np.float32(50 * scale), dtype=np.float32)
    network = policy_kwargs(scale, lstm_hidden_size=8, n_lstm_layers=1)
    return LstmPolicy(box, spaces.Box(-1.0, 1.0, (10,), np.float32), lambda _: 0.0, **network)


@pytest.fixture(scope="module")
def records(policy: LstmPolicy) -> list[EpisodeRecord]:
    return play_episodes(policy, TASK, 3, seed=4)


class Still:
    """A policy that holds the nominal pose."""

    def predict(self, observation: np.ndarray, *arguments: Any, **named: Any) -> tuple[np.ndarray, None]:
        return np.zeros((len(observation), 10)), None


class Breaking(Still):
    """Breaks the simulation of an environment at one of its control steps."""

    def __init__(self, env: BatchEnv, row: int, step: int) -> None:
        self.env, self.row, self.step = env, row, step

    def predict(self, observation: np.ndarray, *arguments: Any, **named: Any) -> tuple[np.ndarray, None]:
        if self.env.step_count[self.row] == self.step:
            self.env.sim.qvel[self.row] = np.nan
        return super().predict(observation)


@pytest.mark.parametrize("episodes", [1, 3])
def test_sets_that_are_played_together_are_those_that_are_played_alone(
    episodes: int, policy: LstmPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit for bit, in batches that hold parts of sets."""
    slow = {name: {**ranges, "v": Range(0.3, 0.4)} for name, ranges in TASK.mode_ranges.items()}
    pushed = {"mass": {"scale": Range(0.8, 1.2)}, "push": {"every": Range(0.1, 0.1), "speed": Range(0.5, 0.5)}}
    tasks = [TASK, replace(TASK, modes=slow), replace(TASK, randomisation=pushed), TASK]
    alone = [play_episodes(policy, task, episodes, seed=4) for task in tasks]
    monkeypatch.setattr("ogmp_sb3.evaluation.episodes.BATCH", 5)
    together = list(play_sets(policy, tasks, episodes, seed=4))
    assert [list(map(digest, records)) for records in together] == [list(map(digest, records)) for records in alone]
    assert len({digest(record) for records in alone for record in records}) == 3 * episodes
    if episodes > 1:
        assert len({record.steps for records in alone for record in records}) > 1


def test_sets_come_as_soon_as_they_are_played(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ogmp_sb3.evaluation.episodes.BATCH", 4)
    done: list[int] = []
    played = play_sets(Still(), [replace(TASK, episode_steps=5)] * 3, 2, seed=4, progress=done.append)  # type: ignore[arg-type]
    assert (len(next(played)), sum(done)) == (2, 4 * 5)
    assert (len(next(played)), sum(done)) == (2, 4 * 5)
    assert (len(next(played)), sum(done)) == (2, 6 * 5)
    assert list(played) == []


def test_the_steps_of_an_episode_are_done_with_when_it_ends() -> None:
    env = BatchEnv(replace(TASK, terminations={}), 3, seed=4)
    done: list[int] = []
    play_batch(Breaking(env, row=1, step=5), env, None, done.append)  # type: ignore[arg-type]
    assert done == [3] * 5 + [2 + 13] + [2] * 12
    assert sum(done) == 3 * TASK.episode_steps


def test_an_episode_that_goes_to_a_distance_is_done_with_by_its_way_to_there() -> None:
    env = BatchEnv(replace(TASK, terminations={}), 2, seed=4)
    x, done = env.sim.base_qpos, list[int]()

    class Pulled(Still):
        def predict(self, observation: np.ndarray, *arguments: Any, **named: Any) -> tuple[np.ndarray, None]:
            env.sim.qpos[0, x] = 0.25 * (env.step_count[0] + 1)
            return super().predict(observation)

    far, near = play_batch(Pulled(), env, 1.0, done.append)  # type: ignore[arg-type]
    assert (far.termination, near.termination) == ("max_distance", "time_limit")
    assert 3 <= far.steps <= 5
    assert done[0] == pytest.approx(18 * 0.25 + 1, abs=1)  # a quarter of the way, and a step
    assert min(done) >= 0 and sum(done) == 2 * 18


def test_records_hold_nothing_of_what_comes_after_their_ends(records: list[EpisodeRecord]) -> None:
    env = BatchEnv(replace(TASK, terminations={}), 3, seed=4)
    played = play_batch(Breaking(env, row=1, step=0), env, None, lambda _: None)  # type: ignore[arg-type]
    assert [record.steps for record in played] == [18, 0, 18]
    held = played[0].reward.base
    assert held is not None and len(held) == 19 + 1 + 19


def test_a_policy_is_played_with_one_torch_thread() -> None:
    seen: list[int] = []

    class Counting(Still):
        def predict(self, observation: np.ndarray, *arguments: Any, **named: Any) -> tuple[np.ndarray, None]:
            seen.append(th.get_num_threads())
            return super().predict(observation)

    with torch_threads(3):
        play_episodes(Counting(), replace(TASK, episode_steps=2), 1, seed=4)  # type: ignore[arg-type]
        assert th.get_num_threads() == 3
    assert seen == [1, 1]


def test_every_row_of_a_record_has_one_entry_per_step_and_the_start(records: list[EpisodeRecord]) -> None:
    for record in records:
        for name in ("base_pos_w", "reward", "reference_pos_w", "phase", "deviation"):
            assert len(getattr(record, name)) == record.steps + 1
        assert record.track_length == 10.0  # of the test protocol


def test_episodes_are_played_on_other_tracks_than_a_training_has() -> None:
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
    whole, broken = play_batch(Breaking(env, 1, survived), env, None, lambda _: None)  # type: ignore[arg-type]
    assert (whole.steps, whole.termination) == (18, "time_limit")
    assert (broken.steps, broken.termination) == (survived, "unstable")
    assert all(np.isfinite(registry.metrics.get(name)(broken)) for name in registry.metrics.names())
    plot_traces([make_trace(broken, TASK, "broken")], tmp_path / "trace")
    assert (tmp_path / "trace.png").is_file()
