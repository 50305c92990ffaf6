"""The training of the encoder, and how much of references it keeps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch as th
from safetensors.torch import load_file, save_file

from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance import encoder_training as encoder
from ogmp_sb3.guidance.latent import load_encoder, reference_features
from ogmp_sb3.guidance.reference_data import reference_data
from ogmp_sb3.guidance.sampling import ModeCall


def test_training_explains_what_the_mean_does_not(data, model) -> None:
    untrained = encoder.fit(data, updates=1, seed=0)
    assert encoder.latent_quality(untrained, data, data).unexplained == pytest.approx(1.0, abs=0.1)
    assert encoder.latent_quality(model, data, data).unexplained < 0.85


def test_training_repeats_for_a_seed_and_leaves_the_global_generator_alone(data) -> None:
    th.manual_seed(11)
    before = th.get_rng_state()
    first, second = (encoder.fit(data, updates=3, seed=3).state_dict() for _ in range(2))
    assert th.equal(before, th.get_rng_state())
    assert all(th.equal(first[key], second[key]) for key in first)


def test_what_is_not_explained_is_the_error_over_the_variance_of_the_knots_that_are_meant(model) -> None:
    data = reference_data(load_task("dive"), 6, np.random.SeedSequence(1))
    assert len(set(data.steps)) > 1
    original, decoded = [], []
    for state, steps in zip(data.state, data.steps, strict=True):
        features = reference_features(state[None, : steps + 1])
        with th.no_grad():
            x = (th.as_tensor(features, dtype=th.float32) - model.mean) / model.std
            back = model.decode(model.encode(x, th.tensor([steps])), steps + 1) * model.std + model.mean
        original.append(features[0])
        decoded.append(back[0].numpy())
    knots, error = np.concatenate(original), np.concatenate(original) - np.concatenate(decoded)
    expected = (error**2).sum() / ((knots - knots.mean(axis=0)) ** 2).sum()
    quality = encoder.latent_quality(model, data, data)
    assert quality.unexplained == pytest.approx(expected, rel=1e-4)
    assert quality.references == 6


def test_the_nearest_latent_tells_the_mode(data, model) -> None:
    part = replace(data, state=data.state[:20], steps=data.steps[:20], calls=data.calls[:20])
    assert encoder.latent_quality(model, data, part).same_mode == 1.0  # the nearest is the reference itself
    other = {"pace": "jump", "jump": "leap", "leap": "pace"}
    calls = [call if i < 5 else ModeCall(other[call.name], {}) for i, call in enumerate(part.calls)]
    assert encoder.latent_quality(model, data, replace(part, calls=calls)).same_mode == 0.25


def test_references_in_many_chunks_give_what_they_give_at_once(data, model, monkeypatch: pytest.MonkeyPatch) -> None:
    at_once = encoder.latent_quality(model, data, data)
    monkeypatch.setattr(encoder, "CHUNK", 7)
    in_chunks = encoder.latent_quality(model, data, data)
    assert in_chunks.unexplained == pytest.approx(at_once.unexplained, rel=1e-5)


@pytest.mark.parametrize("size", [2, 3])
def test_a_saved_auto_encoder_is_loaded_whole_with_its_size(size: int, data, tmp_path) -> None:
    model = encoder.fit(data, updates=1, seed=0, latent_size=size)
    encoder.save_encoder(model, tmp_path, {})
    loaded = encoder.load_auto_encoder(str(tmp_path))
    assert loaded is not None
    assert all(th.equal(value, loaded.state_dict()[key]) for key, value in model.state_dict().items())
    assert load_encoder(str(tmp_path)).size == load_encoder(str(tmp_path)).info["latent_size"] == size


def test_an_encoder_may_come_without_its_decoder(data, model, tmp_path) -> None:
    encoder.save_encoder(model, tmp_path, {})
    file = tmp_path / "encoder.safetensors"
    kept = {key: value for key, value in load_file(file).items() if not key.startswith(("decoder", "head"))}
    save_file(kept, file)
    assert encoder.load_auto_encoder(str(tmp_path)) is None
    assert load_encoder(str(tmp_path)).size == 2


@pytest.mark.parametrize(("task", "unexplained", "same_mode"), [("parkour", 0.4, 0.6), ("dive", 0.05, 0.99)])
def test_the_shipped_encoder_explains_references_of_courses_it_never_saw(
    task: str, unexplained: float, same_mode: float
) -> None:
    model = encoder.load_auto_encoder(task)
    assert model is not None
    config = replace(load_task(task), curriculum=None)
    known, test = (reference_data(config, 300, seeds) for seeds in np.random.SeedSequence(101).spawn(2))
    quality = encoder.latent_quality(model, known, test)
    assert quality.unexplained < unexplained and quality.same_mode > same_mode
