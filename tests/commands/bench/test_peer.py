"""Our learner against rsl_rl's."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import pytest

from ogmp_sb3.commands.bench import peer
from ogmp_sb3.commands.bench.random_env import RandomEnv
from ogmp_sb3.config.load import load_task
from ogmp_sb3.sb3.hyperparameters import default_ppo

INSTALLED = importlib.util.find_spec("rsl_rl") is not None
RECIPE = replace(default_ppo(), n_steps=8, batch_size=16, n_epochs=3, lstm_hidden_size=4)


@pytest.mark.parametrize(
    ("there", "sentence"),
    [
        ((), "needs rsl_rl, which is not installed: pip install rsl-rl-lib."),
        (("rsl_rl", "tensordict"), "needs rsl_rl 5 or later, found an older one: pip install rsl-rl-lib --upgrade."),
    ],
)
def test_a_missing_package_is_one_sentence(
    there: tuple[str, ...], sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name if name in there else None)
    with pytest.raises(ValueError, match=sentence):
        peer.bench_peer(load_task("parkour"), num_envs=4, repeats=1, recipe=RECIPE)


@pytest.mark.skipif(not INSTALLED, reason="rsl_rl is not installed")
def test_the_peer_has_the_same_networks_samples_epochs_and_minibatches(monkeypatch: pytest.MonkeyPatch) -> None:
    from rsl_rl.storage import RolloutStorage

    env = RandomEnv(load_task("parkour"), 4, endings=0.1)
    theirs = peer.RslRl(env, RECIPE)
    ours = peer.learner(RandomEnv(load_task("parkour"), 4, endings=0.1), RECIPE).policy
    for model, lstm in ((theirs._ppo.actor, ours.lstm_actor), (theirs._ppo.critic, ours.lstm_critic)):
        assert [p.shape for p in model.rnn.rnn.parameters()] == [p.shape for p in lstm.parameters()]
    assert theirs._ppo.actor.mlp.weight.shape == ours.action_net.weight.shape
    assert theirs._ppo.critic.mlp.weight.shape == ours.value_net.weight.shape

    made, batches = [], RolloutStorage.recurrent_mini_batch_generator

    def watched(*arguments: object, **settings: object) -> object:
        for batch in batches(*arguments, **settings):
            made.append(int(batch.masks.sum()))
            yield batch

    monkeypatch.setattr(RolloutStorage, "recurrent_mini_batch_generator", watched)
    theirs.update()()
    assert made == [16, 16] * 3  # samples of each minibatch: 8 steps of 4 environments in halves, three times


@pytest.mark.skipif(not INSTALLED, reason="rsl_rl is not installed")
def test_environments_that_the_peer_cannot_divide_are_refused() -> None:
    with pytest.raises(ValueError, match="'num_envs' must be a multiple of 2, found 5"):
        peer.RslRl(RandomEnv(load_task("parkour"), 5, endings=0.1), RECIPE)
