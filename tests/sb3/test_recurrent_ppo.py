"""RecurrentPPO against sb3-contrib's, which steps through time one by one."""

from __future__ import annotations

import numpy as np
import pytest
import torch as th
from sb3_contrib.common.recurrent.type_aliases import RNNStates

from helpers.rollouts import NETWORK, SETTINGS, rollout, short_episodes, stock_twin
from ogmp_sb3.sb3.policy import Normaliser
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO


@pytest.fixture(scope="module")
def env():
    return short_episodes()


@pytest.mark.parametrize("threads", [1, 2])
def test_an_exact_update_ends_with_the_weights_of_stock(env, threads: int) -> None:
    model = rollout(env)
    stock = stock_twin(model, env)
    before = th.get_num_threads()
    th.set_num_threads(threads)
    try:
        for learner in (model, stock):
            np.random.seed(3)
            learner.train()
    finally:
        th.set_num_threads(before)
    for mine, theirs in zip(model.policy.parameters(), stock.policy.parameters(), strict=True):
        th.testing.assert_close(mine, theirs, atol=2e-5, rtol=0)


def test_time_outs_are_bootstrapped_as_stock_does_one_by_one(env) -> None:
    model = RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=NETWORK, **SETTINGS)
    th.manual_seed(5)
    states = RNNStates((th.randn(2, 4, 16), th.randn(2, 4, 16)), (th.randn(2, 4, 16), th.randn(2, 4, 16)))
    size = env.observation_space.shape[0]
    terminal = np.random.default_rng(0).normal(size=(4, size)).astype(np.float32)
    infos = [{"terminal_observation": terminal[i], "TimeLimit.truncated": i != 2} for i in range(4)]
    dones, rewards = np.array([True, False, True, True]), np.arange(4, dtype=np.float32)
    model._bootstrap_time_outs(rewards, dones, infos, states)

    expected = np.arange(4, dtype=np.float32)
    for i in (0, 3):  # row 1 goes on, row 2 really ended
        one = tuple(s[:, i : i + 1].contiguous() for s in states.vf)
        with th.no_grad():
            value = model.policy.predict_values(th.as_tensor(terminal[i : i + 1]), one, th.zeros(1))
        expected[i] += model.gamma * value.item()
    np.testing.assert_allclose(rewards, expected, rtol=1e-5)


@pytest.mark.parametrize("field", ["advantages", "returns"])
def test_an_update_with_a_gradient_that_is_not_finite_is_undone_and_training_goes_on(env, field: str) -> None:
    model = rollout(env)
    model.train()  # so that the optimiser has a state
    weights = [p.clone() for p in model.policy.parameters()]
    moments = [entry["exp_avg"].clone() for entry in model.policy.optimizer.state.values()]
    _, callback = model._setup_learn(10**6, reset_num_timesteps=False)
    model.collect_rollouts(env, callback, model.rollout_buffer, model.n_steps)
    getattr(model.rollout_buffer, field)[-1, -1] = np.nan
    with pytest.warns(UserWarning, match=r"Update at step \d+ undone: a loss or a gradient is not finite"):
        model.train()
    assert all(th.equal(a, b) for a, b in zip(weights, model.policy.parameters(), strict=True))
    now = [entry["exp_avg"] for entry in model.policy.optimizer.state.values()]
    assert all(th.equal(a, b) for a, b in zip(moments, now, strict=True))
    assert model.undone_updates == 1

    model.collect_rollouts(env, callback, model.rollout_buffer, model.n_steps)
    model.train()
    assert model.undone_updates == 1
    assert not any(th.equal(a, b) for a, b in zip(weights[:1], model.policy.parameters(), strict=False))


def test_saves_loads_and_predicts_like_stock(env, tmp_path) -> None:
    model = RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=NETWORK, **SETTINGS)
    model.save(tmp_path / "model.zip")
    again = RecurrentPPO.load(tmp_path / "model.zip", env=env)
    observation = env.reset()
    first, _ = model.predict(observation, deterministic=True)
    second, _ = again.predict(observation, deterministic=True)
    np.testing.assert_array_equal(first, second)


def test_normaliser_is_updated_once_for_every_rollout(env) -> None:
    network = {**NETWORK, "features_extractor_class": Normaliser}
    model = RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=network, **SETTINGS)
    per_rollout = SETTINGS["n_steps"] * env.num_envs
    model.learn(per_rollout)
    assert model.policy.features_extractor.count == per_rollout
    before = model.policy.features_extractor.mean.clone()
    model.learn(per_rollout, reset_num_timesteps=False)
    assert model.policy.features_extractor.count == 2 * per_rollout
    assert not th.equal(before, model.policy.features_extractor.mean)
