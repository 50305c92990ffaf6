"""A rollout as sequences, against the padded ones of sb3-contrib."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch as th

from helpers.rollouts import SETTINGS, rollout, short_episodes, stock_twin
from ogmp_sb3.sb3 import sequence_buffer as sequences


@pytest.fixture(scope="module")
def env():
    return short_episodes()


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
            output = head(sequences.lstm_outputs(lstm, batch, features, states))
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
