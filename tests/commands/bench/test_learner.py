"""The speed of the learner, against stock."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch as th
from sb3_contrib import RecurrentPPO as StockRecurrentPPO

from ogmp_sb3.commands.bench import learner
from ogmp_sb3.commands.bench import program as bench
from ogmp_sb3.commands.bench.random_env import RandomEnv
from ogmp_sb3.config.load import load_task
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.sb3.hyperparameters import default_ppo
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO


def test_learners_are_compared_on_the_same_full_rollouts(monkeypatch: pytest.MonkeyPatch) -> None:
    trained = []
    for kind in (StockRecurrentPPO, RecurrentPPO):
        monkeypatch.setattr(kind, "train", lambda learner: trained.append((type(learner), learner.rollout_buffer.full)))
    numbers = bench.bench_learner(load_task("parkour"), num_envs=2, repeats=2, recipe=default_ppo())
    assert trained == [(StockRecurrentPPO, True), (RecurrentPPO, True), (RecurrentPPO, True)] * 2
    assert {"stock_samples_per_second", "exact_samples_per_second", "chunked_samples_per_second"} <= set(numbers)


def test_both_learners_have_the_recipe_but_no_early_stop_and_stock_its_own_optimiser() -> None:
    recipe = replace(default_ppo(), n_steps=8, batch_size=16, target_kl=0.05)
    env = RandomEnv(load_task("parkour"), 2, endings=0.1)
    ours, stock = learner.learner(env, recipe), learner.stock_learner(env, recipe)
    for model in (ours, stock):
        assert (model.n_steps, model.batch_size, model.n_epochs) == (8, 16, recipe.n_epochs)
        assert model.target_kl is None and model.gamma == recipe.gamma
        assert model.policy.lstm_actor.hidden_size == recipe.lstm_hidden_size
    assert type(stock) is StockRecurrentPPO and type(stock.policy.optimizer) is th.optim.Adam
    assert not stock.policy.optimizer.defaults["fused"]


def test_a_policy_that_does_not_fit_is_one_sentence() -> None:
    loaded = load_policy("parkour")
    task, policy = loaded.task, loaded.policy
    recipe = replace(default_ppo(), n_steps=8, batch_size=16, lstm_hidden_size=8)
    with pytest.raises(ValueError, match=r"the policy's networks do not fit the recipe and this task \("):
        learner.learner(RandomEnv(task, 2, endings=0.1), recipe, policy)
    blind = replace(task, observations={**task.observations, "height_scan": None})
    with pytest.raises(ValueError, match=r"the task shows \d+ numbers, but the policy observes"):
        learner.learner(RandomEnv(blind, 2, endings=0.1), recipe, policy)
