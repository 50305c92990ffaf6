"""How far states stray from the references of every oracle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ogmp_sb3.config import load_task
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.env import BatchEnv
from ogmp_sb3.epsilon import ShadowedEnv, estimate_epsilon

OPEN = {"curriculum": None, "terminations": {"fall": None}, "rho": None, "min_step_reward": None, "episode_steps": 40}


class Waver:
    """A policy that moves its joints up and down."""

    def __init__(self, task: TaskConfig) -> None:
        self.joints, self.calls = len(task.robot_config.joints), 0

    def predict(self, observation: np.ndarray, state: Any, episode_start: np.ndarray, deterministic: bool) -> Any:
        self.calls += 1
        return np.full((len(observation), self.joints), 0.1 * np.sin(self.calls)), state


@pytest.mark.parametrize("oracle", ["linear", "lqr", "preview"])
def test_the_shadow_of_the_own_oracle_is_the_own_deviation(oracle: str) -> None:
    task = load_task("parkour", {**OPEN, "oracle": oracle})
    plain, shadowed = BatchEnv(task, 3, 5), ShadowedEnv(task, 3, 5)
    assert np.array_equal(plain.reset(), shadowed.reset())
    expected: list[float] = []
    for k in range(40):  # beyond a query
        action = np.full((3, plain.action_size), 0.1 * np.sin(k))
        first, second = plain.step(action), shadowed.step(action)
        assert np.array_equal(first.observation, second.observation)
        expected += first.view.deviation.tolist()
    modes = shadowed.deviations[oracle]
    assert sorted(x for values in modes.values() for x in values) == sorted(expected)
    others = [sum(map(sum, shadowed.deviations[name].values())) for name in task.oracle_params if name != oracle]
    assert all(total != pytest.approx(sum(expected)) for total in others)


def test_the_spread_counts_every_step_once_for_each_oracle_and_mode() -> None:
    task = load_task("parkour", OPEN)
    ended: list[int] = []
    found = estimate_epsilon(Waver(task), task, 4, 0, ended.append)  # type: ignore[arg-type]
    assert sum(ended) == 4
    assert set(found) == {"linear", "lqr", "preview"}
    for modes in found.values():
        assert sum(spread["steps"] for spread in modes.values()) == 4 * 40
        for spread in modes.values():
            assert 0.0 <= spread["median"] <= spread["p95"] <= spread["max"]


def test_in_a_timed_task_modes_are_told_apart_too() -> None:
    task = load_task("dive", {**OPEN, "terminations": {"fall": None}, "episode_steps": 120})
    found = estimate_epsilon(Waver(task), task, 2, 0, lambda _: None)  # type: ignore[arg-type]
    assert set(found["preview"]) == {"flip", "settle"}
