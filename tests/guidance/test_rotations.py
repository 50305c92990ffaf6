"""Rotations against scipy's, for one rotation and for batches of any shape."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ogmp_sb3.guidance import rotations

SHAPES = [(), (5,), (3, 4)]


def scipy_of(quat: np.ndarray) -> Rotation:
    return Rotation.from_quat(quat.reshape(-1, 4), scalar_first=True)


def random_quats(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    quats = np.random.default_rng(seed).normal(size=(*shape, 4))
    return quats / np.linalg.norm(quats, axis=-1, keepdims=True)


def random_rpys(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, size=(*shape, 3)) * [np.pi, 0.49 * np.pi, np.pi]


def same_rotation(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether quaternions mean the same rotation: q and -q do."""
    return np.allclose(np.abs(np.sum(a * b, axis=-1)), 1.0, atol=1e-12)


def matrices_of(rpy: np.ndarray) -> np.ndarray:
    """R = Rz(yaw) Ry(pitch) Rx(roll): scipy's intrinsic ZYX, with the angles in the other order."""
    return Rotation.from_euler("ZYX", rpy.reshape(-1, 3)[:, ::-1]).as_matrix().reshape(*rpy.shape[:-1], 3, 3)


@pytest.mark.parametrize("shape", SHAPES)
def test_product_of_quaternions_is_the_rotation_by_the_second_then_the_first(shape):
    a, b = random_quats(shape, 1), random_quats(shape, 2)
    product = rotations.quat_multiply(a, b)
    assert product.shape == (*shape, 4)
    assert same_rotation(product.reshape(-1, 4), (scipy_of(a) * scipy_of(b)).as_quat(scalar_first=True))


def test_product_of_quaternions_broadcasts_one_against_many():
    one, many = random_quats((), 1), random_quats((6,), 2)
    expected = np.stack([rotations.quat_multiply(one, q) for q in many])
    np.testing.assert_array_equal(rotations.quat_multiply(np.broadcast_to(one, many.shape), many), expected)


