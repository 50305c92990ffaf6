"""The speed of the learner, against stock."""

from __future__ import annotations

import pytest
from sb3_contrib import RecurrentPPO as StockRecurrentPPO

from ogmp_sb3.commands.bench import program as bench
from ogmp_sb3.config.load import load_task
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO


def test_learners_are_compared_on_the_same_full_rollouts(monkeypatch: pytest.MonkeyPatch) -> None:
    trained = []
    for kind in (StockRecurrentPPO, RecurrentPPO):
        monkeypatch.setattr(kind, "train", lambda learner: trained.append((type(learner), learner.rollout_buffer.full)))
    numbers = bench.bench_learner(load_task("parkour"), num_envs=2, repeats=2)
    assert trained == [(StockRecurrentPPO, True), (RecurrentPPO, True), (RecurrentPPO, True)] * 2
    assert {"stock_samples_per_second", "exact_samples_per_second", "chunked_samples_per_second"} <= set(numbers)
