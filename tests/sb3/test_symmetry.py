"""A symmetric policy answers mirror images with mirror images, and learns from both sides at once."""

from __future__ import annotations

import numpy as np
import pytest
import torch as th

from ogmp_sb3 import make_env
from ogmp_sb3.env.mirror import Mirror
from ogmp_sb3.sb3.learner import make_model
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.symmetry import SymmetricNoise

SIZES = [((), 2, None), ((24,), 1, None), ((24, 16), 1, None), ((24,), 1, (16, 12))]


@pytest.fixture(scope="module")
def env():
    seen = {"observations.mode_latent.both_sides": True, "critic_observations": {"reference_error": {}}}
    return make_env("parkour", num_envs=4, seed=1, episode_steps=9, **seen)


def trained(env, layers: tuple[int, ...], lstm_layers: int, critic: tuple[int, ...] | None = None) -> RecurrentPPO:
    model = make_model(
        env, symmetry=True, input_layers=list(layers), n_lstm_layers=lstm_layers, lstm_hidden_size=16, n_steps=24,
        batch_size=48, learning_rate=1e-2, critic_layers=critic,
    )  # fmt: skip
    model.learn(4 * 24 * 3)
    return model


def answers(model: RecurrentPPO, seen: np.ndarray, states: tuple[th.Tensor, th.Tensor]):
    """Mean actions, values, and the next memory of the actor.

    :param seen: the observation, and what only the critic sees behind it
    """
    policy, seen = model.policy, th.as_tensor(seen, dtype=th.float32)
    features, starts = policy.extract_features(seen[:, :-12]), th.zeros(len(seen))
    with th.no_grad():
        actor, actor_states = policy._process_sequence(features, states, starts, policy.lstm_actor)
        values, _ = model._values(th.cat([features, seen[:, -12:]], dim=1), states, starts)
        return policy.action_net(actor).numpy(), values.numpy(), actor_states


def random_sight(env, rows: int, seed: int = 0) -> np.ndarray:
    """Random observations, and what only the critic sees behind them."""
    scale = np.concatenate([env.batch.observation_scale, np.ones(12)])
    return scale * np.random.default_rng(seed).normal(size=(rows, len(scale)))


@pytest.mark.parametrize("layers, lstm_layers, critic", SIZES)
def test_a_trained_policy_answers_the_mirror_image_with_the_mirror_image(env, layers, lstm_layers: int, critic) -> None:
    model = trained(env, layers, lstm_layers, critic)
    _, action, sight = model.mirrors
    rng, shape, seen = np.random.default_rng(1), (lstm_layers, 5, 16), random_sight(env, 5)
    states = th.as_tensor(rng.normal(size=shape)).float(), th.as_tensor(rng.normal(size=shape)).float()
    swapped = tuple(th.roll(state, 8, dims=2) for state in states)
    one, other = answers(model, seen, states), answers(model, sight(seen), swapped)
    np.testing.assert_allclose(other[0], action(one[0]), atol=1e-5)
    np.testing.assert_allclose(other[1], one[1], atol=1e-5)
    for state, image in zip(one[2], other[2], strict=True):
        np.testing.assert_allclose(image, th.roll(state, 8, dims=2), atol=1e-5)
    assert np.abs(one[0] - action(one[0])).max() > 1e-3, "the answer itself must not be symmetric"


def test_the_gradient_is_that_of_the_rollout_and_of_its_mirror_image(env) -> None:
    model = trained(env, (24,), 1)
    policy, (observation, action, _) = model.policy, model.mirrors
    rng = np.random.default_rng(1)
    seen = env.batch.observation_scale * rng.normal(size=(6, len(observation.sign)))
    wanted = rng.normal(size=(6, 10))
    rest = th.zeros(1, 6, 16), th.zeros(1, 6, 16)

    def gradients(both: bool) -> list[th.Tensor]:
        policy.zero_grad()
        sides = [(seen, wanted), (observation(seen), action(wanted))][: 2 if both else 1]
        for inputs, outputs in sides:
            features = policy.extract_features(th.as_tensor(inputs).float())
            latent, _ = policy._process_sequence(features, rest, th.zeros(6), policy.lstm_actor)
            loss = ((policy.action_net(latent) - th.as_tensor(outputs).float()) ** 2).mean() / len(sides)
            loss.backward()
        if not both:
            model._symmetry.symmetrise_gradients()
        return [weight.grad.clone() for weight in policy.parameters() if weight.grad is not None]

    for one, other in zip(gradients(both=False), gradients(both=True), strict=True):
        th.testing.assert_close(one, other, atol=1e-6, rtol=1e-4)


def test_the_normaliser_learns_from_both_sides(env) -> None:
    model = trained(env, (), 1)
    normaliser, observation = model.policy.features_extractor, model.mirrors.observation
    for statistics, image in ((normaliser.mean, observation), (normaliser.variance, abs)):
        values = statistics.numpy()
        mirrored = image(values) if image is observation else values[observation.source]
        np.testing.assert_allclose(values, mirrored, atol=1e-5)


def test_an_odd_number_of_units_is_refused(env) -> None:
    with pytest.raises(ValueError, match=r"needs an even number of hidden units; '.*' has 15"):
        make_model(env, symmetry=True, lstm_hidden_size=15)


def test_a_task_without_a_mirror_image_says_how_to_train_without(env) -> None:
    with pytest.raises(
        ValueError, match=r"^tasks/parkour.yaml: observation 'mode_latent' .*; train with ppo.symmetry=f"
    ):
        make_model(make_env("parkour", num_envs=1, **{"observations.mode_latent.both_sides": False}), symmetry=True)


def test_a_saved_symmetric_learner_goes_on_symmetric(env, tmp_path) -> None:
    model = trained(env, (24,), 1)
    model.save(tmp_path / "model.zip")
    again = RecurrentPPO.load(tmp_path / "model.zip", env=env)
    again.learn(4 * 24)
    _, action, sight = again.mirrors
    rest, seen = (th.zeros(1, 5, 16), th.zeros(1, 5, 16)), random_sight(env, 5)
    one, other = answers(again, seen, rest), answers(again, sight(seen), rest)
    np.testing.assert_allclose(other[0], action(one[0]), atol=1e-5)


def test_noise_has_a_smaller_opposite_part_and_the_density_of_a_gaussian_with_that_covariance() -> None:
    """PyTorch's full Gaussian is the truth."""
    mirror = Mirror(np.array([1, 0, 2, 3]), np.array([-1.0, -1.0, 1.0, -1.0]))  # a pair, and two in the middle
    image = np.zeros((4, 4))
    image[np.arange(4), mirror.source] = mirror.sign
    same, opposite = 0.5 * (np.eye(4) + image), 0.5 * (np.eye(4) - image)
    covariance = 0.2**2 * (same + 0.3**2 * opposite)
    mean = th.tensor([[0.1, -0.2, 0.3, 0.4]]).repeat(50_000, 1)
    noise = SymmetricNoise(mirror, 0.3).proba_distribution(mean, th.full((4,), float(np.log(0.2))))
    truth = th.distributions.MultivariateNormal(mean[:1], th.as_tensor(covariance).float())
    th.manual_seed(0)
    sampled = noise.sample()
    np.testing.assert_allclose(np.cov(sampled.T.numpy()), covariance, atol=1e-3)
    th.testing.assert_close(noise.log_prob(sampled), truth.log_prob(sampled), atol=1e-4, rtol=1e-4)
    assert noise.entropy()[0].item() == pytest.approx(truth.entropy().item(), abs=1e-4)
    th.testing.assert_close(noise.mode(), mean)
