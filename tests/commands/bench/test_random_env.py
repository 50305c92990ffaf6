"""Environments without physics."""

from __future__ import annotations

import numpy as np
import pytest

from ogmp_sb3.commands.bench.random_env import RandomEnv
from ogmp_sb3.config.load import load_task
from ogmp_sb3.sb3.vec_env import OgmpVecEnv


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_shapes_are_those_of_the_task(name: str) -> None:
    task = load_task(name)
    env, real = RandomEnv(task, 3, endings=0.5), OgmpVecEnv(task, 3)
    assert (env.observation_space, env.action_space) == (real.observation_space, real.action_space)
    assert env.reset().shape == real.reset().shape
    step, like = (e.step(np.zeros((3, *e.action_space.shape))) for e in (env, real))
    for value, other in zip(step[:3], like[:3], strict=True):
        assert (value.shape, value.dtype) == (other.shape, other.dtype)


def test_the_given_share_of_the_steps_ends_an_episode_the_same_for_the_same_seed() -> None:
    task = load_task("parkour")
    runs = []
    for _ in range(2):
        env = RandomEnv(task, 500, endings=0.05, seed=1)
        env.reset()
        runs.append([env.step(np.zeros(0))[2] for _ in range(40)])
    assert np.mean(runs[0]) == pytest.approx(0.05, abs=0.006)  # four standard deviations of 20,000 draws
    np.testing.assert_array_equal(*runs)
