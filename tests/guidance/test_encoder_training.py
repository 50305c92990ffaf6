"""The training of the encoder."""

from __future__ import annotations

import numpy as np
import pytest
import torch as th

from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance import encoder_training as encoder
from ogmp_sb3.guidance import latent

PARKOUR = load_task("parkour")


def test_data_are_balanced_over_modes_and_stay_in_their_ranges(data) -> None:
    names = [call.name for call in data.calls]
    assert {name: names.count(name) for name in names} == {"pace": 30, "jump": 30, "leap": 30}
    for call in data.calls:
        for key, range_ in PARKOUR.mode_ranges[call.name].items():
            assert range_.low <= call.parameters[key] <= range_.high


def test_data_repeat_for_a_seed_and_differ_for_another(data) -> None:
    np.testing.assert_array_equal(encoder.reference_data(PARKOUR, 30, 0).state, data.state)
    assert not np.array_equal(encoder.reference_data(PARKOUR, 30, 1).state, data.state)


def test_training_explains_what_the_mean_does_not(data, model) -> None:
    untrained = encoder.fit(data, updates=1, seed=0)
    assert encoder.reconstruction_error(untrained, data) == pytest.approx(1.0, abs=0.1)
    assert encoder.reconstruction_error(model, data) < 0.6


def test_training_repeats_for_a_seed_and_leaves_the_global_generator_alone(data) -> None:
    th.manual_seed(11)
    before = th.get_rng_state()
    first, second = (encoder.fit(data, updates=5, seed=3).state_dict() for _ in range(2))
    assert th.equal(before, th.get_rng_state())
    assert all(th.equal(first[key], second[key]) for key in first)


def test_nearest_mode_accuracy_counts_right_neighbours() -> None:
    train = np.array([[0.0, 0.0], [1.0, 1.0]])
    test = np.array([[0.1, 0.0], [0.9, 1.0], [0.8, 0.9], [0.2, 0.1]])
    assert encoder.nearest_mode_accuracy(train, ["a", "b"], test, ["a", "b", "a", "a"]) == 0.75


@pytest.mark.parametrize("task", ["parkour", "dive"])
def test_the_shipped_encoder_explains_and_separates_fresh_references(task: str) -> None:
    loaded = latent.load_encoder(task)
    config = load_task(task)
    train, test = (encoder.reference_data(config, per_mode=300, seed=seed) for seed in (101, 102))
    accuracy = encoder.nearest_mode_accuracy(
        loaded(train.state, train.steps),
        [call.name for call in train.calls],
        loaded(test.state, test.steps),
        [call.name for call in test.calls],
    )
    assert accuracy >= 0.95
