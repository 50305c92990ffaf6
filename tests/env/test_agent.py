"""What can be played: models and policies of Stable-Baselines3, with and without memory or normalisation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from sb3_contrib import RecurrentPPO as ContribRecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from helpers.learners import learner
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.agent import Actor, playable
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.evaluation.episodes import play_episodes
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

TASK = load_task("dive", {"evaluation.episode_steps": 10})
SIZE = BatchEnv(TASK).observation_size
SMALL = {"n_steps": 8, "batch_size": 16, "n_epochs": 1, "seed": 0, "device": "cpu"}


def observations(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, SIZE)).astype(np.float32)


def acts(policy: Any, observation: np.ndarray) -> np.ndarray:
    return Actor(policy, len(observation), SIZE).act(observation)


@pytest.mark.parametrize(("kind", "network"), [(PPO, "MlpPolicy"), (ContribRecurrentPPO, "MlpLstmPolicy")])
def test_a_model_of_stable_baselines3_is_played_as_its_predict_acts(kind: Any, network: str) -> None:
    model = kind(network, OgmpVecEnv(TASK, 2, seed=0, threads=1), **SMALL)
    shown = observations(3)
    expected, _ = model.predict(shown, episode_start=np.ones(3, dtype=bool), deterministic=True)
    np.testing.assert_array_equal(acts(model, shown), expected)
    np.testing.assert_array_equal(acts(model.policy, shown), expected)
    (episode,) = play_episodes(model, TASK.for_evaluation(), 1, seed=0)
    assert 0 < episode.steps <= 10


def test_actions_beyond_the_limits_are_clipped_to_them() -> None:
    model = PPO("MlpPolicy", OgmpVecEnv(TASK, 2, seed=0, threads=1), **SMALL)
    model.policy.action_net.weight.data.mul_(1e6)
    assert np.abs(acts(model, observations(3))).max() == 1.0


def test_a_model_that_was_trained_under_vec_normalize_is_shown_normalised_observations() -> None:
    env = VecNormalize(OgmpVecEnv(TASK, 2, seed=0, threads=1))
    model = PPO("MlpPolicy", env, **SMALL)
    model.learn(32)
    before = env.obs_rms.mean.copy()
    shown = observations(3)
    expected, _ = model.predict(env.normalize_obs(shown), deterministic=True)
    np.testing.assert_array_equal(acts(model, shown), expected)
    assert not np.allclose(acts(model.policy, shown), expected)  # a policy alone does not know of it
    play_episodes(model, TASK.for_evaluation(), 1, seed=0)
    np.testing.assert_array_equal(env.obs_rms.mean, before)


def test_a_loaded_policy_is_played_by_its_policy() -> None:
    loaded = load_policy("dive")
    assert playable(loaded, SIZE) is loaded.policy
    assert Player(TASK, loaded).step().reward == Player(TASK, loaded.policy).step().reward


def test_the_memory_of_a_policy_is_forgotten_where_an_episode_begins() -> None:
    model, _ = learner()
    size = model.observation_space.shape[0]
    shown = np.random.default_rng(0).standard_normal((2, size)).astype(np.float32)
    actor = Actor(model, 2, size)
    first, second = actor.act(shown), actor.act(shown)
    assert not np.allclose(first, second)
    actor.restart(np.array([1]))
    third = actor.act(shown)
    np.testing.assert_allclose(third[1], first[1], rtol=1e-5, atol=1e-6)
    assert not np.allclose(third[0], first[0])


def test_a_row_by_itself_acts_bit_for_bit_as_among_others() -> None:
    policy = load_policy("dive")
    shown = np.stack([observations(300, seed) for seed in range(4)])
    many = Actor(policy, 300, SIZE)
    expected = np.stack([many.act(each) for each in shown])
    for size in (1, 2, 3, 10, 299):
        few = Actor(policy, size, SIZE)
        np.testing.assert_array_equal([few.act(each[-size:]) for each in shown], expected[:, -size:])


@pytest.mark.parametrize("shape", [(SIZE + 1,), (2, SIZE), ()])
def test_a_policy_that_observes_something_else_does_not_fit(shape: tuple[int, ...]) -> None:
    other = SimpleNamespace(predict=None, observation_space=spaces.Box(-1.0, 1.0, shape))
    with pytest.raises(ValueError, match=f"the task shows {SIZE} numbers, but the policy observes"):
        playable(other, SIZE)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="the task shows"):
        play_episodes(load_policy("parkour"), TASK.for_evaluation(), 1, seed=0)
    with pytest.raises(ValueError, match="the task shows"):
        Player(TASK, load_policy("parkour"))


@pytest.mark.parametrize("policy", ["parkour", None, SimpleNamespace(policy=3)])
def test_what_does_not_act_is_one_sentence(policy: Any) -> None:
    with pytest.raises(TypeError, match=r"^a model, a policy or what load_policy returns is needed .*, found "):
        playable(policy, SIZE)
