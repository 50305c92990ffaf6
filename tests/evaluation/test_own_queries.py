"""How much the latent keeps of what a policy asks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.records import record
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation import own_queries as module
from ogmp_sb3.evaluation.evaluate import Evaluation, measure
from ogmp_sb3.evaluation.own_queries import own_queries
from ogmp_sb3.guidance.encoder_training import latent_quality, load_auto_encoder
from ogmp_sb3.guidance.reference_data import Query, collect, reference_data

DIVE = load_task("dive").for_evaluation()


@pytest.fixture(scope="module")
def queries() -> list[Query]:
    data = reference_data(DIVE, 12, np.random.SeedSequence(5))
    return [(s[: n + 1], call) for s, n, call in zip(data.state, data.steps, data.calls, strict=True)]


@pytest.fixture(autouse=True)
def few_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "NEIGHBOURS", 40)


def test_all_queries_of_all_episodes_are_counted(queries: list[Query]) -> None:
    records = [replace(record("left"), queries=tuple(queries[i : i + 4])) for i in (0, 4, 8)]
    found = own_queries(DIVE, records)
    model = load_auto_encoder("dive")
    assert found is not None and model is not None and found.references == 12
    assert found.unexplained == latent_quality(model, collect(queries), collect(queries)).unexplained
    assert found.same_mode == 1.0  # flips and stands are far apart


def test_an_evaluation_says_it_writes_it_and_reads_it_back(queries: list[Query]) -> None:
    evaluation = measure(DIVE, [replace(record("left"), queries=tuple(queries))])
    latent = evaluation.latent
    assert latent is not None
    said = f"Mode latent, 12 references of the policy:\n{latent.unexplained:.1%} of the variance is not explained, and"
    assert said in str(evaluation)
    assert evaluation.as_data()["latent"] == {
        "unexplained": latent.unexplained, "same_mode": latent.same_mode, "references": 12,
    }  # fmt: skip
    assert Evaluation.from_data(evaluation.as_data()) == evaluation


def test_without_a_latent_nothing_is_said(queries: list[Query]) -> None:
    records = [replace(record("left"), queries=tuple(queries))]
    blind = load_task("dive", {"observations.mode_latent": None}).for_evaluation()
    assert own_queries(blind, records) is None
    assert own_queries(DIVE, [record("left")]) is None
    assert "latent" not in measure(blind, records).as_data()
