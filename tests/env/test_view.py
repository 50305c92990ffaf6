"""The deviation from the reference."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.views import make_view
from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.env.view import srb_state
from ogmp_sb3.guidance.srb import RPY, STATE_SIZE, deviation


def one_hot(name: str, value: float) -> np.ndarray:
    """A row with one named component of the state."""
    row = np.zeros((1, STATE_SIZE))
    row[0, STATE_NAMES.index(name)] = value
    return row


def weights(**named: float) -> np.ndarray:
    """The diagonal of W."""
    return np.array([named.get(name, 0.0) for name in STATE_NAMES])


def rotation(states: np.ndarray) -> Rotation:
    """Orientations of states, by another library: body to world."""
    return Rotation.from_euler("ZYX", states[:, RPY][:, ::-1])


def seen(orientation: Rotation) -> np.ndarray:
    """The states of resting bodies, as the simulation gives them: pitch never beyond a quarter turn."""
    quat = np.roll(orientation.as_quat(), 1, axis=1)
    return srb_state(np.hstack([np.zeros((len(quat), 3)), quat]), np.zeros((len(quat), 6)))[0]


def test_a_view_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        make_view().phase = np.ones(3)  # type: ignore[misc]


@pytest.mark.parametrize("name", STATE_NAMES)
def test_a_weight_on_one_component_sees_that_component_alone(name: str) -> None:
    for other in STATE_NAMES:
        state, reference = one_hot(other, 0.75), one_hot(other, 0.5)
        expected = 2.0 * 0.25 if other == name else 0.0
        np.testing.assert_allclose(deviation(state, reference, weights(**{name: 2.0})), [expected], atol=1e-12)


def test_weights_on_x_and_z_give_the_distance_in_that_plane() -> None:
    state = one_hot("x", 10.3) + one_hot("z", 0.9) + one_hot("y", 5.0)
    reference = one_hot("x", 10.0) + one_hot("z", 0.5)
    np.testing.assert_allclose(deviation(state, reference, weights(x=1.0, z=1.0)), [0.5])


def test_the_deviation_is_each_row_s_own() -> None:
    rng = np.random.default_rng(0)
    state, reference = rng.uniform(-1, 1, (2, 5, STATE_SIZE))
    diagonal = rng.uniform(0, 2, STATE_SIZE)
    error = state - reference
    error[:, RPY] = (rotation(reference).inv() * rotation(state)).as_rotvec()
    expected = [np.sqrt(sum((w * e) ** 2 for w, e in zip(diagonal, row, strict=True))) for row in error]
    np.testing.assert_allclose(deviation(state, reference, diagonal), expected)


@pytest.mark.parametrize("name", ["roll", "pitch", "yaw"])
@pytest.mark.parametrize("turns", [-2, -1, 1, 2])
def test_an_angle_is_compared_the_short_way_round(name: str, turns: int) -> None:
    """The reference of a flip goes on past pi; the state's angles do not."""
    state, reference = one_hot(name, 0.1), one_hot(name, 0.3 + 2 * np.pi * turns)
    np.testing.assert_allclose(deviation(state, reference, weights(**{name: 1.0})), [0.2])
    state, reference = one_hot(name, np.pi - 0.1), one_hot(name, -np.pi + 0.1)
    np.testing.assert_allclose(deviation(state, reference, weights(**{name: 1.0})), [0.2])


@pytest.mark.parametrize("name", ["x", "wy", "vz"])
def test_only_angles_wrap_around(name: str) -> None:
    state, reference = one_hot(name, 0.0), one_hot(name, 2 * np.pi)
    np.testing.assert_allclose(deviation(state, reference, weights(**{name: 1.0, "pitch": 1.0})), [2 * np.pi])


def test_the_deviation_writes_into_no_argument() -> None:
    state, reference, diagonal = one_hot("pitch", 3.0), one_hot("pitch", 9.0), weights(pitch=1.0)
    copies = state.copy(), reference.copy(), diagonal.copy()
    deviation(state, reference, diagonal)
    for now, before in zip((state, reference, diagonal), copies, strict=True):
        np.testing.assert_array_equal(now, before)


def test_a_state_that_is_not_finite_has_no_deviation() -> None:
    state = np.concatenate([one_hot("x", np.nan), one_hot("x", 0.5)])
    found = deviation(state, np.zeros((2, STATE_SIZE)), weights(x=1.0))
    assert np.isnan(found[0])
    assert found[1] == 0.5


@pytest.mark.parametrize("name", ["roll", "pitch", "yaw"])
@pytest.mark.parametrize("angle", [-7.0, -3.0, -1.7, 1.5, 1.6, 3.0, np.pi, 4.0, 6.28])
def test_a_body_on_the_plan_of_a_flip_does_not_deviate(name: str, angle: float) -> None:
    reference = one_hot(name, angle)
    state = seen(rotation(reference))
    np.testing.assert_allclose(deviation(state, reference, weights(roll=1.0, pitch=1.0, yaw=1.0)), [0.0], atol=1e-7)


@pytest.mark.parametrize("name", ["roll", "pitch", "yaw"])
def test_each_angle_is_the_error_about_its_axis_of_the_reference_s_body(name: str) -> None:
    """Whatever the orientation of the reference, by scipy: log(R_ref^T R), component by component."""
    rng = np.random.default_rng(1)
    reference = np.zeros((200, STATE_SIZE))
    reference[:, RPY] = rng.uniform(-7.0, 7.0, (200, 3))
    error = rng.normal(size=(200, 3))
    error *= rng.uniform(0.0, 3.14, (200, 1)) / np.linalg.norm(error, axis=1, keepdims=True)
    state = seen(rotation(reference) * Rotation.from_rotvec(error))
    axis = ["roll", "pitch", "yaw"].index(name)
    measured = deviation(state, reference, weights(**{name: 2.0}))
    np.testing.assert_allclose(measured, 2.0 * np.abs(error[:, axis]), atol=1e-6)


def test_all_angles_together_measure_the_angle_between_two_orientations() -> None:
    rng = np.random.default_rng(2)
    a, b = Rotation.random(100, rng=rng), Rotation.random(100, rng=rng)
    measured = deviation(seen(a), seen(b), weights(roll=1.0, pitch=1.0, yaw=1.0))
    np.testing.assert_allclose(measured, (a.inv() * b).magnitude(), atol=1e-6)
