"""Hyper-parameters and what follows from them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ogmp_sb3.recipe import default_ppo


def test_the_learning_rate_halves_by_samples() -> None:
    ppo = replace(default_ppo(), learning_rate=3e-4, learning_rate_half_life=2e6)
    assert [ppo.learning_rate_at(n) for n in (0, 2_000_000, 6_000_000)] == pytest.approx([3e-4, 1.5e-4, 3.75e-5])


def test_without_a_half_life_the_learning_rate_is_constant() -> None:
    ppo = replace(default_ppo(), learning_rate_half_life=None)
    assert ppo.learning_rate_at(0) == ppo.learning_rate_at(20_000_000) == ppo.learning_rate


def test_the_half_life_is_a_number_of_samples() -> None:
    with pytest.raises(ValueError, match="'learning_rate_half_life' must be above 0 or null, found 0"):
        replace(default_ppo(), learning_rate_half_life=0)
