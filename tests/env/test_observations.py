"""Observation terms on views made by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.views import make_view
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.observations import (
    DEEPEST,
    clock,
    commanded_speed,
    heading,
    height_scan,
    imu,
    joints,
    last_action,
    proprioception,
    reference_error,
)
from ogmp_sb3.guidance.terrain import NOTHING, empty_terrain

HEIGHT, QUAT, JOINTS, LINVEL, ANGVEL, RATES = (
    slice(0, 1), slice(1, 5), slice(5, 15), slice(15, 18), slice(18, 21), slice(21, 31),
)  # fmt: skip


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat()[..., [3, 0, 1, 2]]


def test_proprioception_holds_each_signal_at_its_place() -> None:
    rng = np.random.default_rng(0)
    quat = wxyz(Rotation.random(3, random_state=1))
    fields = {
        "base_quat": quat,
        "base_angvel_b": rng.normal(size=(3, 3)),
        "joint_pos": rng.normal(size=(3, 10)),
        "joint_vel": rng.normal(size=(3, 10)),
    }
    signal = proprioception(make_view(**fields))
    assert signal.value.shape == (3, 31)
    assert signal.scale.shape == (31,)
    assert (signal.scale > 0).all()
    for place, name in ((QUAT, "base_quat"), (JOINTS, "joint_pos"), (ANGVEL, "base_angvel_b"), (RATES, "joint_vel")):
        np.testing.assert_array_equal(signal.value[:, place], fields[name])


def test_linear_velocity_is_in_the_body_frame() -> None:
    """R^T v, not the R v of the authors' released code."""
    rotation = Rotation.random(5, random_state=2)
    velocity = np.random.default_rng(3).normal(size=(5, 3))
    view = make_view(5, base_quat=wxyz(rotation), base_linvel_w=velocity)
    expected = np.einsum("nji,nj->ni", rotation.as_matrix(), velocity)
    np.testing.assert_allclose(proprioception(view).value[:, LINVEL], expected, atol=1e-12)


def test_a_robot_that_faces_left_and_moves_left_moves_forward() -> None:
    left = wxyz(Rotation.from_rotvec([[0, 0, np.pi / 2]]))
    view = make_view(1, base_quat=left, base_linvel_w=np.array([[0.0, 2.0, 0.0]]))
    np.testing.assert_allclose(proprioception(view).value[0, LINVEL], [2.0, 0.0, 0.0], atol=1e-12)


def test_height_is_over_the_terrain_under_the_base() -> None:
    position = np.array([[0.0, 0.0, 0.5], [5.0, 0.0, 1.75], [5.0, 0.0, 0.1]])
    view = make_view(base_pos_w=position, ground_height=np.array([0.0, 1.25, -0.5]))
    np.testing.assert_allclose(proprioception(view).value[:, HEIGHT], [[0.5], [0.5], [0.6]])


def test_height_stays_small_where_there_is_no_ground() -> None:
    view = make_view(1, ground_height=np.array([NOTHING]))
    assert 0.6 < proprioception(view).value[0, 0] <= 2.0


def test_the_same_robot_further_along_the_track_feels_the_same() -> None:
    near = make_view(1, base_pos_w=np.array([[0.0, 0.0, 0.5]]))
    far = make_view(1, base_pos_w=np.array([[7000.0, 0.3, 0.75]]), ground_height=np.array([0.25]))
    np.testing.assert_array_equal(proprioception(near).value, proprioception(far).value)


def test_the_clock_turns_once_between_queries() -> None:
    phase = np.arange(0, 31)
    value = clock(make_view(31, phase=phase, period=np.full(31, 30))).value
    angle = np.unwrap(np.arctan2(value[:, 0], value[:, 1]))
    np.testing.assert_allclose(angle, 2 * np.pi * phase / 30, atol=1e-12)
    np.testing.assert_allclose(value[0], [0.0, 1.0])
    np.testing.assert_allclose(value[-1], value[0], atol=1e-12)


def test_the_clock_of_each_row_has_its_own_period() -> None:
    value = clock(make_view(2, phase=np.array([10, 10]), period=np.array([20, 40]))).value
    np.testing.assert_allclose(value, [[0.0, -1.0], [1.0, 0.0]], atol=1e-12)


