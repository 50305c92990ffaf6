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
