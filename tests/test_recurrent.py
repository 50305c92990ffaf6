"""RecurrentPPO against sb3-contrib's, which steps through time one by one."""

from __future__ import annotations

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from sb3_contrib.common.recurrent.type_aliases import RNNStates

from ogmp_sb3 import make_env
from ogmp_sb3.recurrent import LstmPolicy, Normaliser, RecurrentPPO

SETTINGS = {"n_steps": 24, "batch_size": 48, "n_epochs": 2, "seed": 3, "device": "cpu"}
NETWORK = {"net_arch": [], "lstm_hidden_size": 16, "n_lstm_layers": 2}


@pytest.fixture(scope="module")
def env():
    return make_env("parkour", num_envs=4, seed=1, episode_steps=9, curriculum=None)


def lstm_policy() -> LstmPolicy:
    th.manual_seed(0)
    box = spaces.Box(-1.0, 1.0, (5,), np.float32)
    return LstmPolicy(box, spaces.Box(-1.0, 1.0, (2,), np.float32), lambda _: 1e-3, **NETWORK)


def random_sequences(starts_inside: bool):
    th.manual_seed(1)
    sequences, length = 6, 11
    features = th.randn(sequences * length, 5)
    states = th.randn(2, sequences, 16), th.randn(2, sequences, 16)
    starts = th.zeros(sequences, length)
    starts[::2, 0] = 1.0
    if starts_inside:
        starts[1, 4] = 1.0
    return features, states, starts.flatten()


@pytest.mark.parametrize("starts_inside", [False, True])
def test_one_lstm_call_equals_stepping_through_time(starts_inside: bool) -> None:
    lstm = lstm_policy().lstm_actor
    arguments = random_sequences(starts_inside)
    ours, our_states = LstmPolicy._process_sequence(*arguments, lstm)
    theirs, their_states = RecurrentActorCriticPolicy._process_sequence(*arguments, lstm)
    th.testing.assert_close(ours, theirs, atol=1e-6, rtol=0)
    th.testing.assert_close(our_states, their_states, atol=1e-6, rtol=0)


def test_gradients_equal_stock_on_a_real_rollout(env) -> None:
    ours = RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=NETWORK, **SETTINGS)
    stock = StockRecurrentPPO("MlpLstmPolicy", env, policy_kwargs=NETWORK, **SETTINGS)
    stock.policy.load_state_dict(ours.policy.state_dict())
    ours.learn(SETTINGS["n_steps"] * env.num_envs)  # fills the buffer
    stock.policy.load_state_dict(ours.policy.state_dict())
    assert ours.rollout_buffer.episode_starts.sum() > 8, "the rollout must hold many episode starts"
    for data in ours.rollout_buffer.get(SETTINGS["batch_size"]):
        gradients = []
        for policy in (ours.policy, stock.policy):
            policy.zero_grad()
            values, log_prob, _ = policy.evaluate_actions(
                data.observations, data.actions, data.lstm_states, data.episode_starts
            )
            mask = data.mask > 1e-8
            ((values.flatten() - data.returns)[mask].pow(2).mean() - log_prob[mask].mean()).backward()
            gradients.append(th.cat([p.grad.flatten() for p in policy.parameters() if p.grad is not None]))
        assert (gradients[0] - gradients[1]).abs().max() < 1e-5


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


def test_saves_loads_and_predicts_like_stock(env, tmp_path) -> None:
    model = RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=NETWORK, **SETTINGS)
    model.save(tmp_path / "model.zip")
    again = RecurrentPPO.load(tmp_path / "model.zip", env=env)
    observation = env.reset()
    first, _ = model.predict(observation, deterministic=True)
    second, _ = again.predict(observation, deterministic=True)
    np.testing.assert_array_equal(first, second)


def normaliser(scale: float) -> Normaliser:
    return Normaliser(spaces.Box(-10.0, 10.0, (3,), np.float32), [scale] * 3)


def test_normaliser_batches_give_the_statistics_of_all_the_data() -> None:
    data = np.random.default_rng(0).normal([1.0, -2.0, 5.0], [1.0, 3.0, 0.5], size=(600, 3)).astype(np.float32)
    module = normaliser(1e-3)
    for batch in np.split(data, [100, 350]):
        module.update(th.as_tensor(batch))
    np.testing.assert_allclose(module.mean, data.mean(axis=0), rtol=1e-4)
    np.testing.assert_allclose(module.variance, data.var(axis=0), rtol=1e-4)


def test_normaliser_never_divides_by_less_than_the_scale() -> None:
    module = normaliser(0.1)
    module.update(th.full((1000, 3), 0.5))
    assert module(th.full((1, 3), 0.8)).tolist() == [[pytest.approx(3.0, rel=1e-4)] * 3]


def test_normaliser_is_updated_between_rollouts_only(env) -> None:
    network = {**NETWORK, "features_extractor_class": Normaliser}
    model = RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=network, **SETTINGS)
    per_rollout = SETTINGS["n_steps"] * env.num_envs
    model.learn(per_rollout)
    assert model.policy.features_extractor.count == 0
    model.learn(per_rollout, reset_num_timesteps=False)
    assert model.policy.features_extractor.count == per_rollout
