"""Many environments of a task as one ``VecEnv`` of rsl_rl."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest
import torch as th

import ogmp_sb3
from ogmp_sb3.sb3 import rsl_rl_env
from ogmp_sb3.sb3.rsl_rl_env import RslRlVecEnv

ENVS, STEPS, SEED = 4, 30, 3
SHORT: dict[str, Any] = {"episode_steps": 12, "min_step_reward": None, "rho": 0.2}


@pytest.fixture
def rsl_rl() -> Any:
    return pytest.importorskip("rsl_rl.models", reason="needs the extra 'rsl-rl'")


@pytest.mark.parametrize("task", ["parkour", "parkour_robot"])
def test_rows_are_those_of_the_sb3_environments_in_rsl_rl_s_terms(rsl_rl: Any, task: str) -> None:
    from rsl_rl.env import VecEnv

    ours = RslRlVecEnv(task, num_envs=ENVS, seed=SEED, threads=1, **SHORT)
    sb3 = ogmp_sb3.make_env(task, num_envs=ENVS, seed=SEED, **SHORT)
    assert isinstance(ours, VecEnv)
    joints, steps = sb3.action_space.shape[0], sb3.batch.task.episode_steps
    assert (ours.num_envs, ours.num_actions, ours.max_episode_length) == (ENVS, joints, steps)
    expected, lengths, ends = sb3.reset(), np.zeros(ENVS), 0
    generator = np.random.default_rng(0)
    for _ in range(STEPS):
        seen = ours.get_observations()
        np.testing.assert_array_equal(seen["policy"], expected)
        if task == "parkour_robot":
            np.testing.assert_array_equal(seen["critic"], np.concatenate([expected, sb3.critic_observation], axis=1))
        else:
            assert set(seen.keys()) == {"policy"}
        np.testing.assert_array_equal(ours.episode_length_buf, lengths)
        action = generator.uniform(-1, 1, (ENVS, joints)).astype(np.float32)
        following, rewards, dones, extras = ours.step(th.as_tensor(action))
        expected, wanted, ended, infos = sb3.step(action)
        np.testing.assert_array_equal(following["policy"], expected)
        np.testing.assert_array_equal(seen["policy"].shape, following["policy"].shape)
        np.testing.assert_array_equal(rewards, wanted)
        np.testing.assert_array_equal(dones, ended)
        np.testing.assert_array_equal(extras["time_outs"], [info["TimeLimit.truncated"] for info in infos])
        episodes = [info["episode"] for info in infos if "episode" in info]
        assert ("log" in extras) == bool(episodes)
        if episodes:
            assert extras["log"]["distance"] == pytest.approx(np.mean([episode["distance"] for episode in episodes]))
        lengths = np.where(ended, 0, lengths + 1)
        ends += ended.sum()
    assert ends >= 2 * ENVS


def test_what_was_observed_does_not_change_with_the_next_step(rsl_rl: Any) -> None:
    env = RslRlVecEnv("parkour", num_envs=2, **SHORT)
    first = env.get_observations()
    kept = first["policy"].clone()
    env.step(th.ones(2, env.num_actions))
    th.testing.assert_close(first["policy"], kept, rtol=0, atol=0)


def test_the_first_episodes_may_end_at_different_times(rsl_rl: Any) -> None:
    """As rsl_rl's runner asks for by ``init_at_random_ep_len``."""
    env = RslRlVecEnv("parkour", num_envs=3, **{**SHORT, "rho": None, "terminations": {"fall": None}})
    env.episode_length_buf = th.tensor([11, 0, 10])
    time_outs = [env.step(th.zeros(3, env.num_actions))[3]["time_outs"].tolist() for _ in range(2)]
    assert time_outs == [[True, False, False], [False, False, True]]


@pytest.mark.parametrize("task", ["parkour", "dive_robot"])
def test_rsl_rl_s_runner_trains_and_logs(rsl_rl: Any, task: str, tmp_path: Any, capsys: Any) -> None:
    from rsl_rl.runners import OnPolicyRunner

    env = RslRlVecEnv(task, num_envs=4, threads=1, rho=0.2, episode_steps=12)
    network = {"class_name": "RNNModel", "rnn_hidden_dim": 8, "hidden_dims": [8], "obs_normalization": True}
    actor = {**network, "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 0.1}}
    groups = {"actor": ["policy"], "critic": ["critic" if task == "dive_robot" else "policy"]}
    ppo = {"class_name": "PPO", "num_learning_epochs": 1, "num_mini_batches": 2}
    settings = {"algorithm": ppo, "actor": actor, "critic": network, "obs_groups": groups}
    runner = OnPolicyRunner(env, {**settings, "num_steps_per_env": 16, "save_interval": 10}, str(tmp_path))
    before = [parameter.clone() for parameter in runner.alg.get_policy().parameters()]
    runner.learn(2, init_at_random_ep_len=True)
    assert any(not th.equal(a, b) for a, b in zip(before, runner.alg.get_policy().parameters(), strict=True))
    assert "Mean episode distance" in capsys.readouterr().out
    assert (tmp_path / "model_1.pt").is_file()


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ((), r"the package 'rsl_rl' is missing: pip install \"ogmp_sb3\[rsl-rl\]\"\."),
        (("rsl_rl", "tensordict"), "rsl_rl must be of version 5 or later"),
    ],
)
def test_its_absence_is_told_in_a_sentence(found: tuple[str, ...], message: str, monkeypatch: Any) -> None:
    spec = importlib.util.find_spec("json")
    monkeypatch.setattr(rsl_rl_env.importlib.util, "find_spec", lambda name: spec if name in found else None)
    with pytest.raises(ValueError, match=message):
        RslRlVecEnv("parkour")