@pytest.fixture
def terrain() -> np.ndarray:
    """A step up at x = 0.1, down into a gap at 0.2, out of it at 0.3; nothing from 0.4 on."""
    boxes = empty_terrain(1, 5)
    boxes[0, 0] = (-1.0, 0.1, -1.0, 1.0, 0.25)
    boxes[0, 1] = (0.1, 0.2, -1.0, 1.0, 0.5)
    boxes[0, 2] = (0.2, 0.3, -1.0, 1.0, -0.25)
    boxes[0, 3] = (0.3, 0.4, -1.0, 1.0, 0.25)
    return boxes


def test_the_scan_is_relative_to_the_ground_under_the_base(terrain: np.ndarray) -> None:
    view = make_view(1, base_pos_w=np.array([[0.05, 0.0, 3.0]]), terrain=terrain, ground_height=np.array([0.25]))
    value = height_scan(view, points=4, spacing=0.1).value
    np.testing.assert_allclose(value, [[0.0, 0.25, -0.5, 0.0]])
    raised = terrain.copy()
    raised[..., 4] += 10.0
    view = make_view(1, base_pos_w=np.array([[0.05, 0.0, 13.0]]), terrain=raised, ground_height=np.array([10.25]))
    np.testing.assert_allclose(height_scan(view, points=4, spacing=0.1).value, value)


def test_the_scan_starts_under_the_base_and_goes_along_the_track(terrain: np.ndarray) -> None:
    """Along x of the world even if the robot looks to the left (as the released code)."""
    left = wxyz(Rotation.from_rotvec([[0, 0, np.pi / 2]]))
    for quat in (left, np.array([[1.0, 0.0, 0.0, 0.0]])):
        view = make_view(
            1, base_pos_w=np.array([[0.15, 0.0, 1.0]]), base_quat=quat, terrain=terrain, ground_height=np.array([0.5])
        )
        value = height_scan(view, points=3, spacing=0.1).value
        np.testing.assert_allclose(value, [[0.0, -0.75, -0.25]])


def test_the_scan_sees_an_edge_where_it_is(terrain: np.ndarray) -> None:
    view = make_view(1, base_pos_w=np.array([[0.0, 0.0, 1.0]]), terrain=terrain, ground_height=np.array([0.25]))
    value = height_scan(view, points=13, spacing=0.04).value[0]
    ahead = 0.04 * np.arange(13)
    expected = np.select([ahead < 0.1, ahead < 0.2, ahead < 0.3, ahead < 0.4], [0.0, 0.25, -0.5, 0.0], -DEEPEST)
    np.testing.assert_allclose(value, expected)


def test_no_ground_ahead_looks_like_a_pit_of_finite_depth(terrain: np.ndarray) -> None:
    view = make_view(1, base_pos_w=np.array([[0.35, 0.0, 1.0]]), terrain=terrain, ground_height=np.array([0.25]))
    np.testing.assert_allclose(height_scan(view, points=2, spacing=0.1).value, [[0.0, -DEEPEST]])


def test_each_row_scans_its_own_terrain(terrain: np.ndarray) -> None:
    other = terrain.copy()
    other[..., 4] = np.where(other[..., 4] > NOTHING, 0.25, NOTHING)
    view = make_view(
        2,
        base_pos_w=np.tile([0.05, 0.0, 1.0], (2, 1)),
        terrain=np.concatenate([other, terrain]),
        ground_height=np.full(2, 0.25),
    )
    np.testing.assert_allclose(height_scan(view, points=3, spacing=0.1).value, [[0, 0, 0], [0, 0.25, -0.5]])


@pytest.mark.parametrize("term, size", [(lambda v: height_scan(v, 7, 0.04), 7), (clock, 2), (proprioception, 31)])
def test_every_term_gives_a_value_and_a_scale_for_each_component(term: object, size: int) -> None:
    signal = term(make_view(4))  # type: ignore[operator]
    assert signal.value.shape == (4, size)
    assert signal.scale.shape == (size,)
    assert (signal.scale > 0).all()


