"""Hyper-parameters and what follows from them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ogmp_sb3.sb3.hyperparameters import default_ppo


def test_a_critic_has_at_least_one_layer_or_is_like_the_actor() -> None:
    with pytest.raises(ValueError, match="'critic_layers' must name at least one layer, or be null for a critic like"):
        replace(default_ppo(), critic_layers=())
    with pytest.raises(ValueError, match="'critic_max_grad_norm' must be above 0, found 0"):
        replace(default_ppo(), critic_max_grad_norm=0.0)


def test_the_half_life_is_a_number_of_samples() -> None:
    with pytest.raises(ValueError, match="'learning_rate_half_life' must be above 0 or null, found 0"):
        replace(default_ppo(), learning_rate_half_life=0)
