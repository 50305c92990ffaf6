"""The recurrent policy and its normaliser."""

from __future__ import annotations

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from sb3_contrib.common.recurrent.type_aliases import RNNStates

from ogmp_sb3.sb3.policy import LayeredLstm, LstmPolicy, Normaliser

NETWORK = {"net_arch": [], "lstm_hidden_size": 16, "n_lstm_layers": 2}


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


def test_layers_in_front_of_an_lstm_are_what_they_say() -> None:
    memory = LayeredLstm(5, (7, 6), hidden_size=4, num_layers=1)
    x, states = th.randn(3, 2, 5), (th.randn(1, 2, 4), th.randn(1, 2, 4))
    first, second = (layer for layer in memory.layers if isinstance(layer, th.nn.Linear))
    units = th.nn.functional.elu(x @ first.weight.T + first.bias)
    units = th.nn.functional.elu(units @ second.weight.T + second.bias)
    expected, (hidden, cell) = memory.lstm(units, states)
    output, (next_hidden, next_cell) = memory(x, states)
    for found, wanted in ((output, expected), (next_hidden, hidden), (next_cell, cell)):
        th.testing.assert_close(found, wanted)


@pytest.mark.parametrize(
    "network",
    [
        NETWORK,
        {**NETWORK, "input_layers": (8,)},
        {**NETWORK, "critic_layers": (12, 6), "enable_critic_lstm": False},
        {**NETWORK, "net_arch": {"pi": [7], "vf": [9]}},
    ],
)
def test_the_weights_of_the_critic_are_those_that_values_depend_on_and_no_action_does(network: dict) -> None:
    th.manual_seed(0)
    box = spaces.Box(-1.0, 1.0, (5,), np.float32)
    policy = LstmPolicy(box, spaces.Box(-1.0, 1.0, (2,), np.float32), lambda _: 1e-3, **network)
    features, states, starts = random_sequences(False)
    memory = RNNStates(states, states)
    values, log_prob, _ = policy.evaluate_actions(features, th.zeros(len(features), 2), memory, starts)
    for loss, weights in ((values.sum(), policy.critic_weights()), (log_prob.sum(), policy.actor_weights())):
        policy.zero_grad()
        loss.backward(retain_graph=True)
        moved = {id(weight) for weight in policy.parameters() if weight.grad is not None}
        assert moved == {id(weight) for weight in weights}
    assert len(policy.critic_weights()) + len(policy.actor_weights()) == len(list(policy.parameters()))
