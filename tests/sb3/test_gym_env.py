"""One environment of a task, for Gymnasium."""

from __future__ import annotations

import copy
import pickle
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import gymnasium.utils.env_checker
import numpy as np
import pytest
import stable_baselines3.common.env_checker

from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.sb3.gym_env import OgmpEnv

TASKS = sorted(path.stem for path in TASKS_DIR.glob("*.yaml"))


SEED = 3


def overrides(name: str) -> dict[str, Any]:
    """Short episodes, so that a few steps hold ends of every kind; no curriculum, so that rows differ."""
    return {"episode_steps": 12, "curriculum": None, "min_step_reward": None, "rho": 0.2}


@pytest.mark.parametrize("name", TASKS)
def test_gymnasium_s_own_check_passes_without_a_warning(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium.utils.env_checker.check_env(OgmpEnv(name), skip_render_check=True)


def test_gymnasium_s_own_check_of_rendering_passes_without_a_warning(opengl) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium.utils.env_checker.check_env(gymnasium.make("OGMP/Dive-v0").unwrapped)


def test_stable_baselines3_s_own_check_of_rendering_passes_without_a_warning(opengl) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = OgmpEnv("dive", render_mode="rgb_array")
        stable_baselines3.common.env_checker.check_env(env, skip_render_check=False)
        env.close()


def test_gymnasium_knows_every_task_that_ships() -> None:
    registered = {name for name in gymnasium.registry if name.startswith("OGMP/")}
    assert registered == {f"OGMP/{name.title().replace('_', '')}-v0" for name in TASKS}


@pytest.mark.parametrize("name", ["Parkour", "Dive", "Stairs"])
@pytest.mark.parametrize("module", ["", "ogmp_sb3:"])
def test_gymnasium_makes_the_registered_tasks(name: str, module: str) -> None:
    with gymnasium.make(f"{module}OGMP/{name}-v0") as env:
        assert isinstance(env.unwrapped, OgmpEnv)
        assert env.unwrapped.batch.task.name == name.lower()
        observation, info = env.reset(seed=0)
        assert observation in env.observation_space
        assert info == {}
        for _ in range(3):
            observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
            assert observation in env.observation_space
        assert isinstance(reward, float)
        assert isinstance(terminated, bool)
        assert isinstance(truncated, bool)
        assert isinstance(info["deviation"], float)
        assert isinstance(info["termination"], str)


def test_gymnasium_passes_overrides_on() -> None:
    with gymnasium.make("OGMP/Parkour-v0", rho=0.07, oracle="lqr") as env:
        assert env.unwrapped.batch.task.rho == 0.07
        assert env.unwrapped.batch.task.oracle == "lqr"


@pytest.mark.parametrize("name", TASKS)
def test_a_seeded_reset_repeats_the_episode_and_an_unseeded_one_goes_on(name: str) -> None:
    env = OgmpEnv(name, **overrides(name))

    def track(seed: int | None) -> tuple[Any, ...]:
        env.reset(seed=seed)
        return tuple(tuple(call.parameters.values()) for call in env.batch.modes[0])

    first, second = track(SEED), track(None)
    assert first != second
    assert (track(SEED), track(None)) == (first, second)
    assert track(SEED + 1) != first


def test_a_seeded_reset_repeats_the_episode_whatever_came_before() -> None:
    """Also in a task with a curriculum, whose level follows what came before."""
    env = OgmpEnv("parkour", rho=None, min_step_reward=None, episode_steps=4, terminations={"fall": None})
    first, _ = env.reset(seed=SEED)
    modes = list(env.batch.modes[0])
    for _ in range(12):
        env.reset()
        for _ in range(4):
            env.step(np.zeros(10))
    again, _ = env.reset(seed=SEED)
    np.testing.assert_array_equal(again, first)
    assert env.batch.modes[0] == modes


def test_the_time_limit_truncates_and_does_not_terminate() -> None:
    env = OgmpEnv("parkour", rho=None, min_step_reward=None, episode_steps=4, terminations={"fall": None})
    env.reset(seed=0)
    ends = [env.step(np.zeros(10))[2:] for _ in range(4)]
    assert [end[:2] for end in ends] == [(False, False)] * 3 + [(False, True)]
    assert [end[2]["termination"] for end in ends] == ["", "", "", "time_limit"]


COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}


@pytest.mark.parametrize("way", COPIES)
def test_a_copy_of_one_environment_goes_on_bit_for_bit(way: str) -> None:
    env = gymnasium.make("OGMP/Parkour-v0", rho=0.2)
    env.reset(seed=SEED)
    env.action_space.seed(SEED)
    for _ in range(5):
        env.step(env.action_space.sample())
    again = COPIES[way](env)
    for _ in range(3):
        action = env.action_space.sample()
        np.testing.assert_array_equal(again.action_space.sample(), action)
        for expected, found in zip(env.step(action), again.step(action), strict=True):
            np.testing.assert_equal(found, expected)
    np.testing.assert_array_equal(again.reset()[0], env.reset()[0])


def test_unseeded_gymnasium_environments_differ() -> None:
    """Gymnasium: without a seed, one is drawn from the system's entropy."""
    tracks = set()
    for _ in range(3):
        env = OgmpEnv("dive")
        env.reset()
        tracks.add(tuple(env.batch.modes[0][0].parameters.values()))
    assert len(tracks) > 1
