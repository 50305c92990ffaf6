"""RecurrentPPO against sb3-contrib's, which steps through time one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch as th
from sb3_contrib.common.recurrent.type_aliases import RNNStates
from stable_baselines3.common.logger import Logger

from helpers.rollouts import NETWORK, SETTINGS, rollout, short_episodes, stock_twin
from ogmp_sb3.sb3.learner import make_model
from ogmp_sb3.sb3.policy import Normaliser
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO


@pytest.fixture(scope="module")
def env():
    return short_episodes()


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("network", [{}, {"enable_critic_lstm": False}])
def test_an_exact_update_ends_with_the_weights_of_stock(env, network: dict[str, Any], threads: int) -> None:
    model = rollout(env, policy_kwargs={**NETWORK, **network})
    assert model._fast
    stock = stock_twin(model, env, **network)
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


def watchful(**changes: Any) -> RecurrentPPO:
    """A learner whose critic has no memory and sees how far the robot is from its reference."""
    env = short_episodes(critic_observations={"reference_error": {}})
    return make_model(env, critic_layers=[12, 8], lstm_hidden_size=16, n_steps=24, batch_size=48, **changes)


def test_a_critic_sees_the_observation_and_what_only_it_sees() -> None:
    model = watchful()
    model.learn(24 * 4)
    buffer, policy = model.rollout_buffer, model.policy
    batch = model.env.get_attr("batch")[0]
    unseen = th.as_tensor(batch.critic_observation())
    assert unseen.shape == (4, 12) and unseen.abs().max() > 0.1
    with th.no_grad():
        features = policy.extract_features(th.as_tensor(model._last_obs))
        expected = policy.value_net(policy.critic(th.cat([features, unseen], dim=1)))
    starts = th.zeros(4)
    seen = th.cat([model._features(model._last_obs), model._critic_observation(model.env)], dim=1)
    values, _ = model._values(seen, model._last_lstm_states.vf, starts)
    th.testing.assert_close(values, expected)
    assert len(buffer.critic_observations) == 24
    stored = buffer.flat["critic_observations"].reshape(4, 24, 12)
    th.testing.assert_close(stored[2, 5], buffer.critic_observations[5][2])


def test_a_critic_that_sees_more_learns_what_another_cannot_know() -> None:
    """Returns that are the error of the position itself: seen, they can be fitted."""
    model = watchful(learning_rate=1e-2, critic_max_grad_norm=0.5)
    losses = []
    for _ in range(12):
        _, callback = model._setup_learn(10**6, reset_num_timesteps=False)
        model.set_logger(Logger(None, []))
        model.collect_rollouts(model.env, callback, model.rollout_buffer, model.n_steps)
        unseen = th.stack(model.rollout_buffer.critic_observations).numpy()
        model.rollout_buffer.returns[:] = unseen[..., 3]
        model.train()
        losses.append(model.logger.name_to_value["train/value_loss"] / unseen[..., 3].var())
    assert losses[-1] < 0.3 * losses[0]


def test_gradients_of_actor_and_critic_are_clipped_apart() -> None:
    model = watchful(max_grad_norm=0.1, critic_max_grad_norm=0.02)
    actor = [*model.policy.lstm_actor.parameters(), *model.policy.action_net.parameters()]
    critic = [*model.policy.critic.parameters(), *model.policy.value_net.parameters()]
    for weight in (*actor, *critic):
        weight.grad = th.ones_like(weight)
    before = sum(weight.numel() for weight in (*actor, *critic)) ** 0.5
    assert model._clip_gradients().item() == pytest.approx(before)
    for weights, norm in ((actor, 0.1), (critic, 0.02)):
        clipped = th.cat([weight.grad.flatten() for weight in weights]).norm().item()
        assert clipped == pytest.approx(norm, rel=1e-4)


def test_the_last_value_of_a_time_out_sees_what_only_the_critic_sees() -> None:
    model = watchful()
    model.learn(24 * 4)
    size = model.observation_space.shape[0]
    rng = np.random.default_rng(0)
    observation, unseen = rng.normal(size=(2, size)).astype(np.float32), rng.normal(size=(2, 12)).astype(np.float32)
    infos = [
        {"terminal_observation": o, "terminal_critic_observation": u, "TimeLimit.truncated": True}
        for o, u in zip(observation, unseen, strict=True)
    ]
    rewards = np.zeros(2, dtype=np.float32)
    model._bootstrap_time_outs(rewards, np.array([True, True]), infos, model._last_lstm_states)
    with th.no_grad():
        seen = th.cat([model.policy.extract_features(th.as_tensor(observation)), th.as_tensor(unseen)], dim=1)
        values = model.policy.value_net(model.policy.critic(seen)).flatten().numpy()
    np.testing.assert_allclose(rewards, model.gamma * values, rtol=1e-5)


def test_a_critic_behind_the_actor_s_lstm_cannot_see_more(env) -> None:
    network = {**NETWORK, "enable_critic_lstm": False, "shared_lstm": True, "critic_inputs": 3}
    with pytest.raises(ValueError, match="'critic_inputs' needs 'critic_layers', or a critic with an LSTM of its own"):
        RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=network, **SETTINGS)


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
