"""Episodes that are chosen by their return and recorded."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from helpers.players import flat
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.evaluation.episodes import play_episodes
from ogmp_sb3.evaluation.recording import choose, oracle_episodes, record_chosen, record_frames
from ogmp_sb3.rendering.player import Player


class Swing:
    """A policy that swings all joints, the more the further the first value that it observes is from zero."""

    def __init__(self, task: TaskConfig) -> None:
        self.observation_space = spaces.Box(-1.0, 1.0, (BatchEnv(task).observation_size,))

    def predict(self, observation: np.ndarray, state: Any, episode_start: np.ndarray, deterministic: bool) -> Any:
        return np.repeat(0.2 * np.sin(20.0 * observation[:, :1]), 10, axis=1), None


@pytest.fixture(scope="module")
def task() -> TaskConfig:
    return flat(**{"evaluation.episode_steps": 60}).for_evaluation()


@pytest.mark.parametrize(
    ("returns", "fell", "chosen"),
    [
        ([3, 5, 1, 4, 2], [], {1: "best", 0: "median", 2: "worst"}),
        ([3, 5, 1, 4, 2], [2, 4], {1: "best", 0: "median", 2: "worst", 4: "a fall"}),
        ([3, 5, 1, 4, 2], [3, 2, 4], {1: "best", 0: "median", 2: "worst", 3: "a fall"}),
        ([3, 5, 1, 4, 2], [2], {1: "best", 0: "median", 2: "worst, a fall"}),
        ([3, 5, 1], [0, 1, 2], {1: "best, a fall", 0: "median", 2: "worst"}),
        ([1, 2], [], {1: "best", 0: "median, worst"}),
        ([7], [], {0: "best, median, worst"}),
    ],
)
def test_best_median_and_worst_are_by_return_and_the_fall_is_the_best_of_those_not_named_yet(
    returns: list[float], fell: list[int], chosen: dict[int, str]
) -> None:
    assert choose(returns, [i in fell for i in range(len(returns))]) == chosen


def test_the_frames_of_a_seed_are_the_test_episode_of_that_seed(task: TaskConfig) -> None:
    policy, seeds = Swing(task), [5, 3, 0, 7]
    played = {seed: play_episodes(policy, task, 1, seed)[0] for seed in seeds}
    assert len({record.steps for record in played.values()}) > 1
    for seed, frames in zip(seeds, record_frames(policy, task, seeds), strict=True):
        record = played[seed]
        assert len(frames) == record.steps + 1
        assert [frame.ended for frame in frames] == ["", *[""] * (record.steps - 1), record.termination]
        np.testing.assert_array_equal([frame.base for frame in frames], record.base_pos_w)
        np.testing.assert_array_equal([frame.robot[3:7] for frame in frames], record.base_quat)
        np.testing.assert_array_equal([frame.velocity for frame in frames], record.base_linvel_w)
        np.testing.assert_array_equal([frame.reward for frame in frames], record.reward)
        np.testing.assert_array_equal([frame.deviation for frame in frames], record.deviation)
        np.testing.assert_array_equal([frame.reference for frame in frames], record.reference_pos_w)


def test_chosen_episodes_say_which_they_are(task: TaskConfig) -> None:
    policy = Swing(task)
    returns = [float(record.reward.sum()) for record in play_episodes(policy, task, 5, 2)]
    order = sorted(range(5), key=lambda i: -returns[i])
    episodes = record_chosen(policy, task, 5, 2)
    named = {name: episode for episode in episodes for name in episode.name.split(", ")}
    for name, number in (("best", order[0]), ("median", order[2]), ("worst", order[-1])):
        assert named[name].detail.startswith(f"seed {2 + number}, return {returns[number]:.1f}, ")
        assert sum(frame.reward for frame in named[name].frames) == pytest.approx(returns[number])
    last = named["worst"].frames[-1]
    way = last.base[0] - named["worst"].frames[0].base[0]
    assert named["worst"].detail.endswith(f"{last.ended} after {last.time:.1f} s and {way:.1f} m")


def test_episodes_that_are_copies_are_one() -> None:
    fixed = flat(**{"modes.pace": {"v": 0.6, "length": 1.0}, "evaluation": {"episode_steps": 20, "initial": None}})
    task = fixed.for_evaluation()
    (episode,) = record_chosen(Swing(task), task, 4, 0)
    assert episode.name == "the episode"


def test_what_an_oracle_showed_is_cut_where_episodes_begin() -> None:
    player = Player(flat(horizon=30, episode_steps=10), None)
    frames = [player.frame, *(player.step() for _ in range(4)), player.reset(), *(player.step() for _ in range(7))]
    first, second = oracle_episodes(frames, seed=4)
    assert (len(first.frames), len(second.frames)) == (5, 8)
    assert second.frames[0].time == 0.0
    assert (first.name, second.name, first.detail) == ("episode 1", "episode 2", "seed 4")
