"""The encoder: its data, its training, and that compiled inference is the trained network."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch as th
from scipy.spatial.transform import Rotation

from ogmp_sb3.commands.export.bundle import observation_components
from ogmp_sb3.config.catalogue import PACKAGE as SHIPPED
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.guidance import encoder_training as encoder
from ogmp_sb3.guidance import latent
from ogmp_sb3.guidance.reference_data import reference_data

PARKOUR = load_task("parkour")


def test_features_are_thirteen_with_x_from_the_start() -> None:
    state = np.random.default_rng(0).normal(size=(2, 5, 12))
    features = latent.reference_features(state)
    assert features.shape == (2, 5, 13)
    np.testing.assert_array_equal(features[:, 0, 0], 0.0)
    np.testing.assert_allclose(features[..., 1:3], state[..., 4:6])
    quat = Rotation.from_euler("xyz", state[..., :3].reshape(-1, 3)).as_quat(scalar_first=True).reshape(2, 5, 4)
    np.testing.assert_allclose(np.abs((features[..., 3:7] * quat).sum(-1)), 1.0)


@pytest.mark.parametrize(("task", "size"), [("parkour", 2), ("dive", 2), ("parkour", 5)])
def test_compiled_inference_is_the_trained_network(task: str, size: int, tmp_path) -> None:
    data = reference_data(load_task(task), 12, np.random.SeedSequence(2))
    model = encoder.fit(data, updates=3, seed=1, latent_size=size)
    encoder.save_encoder(model, tmp_path / "mine", {"task": task})
    loaded = latent.load_encoder(str(tmp_path / "mine"))
    features = th.as_tensor(latent.reference_features(data.state), dtype=th.float32)
    with th.no_grad():
        expected = model.encode((features - model.mean) / model.std, th.as_tensor(data.steps)).numpy()
    np.testing.assert_allclose(loaded(data.state, data.steps), expected, atol=1e-5)


def test_padding_behind_a_reference_does_not_change_its_latent(model, data, tmp_path) -> None:
    encoder.save_encoder(model, tmp_path, {})
    loaded = latent.load_encoder(str(tmp_path))
    longer = np.concatenate([data.state, np.full_like(data.state[:, :4], 7.0)], axis=1)
    np.testing.assert_array_equal(loaded(longer, data.steps), loaded(data.state, data.steps))


def test_the_latent_of_a_reference_does_not_depend_on_the_others_beside_it(model, data, tmp_path) -> None:
    encoder.save_encoder(model, tmp_path, {})
    loaded = latent.load_encoder(str(tmp_path))
    one_by_one = [loaded(data.state[i : i + 1], data.steps[i : i + 1])[0] for i in range(len(data.steps))]
    np.testing.assert_array_equal(loaded(data.state, data.steps), one_by_one)


def test_unknown_and_damaged_encoders_are_a_sentence(tmp_path) -> None:
    with pytest.raises(KeyError, match=r"no encoder 'parcour'.*Did you mean 'parkour'"):
        latent.load_encoder("parcour")
    (tmp_path / "encoder.json").write_text(json.dumps({"format": latent.FORMAT}))
    (tmp_path / "encoder.safetensors").write_bytes(b"not tensors")
    with pytest.raises(ValueError, match="not a readable encoder"):
        latent.load_encoder(str(tmp_path))


def test_a_size_that_the_weights_have_not_is_a_sentence(model, tmp_path) -> None:
    encoder.save_encoder(model, tmp_path, {"latent_size": 3})
    with pytest.raises(ValueError, match=r"not a readable encoder \(latent_size is 3, and there are weights for 2\)"):
        latent.load_encoder(str(tmp_path))


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_encoders_of_before_are_of_two_numbers(name: str) -> None:
    loaded = latent.load_encoder(str(SHIPPED / "policies" / name / "encoder"))
    assert "latent_size" not in loaded.info and loaded.size == 2
    assert encoder.load_auto_encoder(str(SHIPPED / "policies" / name / "encoder")) is not None


def test_everything_that_shows_the_latent_follows_its_size(data, tmp_path) -> None:
    encoder.save_encoder(encoder.fit(data, updates=1, seed=0, latent_size=4), tmp_path, {})
    env = BatchEnv(load_task("parkour", {"encoder": str(tmp_path)}), num_envs=2, threads=1)
    usual = BatchEnv(PARKOUR, num_envs=2, threads=1)
    observation = env.reset()
    assert observation.shape[1] == env.observation_size == usual.observation_size + 2
    expected = latent.load_encoder(str(tmp_path))(env.guide.plans.reference, env.guide.plans.period)
    np.testing.assert_array_equal(env.view().latent, expected)
    (place,) = (part["slice"] for part in observation_components(env) if part["name"] == "mode_latent")
    np.testing.assert_allclose(observation[:, slice(*place)], expected, rtol=1e-6)