@pytest.mark.parametrize("shape", SHAPES)
def test_conjugate_undoes_a_rotation(shape):
    q = random_quats(shape)
    identity = rotations.quat_multiply(q, rotations.quat_conjugate(q))
    np.testing.assert_allclose(identity, np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*shape, 4)), atol=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_quaternions_rotate_body_vectors_into_the_world(shape):
    q, v = random_quats(shape), np.random.default_rng(3).normal(size=(*shape, 3))
    expected = scipy_of(q).apply(v.reshape(-1, 3)).reshape(*shape, 3)
    np.testing.assert_allclose(rotations.quat_rotate(q, v), expected, atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
def test_inverse_rotation_takes_world_vectors_into_the_body(shape):
    q, v = random_quats(shape), np.random.default_rng(3).normal(size=(*shape, 3))
    expected = scipy_of(q).apply(v.reshape(-1, 3), inverse=True).reshape(*shape, 3)
    np.testing.assert_allclose(rotations.quat_rotate_inverse(q, v), expected, atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
def test_roll_pitch_yaw_become_the_quaternion_of_rz_ry_rx(shape):
    rpy = random_rpys(shape)
    quat = rotations.rpy_to_quat(rpy)
    np.testing.assert_allclose(np.linalg.norm(quat, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose(scipy_of(quat).as_matrix().reshape(*shape, 3, 3), matrices_of(rpy), atol=1e-13)


def test_roll_pitch_yaw_may_go_on_past_a_full_turn():
    rpy = np.array([[0.0, 2.5 * np.pi, 0.0], [6.3, 0.0, 0.0], [1.0, -4.0, 9.0]])
    matrices = scipy_of(rotations.rpy_to_quat(rpy)).as_matrix()
    np.testing.assert_allclose(matrices, matrices_of(rpy), atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
def test_quaternion_gives_back_the_roll_pitch_yaw_it_was_made_of(shape):
    rpy = random_rpys(shape)
    np.testing.assert_allclose(rotations.quat_to_rpy(rotations.rpy_to_quat(rpy)), rpy, atol=1e-9)
    np.testing.assert_allclose(rotations.quat_to_rpy(-rotations.rpy_to_quat(rpy)), rpy, atol=1e-9)


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2])
def test_quaternion_at_a_pitch_of_ninety_degrees_still_gives_numbers(pitch):
    rpy = rotations.quat_to_rpy(rotations.rpy_to_quat(np.array([0.0, pitch, 0.0])))
    assert np.isfinite(rpy).all()
    assert rpy[1] == pytest.approx(pitch, abs=1e-7)


@pytest.mark.parametrize("shape", SHAPES)
def test_matrices_are_rz_ry_rx(shape):
    rpy = random_rpys(shape)
    np.testing.assert_allclose(rotations.rpy_to_matrix(rpy), matrices_of(rpy), atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
def test_rate_matrix_turns_world_angular_velocity_into_angle_rates(shape):
    rng = np.random.default_rng(4)
    rpy = random_rpys(shape) * 0.9
    omega = rng.normal(size=(*shape, 3))
    h = 1e-6  # s
    turned = []
    for sign in (1, -1):  # world angular velocity turns the body from the left
        step = Rotation.from_rotvec(sign * h * omega.reshape(-1, 3))
        after = step * Rotation.from_matrix(matrices_of(rpy).reshape(-1, 3, 3))
        turned.append(np.atleast_2d(after.as_euler("ZYX"))[:, ::-1])
    difference = (turned[0] - turned[1] + np.pi) % (2 * np.pi) - np.pi
    measured = (difference / (2 * h)).reshape(*shape, 3)
    predicted = np.squeeze(rotations.rpy_rate_matrix(rpy) @ omega[..., None], axis=-1)
    np.testing.assert_allclose(predicted, measured, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2, np.pi / 2 + 0.01, 3 * np.pi / 2])
def test_rate_matrix_stays_bounded_near_a_pitch_of_ninety_degrees(pitch):
    rates = rotations.rpy_rate_matrix(np.array([0.1, pitch, 0.2]), min_cos_pitch=0.1)
    assert np.abs(rates).max() <= 10.0 + 1e-9
    # Past the vertical the sign of cos(pitch) is kept: that is what a flip goes through.
    if abs(np.cos(pitch)) > 1e-6:
        assert np.sign(rates[0, 0]) == np.sign(np.cos(pitch))


def test_wrapped_angles_lie_within_half_a_turn_and_mean_the_same():
    angle = np.linspace(-20.0, 20.0, 401)
    wrapped = rotations.wrap_angle(angle)
    assert (wrapped >= -np.pi).all() and (wrapped < np.pi).all()
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-13)
    assert rotations.wrap_angle(np.pi) == -np.pi


@pytest.mark.parametrize(
    "function", [rotations.quat_rotate, rotations.quat_rotate_inverse, rotations.rpy_to_quat, rotations.rpy_rate_matrix]
)
def test_arguments_are_left_alone(function):
    arguments = [random_quats((4,)), np.ones((4, 3))] if "rotate" in function.__name__ else [random_rpys((4,))]
    before = [a.copy() for a in arguments]
    function(*arguments)
    for argument, copy in zip(arguments, before, strict=True):
        np.testing.assert_array_equal(argument, copy)


@pytest.mark.parametrize("shape", SHAPES)
def test_rotation_vectors_are_scipy_s(shape):
    quats = random_quats(shape)
    expected = scipy_of(quats).as_rotvec().reshape(*shape, 3)
    np.testing.assert_allclose(rotations.quat_to_rotvec(quats), expected, atol=1e-12)
    np.testing.assert_allclose(rotations.quat_to_rotvec(-quats), expected, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-9, 1e-4, np.pi - 1e-9, np.pi])
def test_rotation_vectors_hold_next_to_no_turn_and_to_half_a_turn(angle):
    half = 0.5 * angle
    vector = rotations.quat_to_rotvec(np.array([np.cos(half), 0.0, np.sin(half), 0.0]))
    np.testing.assert_allclose(vector, [0.0, angle, 0.0], rtol=1e-12, atol=0.0)


def test_smallest_angles_mean_the_same_rotation_and_none_are_smaller():
    quats = random_quats((500,))
    rpy = rotations.quat_to_rpy(quats)
    smallest = rotations.smallest_rpy(rpy)
    assert same_rotation(rotations.rpy_to_quat(smallest), quats)
    size = np.linalg.norm(smallest, axis=-1)
    assert (size <= np.linalg.norm(rpy, axis=-1)).all()
    assert (size < np.linalg.norm(rpy, axis=-1)).any()
    upright = np.abs(rpy).max(axis=-1) < 0.5 * np.pi
    np.testing.assert_array_equal(smallest[upright], rpy[upright])


@pytest.mark.parametrize("pitch", [-3.0, -1.7, -1.0, 1.0, 1.7, 3.0])
def test_a_body_that_is_only_pitched_has_only_a_pitch(pitch):
    rpy = rotations.quat_to_rpy(rotations.rpy_to_quat(np.array([0.0, pitch, 0.0])))
    np.testing.assert_allclose(rotations.smallest_rpy(rpy), [0.0, pitch, 0.0], atol=1e-9)
