"""RecurrentPPO against sb3-contrib's, which steps through time one by one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from sb3_contrib.common.recurrent.type_aliases import RNNStates
from stable_baselines3.common.logger import Logger

from ogmp_sb3 import make_env
from ogmp_sb3.sb3 import recurrent_ppo as recurrent
from ogmp_sb3.sb3 import sequence_buffer as sequences
from ogmp_sb3.sb3.policy import LstmPolicy, Normaliser
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO

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


def rollout(env, **settings) -> RecurrentPPO:
    """A learner with a full rollout and random weights, just before its update."""
    model = RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=NETWORK, **{**SETTINGS, **settings})
    _, callback = model._setup_learn(10**6)
    model.set_logger(Logger(None, []))
    model.collect_rollouts(env, callback, model.rollout_buffer, model.n_steps)
    assert model.rollout_buffer.episode_starts.sum() > 8, "the rollout must hold many episode starts"
    return model


def stock_twin(model: RecurrentPPO, env) -> StockRecurrentPPO:
    """Stock with the same weights and the same rollout."""
    stock = StockRecurrentPPO("MlpLstmPolicy", env, policy_kwargs=NETWORK, **SETTINGS)
    stock.policy.load_state_dict(model.policy.state_dict())
    stock.set_logger(Logger(None, []))
    source, target = model.rollout_buffer, stock.rollout_buffer
    for name in (
        "observations",
        "actions",
        "rewards",
        "returns",
        "episode_starts",
        "values",
        "log_probs",
        "advantages",
    ):
        getattr(target, name)[...] = getattr(source, name)
    for step, states in enumerate(source.states):
        for name, state in zip(
            ("hidden_states_pi", "cell_states_pi", "hidden_states_vf", "cell_states_vf"),
            (*states.pi, *states.vf),
            strict=True,
        ):
            getattr(target, name)[step] = state.numpy()
    target.full, target.pos = True, target.buffer_size
    return stock


def gradients(policy) -> th.Tensor:
    return th.cat([p.grad.flatten() for p in policy.parameters() if p.grad is not None])


@pytest.mark.parametrize("batch_size", [48, 37, 96])
def test_exact_mode_has_the_minibatches_and_gradients_of_stock(env, batch_size: int) -> None:
    model = rollout(env)
    stock = stock_twin(model, env)
    model.rollout_buffer.freeze()
    features = model.policy.extract_features(model.rollout_buffer.flat["observations"]).detach()
    np.random.seed(7)
    ours = list(model.rollout_buffer.minibatches(batch_size))
    np.random.seed(7)
    theirs = list(stock.rollout_buffer.get(batch_size))
    assert len(ours) == len(theirs)
    for mine, data in zip(ours, theirs, strict=True):
        model.policy.zero_grad()
        model._critic_gradients(mine, features)
        model._actor_gradients(mine, features, 0.2)
        stock.policy.zero_grad()
        mask = data.mask > 1e-8
        values, log_prob, entropy = stock.policy.evaluate_actions(
            data.observations, data.actions, data.lstm_states, data.episode_starts
        )
        advantages = (data.advantages - data.advantages[mask].mean()) / (data.advantages[mask].std() + 1e-8)
        ratio = th.exp(log_prob - data.old_log_prob)
        policy_loss = -th.min(advantages * ratio, advantages * th.clamp(ratio, 0.8, 1.2))[mask].mean()
        value_loss = ((data.returns - values.flatten()) ** 2)[mask].mean()
        loss = policy_loss - stock.ent_coef * entropy[mask].mean() + stock.vf_coef * value_loss
        loss.backward()
        assert gradients(stock.policy).abs().max() > 1e-3
        assert (gradients(model.policy) - gradients(stock.policy)).abs().max() < 1e-5


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


@pytest.mark.parametrize("chunk_length", [None, 24, 8, 7])
def test_every_transition_is_used_once_in_an_epoch(env, chunk_length: int | None) -> None:
    model = rollout(env, chunk_length=chunk_length)
    model.rollout_buffer.freeze()
    order = th.cat([batch.order for batch in model.rollout_buffer.minibatches(48)])
    assert sorted(order.tolist()) == list(range(SETTINGS["n_steps"] * env.num_envs))


@pytest.mark.parametrize("chunk_length", [24, 8])
def test_chunks_give_the_log_probabilities_and_values_of_the_rollout(env, chunk_length: int) -> None:
    """Before the first update the network is that of the collection, so that every stored state must fit."""
    model = rollout(env, chunk_length=chunk_length)
    buffer = model.rollout_buffer
    buffer.freeze()
    features = model.policy.extract_features(buffer.flat["observations"])
    for batch in buffer.minibatches(48):
        for lstm, states, head in (
            (model.policy.lstm_actor, buffer.actor_states, lambda x: model.policy._get_action_dist_from_latent(x)),
            (model.policy.lstm_critic, buffer.critic_states, lambda x: model.policy.value_net(x)),
        ):
            output = head(recurrent._lstm_outputs(lstm, batch, features, states))
            if lstm is model.policy.lstm_critic:
                th.testing.assert_close(output.flatten(), buffer.flat["values"][batch.order], atol=1e-5, rtol=0)
            else:
                log_prob = output.log_prob(buffer.flat["actions"][batch.order])
                th.testing.assert_close(log_prob, buffer.flat["log_probs"][batch.order], atol=1e-4, rtol=0)


def test_sequences_are_padded_to_lengths_that_cost_least_together() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        lengths = rng.integers(1, 9, size=rng.integers(1, 12))
        padded = sequences.padded_lengths(lengths)
        assert (padded >= lengths).all()

        def cost(padded: np.ndarray) -> float:
            return sum(t * (sequences.STEP_COST + (padded == t).sum()) for t in np.unique(padded))

        values = np.unique(lengths)
        choices = [
            ends
            for size in range(1, len(values) + 1)
            for ends in itertools.combinations(values, size)
            if ends[-1] == values[-1]
        ]
        best = min(cost(np.array(ends)[np.searchsorted(ends, lengths)]) for ends in choices)
        assert cost(padded) == pytest.approx(best)


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