def test_the_reference_error_is_a_rotation_vector_and_differences_and_nothing_on_the_reference() -> None:
    rng = np.random.default_rng(4)
    reference, turn = (
        rng.normal(size=(3, 12)),
        Rotation.from_rotvec([[0.0, 0.0, 3.0], [0.2, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    )
    base = Rotation.random(3, random_state=5)
    state = reference + 0.1
    state[2] = reference[2]
    view = make_view(3, state=state, reference=reference, reference_quat=wxyz(base), base_quat=wxyz(base * turn))
    error = reference_error(view).value
    np.testing.assert_allclose(error[:, :3], turn.as_rotvec(), atol=1e-9)
    np.testing.assert_allclose(error[:2, 3:], 0.1)
    np.testing.assert_allclose(error[2], 0.0, atol=1e-9)


def test_the_commanded_speed_is_a_number_in_metres_a_second() -> None:
    signal = commanded_speed(make_view(2, commanded_speed=np.array([0.6, 1.8])))
    assert signal.value.tolist() == [[0.6], [1.8]]
    assert [(part.name, part.unit, part.size) for part in signal.parts] == [("commanded_speed", "m/s", 1)]


def test_an_imu_feels_gravity_in_its_own_axes_whatever_the_heading() -> None:
    rolled = wxyz(Rotation.from_euler("xyz", [[np.pi / 2, 0, 0]] * 2))
    turned = wxyz(Rotation.from_euler("z", [[0.0], [1.0]]) * Rotation.from_quat(rolled[:, [1, 2, 3, 0]]))
    rates = np.array([[0.1, 0.2, 0.3], [1.0, 2.0, 3.0]])
    signal = imu(make_view(2, base_quat=turned, base_angvel_b=rates))
    np.testing.assert_allclose(signal.value[:, :3], [[0, -1, 0]] * 2, atol=1e-12)  # left side up: right is down
    np.testing.assert_array_equal(signal.value[:, 3:], rates)
    assert [part.name for part in signal.parts] == ["gravity_b", "base_angvel_b"]


def test_a_heading_is_the_turn_about_the_vertical_whatever_the_tilt() -> None:
    """Beside scipy's: turned by some angle to the left, then pitched and rolled in its own axes."""
    angles = np.array([[0.3, 0.2, -0.1], [-3.0, -0.4, 0.5], [0.0, 0.3, 0.0]])
    signal = heading(make_view(3, base_quat=wxyz(Rotation.from_euler("ZYX", angles))))
    np.testing.assert_allclose(signal.value, angles[:, :1], atol=1e-12)
    assert [(part.name, part.unit, part.measured) for part in signal.parts] == [("heading", "rad", True)]


def test_an_imu_on_a_slope_feels_it() -> None:
    leaning = np.array([[-0.6, 0.0, -0.8]])
    np.testing.assert_allclose(imu(make_view(1, down=leaning)).value[0, :3], leaning[0], atol=1e-12)


def test_encoders_give_positions_then_rates_and_nothing_of_the_base() -> None:
    rng = np.random.default_rng(0)
    position, rate = rng.normal(size=(2, 3, 10))
    signal = joints(make_view(3, joint_pos=position, joint_vel=rate))
    np.testing.assert_array_equal(signal.value, np.concatenate([position, rate], axis=1))
    assert [(part.name, part.size, part.measured) for part in signal.parts] == [
        ("joint_pos", 10, True),
        ("joint_vel", 10, True),
    ]


def test_the_last_action_is_the_one_given_even_if_it_is_late() -> None:
    others = ("proprioception", "clock", "mode_latent", "height_scan")
    keys = {f"observations.{name}": None for name in others} | {"observations.last_action": {}, "curriculum": None}
    env = BatchEnv(load_task("parkour", {**keys, "randomisation.action_delay.delay": 0.04}), 2, 0, threads=1)
    assert not env.reset().any()
    actions = np.linspace(-2.0, 2.0, 20).reshape(2, 10)
    np.testing.assert_allclose(env.step(actions).observation, np.clip(actions, -1.0, 1.0), atol=1e-7)
    assert not env.reset(np.array([0])).any()
    assert last_action(env.view()).value[1].any()
