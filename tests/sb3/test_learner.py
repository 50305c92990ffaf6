"""A learner as ogmp-train makes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import sb3_contrib
from stable_baselines3.common.vec_env import VecMonitor

from ogmp_sb3 import RecurrentPPO, make_env, make_model
from ogmp_sb3.sb3.hyperparameters import default_ppo


def test_a_model_has_the_noise_and_the_settings_of_ogmp_train_and_can_be_saved(tmp_path: Path) -> None:
    env = VecMonitor(make_env("parkour", 2))
    model = make_model(env, replace(default_ppo(), n_steps=16, batch_size=32), seed=3)
    assert float(model.policy.log_std.exp().mean()) * 2.0 == pytest.approx(0.13)
    assert not model.policy.log_std.requires_grad
    model.num_timesteps = 6_000_000
    assert model.lr_schedule(0.0) == pytest.approx(1.5e-4)
    model.save(tmp_path / "model.zip")
    again = RecurrentPPO.load(tmp_path / "model.zip", env=env)
    assert again.lr_schedule(0.0) == pytest.approx(1.5e-4)
    assert not again.policy.log_std.requires_grad


@pytest.mark.parametrize("kind", [RecurrentPPO, sb3_contrib.RecurrentPPO])
def test_the_learning_rate_halves_by_samples_or_is_constant(kind) -> None:
    env = make_env("parkour", 2)
    small = replace(default_ppo(), n_steps=16, batch_size=32, learning_rate=3e-4)
    halving = make_model(env, replace(small, learning_rate_half_life=2_000_000), kind=kind)
    constant = make_model(env, replace(small, learning_rate_half_life=None), kind=kind)
    for samples, rate in ((0, 3e-4), (2_000_000, 1.5e-4), (6_000_000, 3.75e-5)):
        halving.num_timesteps = constant.num_timesteps = samples
        assert halving.lr_schedule(0.3) == pytest.approx(rate)
        assert constant.lr_schedule(0.3) == pytest.approx(3e-4)


def test_sb3_contribs_own_learner_gets_the_same_network_and_noise() -> None:
    stock = make_model(make_env("parkour", 2), kind=sb3_contrib.RecurrentPPO)
    ours = make_model(make_env("parkour", 2))
    assert type(stock) is sb3_contrib.RecurrentPPO
    assert stock.policy.state_dict().keys() == ours.policy.state_dict().keys()
    assert (stock.policy.log_std == ours.policy.log_std).all()
    assert stock.lr_schedule(1.0) == ours.lr_schedule(1.0) == 3e-4


def test_hyper_parameters_are_given_by_name_on_top_of_those_of_ogmp_train_or_of_others() -> None:
    env = make_env("parkour", 2)
    model = make_model(env, learning_rate=1e-4, n_steps=16, batch_size=32, lstm_hidden_size=8)
    assert (model.n_steps, model.batch_size, model.lr_schedule(1.0)) == (16, 32, 1e-4)
    assert model.policy.lstm_actor.hidden_size == 8
    assert model.gamma == default_ppo().gamma
    on_top = make_model(env, replace(default_ppo(), gamma=0.9, n_steps=64), batch_size=32, n_steps=16)
    assert (on_top.gamma, on_top.n_steps, on_top.batch_size) == (0.9, 16, 32)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"learning_rat": 1e-4}, KeyError, "'learning_rat' is not a known key .*Did you mean 'learning_rate'"),
        ({"n_steps": 1.5}, TypeError, "'n_steps' must be a whole number, found the number 1.5"),
        ({"gamma": 2.0}, ValueError, "'gamma' must be at most 1, found 2"),
    ],
)
def test_a_mistake_in_a_hyper_parameter_is_a_sentence(given: dict[str, float], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        make_model(make_env("parkour"), **given)
