"""The paper's reward, term by term, on views made by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.views import make_view
from ogmp_sb3.config import registry
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.rewards import (
    body_contact,
    highest_reward,
    orientation_tracking,
    position_tracking,
    torque_regulation,
)
from ogmp_sb3.env.view import EnvView

TASKS = sorted(path.stem for path in TASKS_DIR.glob("*.yaml"))

AXES = {"x": np.array([[1, 0, 0]]), "y": np.array([[0, 1, 0]]), "z": np.array([[0, 0, 1]])}


def total(task: str, view: EnvView) -> np.ndarray:
    """The reward that a task file declares."""
    terms = {name: given for name, given in load_task(task).rewards.items() if given is not None}
    return np.sum([registry.rewards.get(name)(view, **given) for name, given in terms.items()], axis=0)


def quat(axis: str, angle: float) -> np.ndarray:
    return Rotation.from_rotvec(angle * AXES[axis]).as_quat()[:, [3, 0, 1, 2]]


@pytest.mark.parametrize("task", TASKS)
def test_a_perfect_step_without_torque_is_worth_one(task: str) -> None:
    np.testing.assert_allclose(total(task, make_view()), [1.0, 1.0, 1.0], rtol=1e-12)


@pytest.mark.parametrize("task", TASKS)
def test_the_highest_reward_is_that_of_a_perfect_step(task: str) -> None:
    assert highest_reward(load_task(task).rewards) == pytest.approx(total(task, make_view(1)).item())


def test_the_highest_reward_is_not_known_of_a_term_without_a_weight() -> None:
    assert highest_reward({"position_tracking": {"weight": 2.0}, "body_contact": {"weight": -1.0}, "x": None}) == 2.0
    assert highest_reward({"position_tracking": {"weight": 2.0}, "mine": {"scale": 3.0}}) is None


@pytest.mark.parametrize("task", TASKS)
def test_every_fault_costs_reward_and_a_body_contact_costs_three_tenths(task: str) -> None:
    contact = total(task, make_view(1, body_contact=np.array([True])))
    np.testing.assert_allclose(contact, [0.7])
    moved, tilted = make_view(1), make_view(1, base_quat=quat("y", 0.3))
    moved.reference[:, 5] += 0.2
    tired = make_view(1, torque=np.full((1, 10), 10.0))
    for view in (moved, tilted, tired):
        assert (total(task, view) < 1.0 - 1e-3).all()


@pytest.mark.parametrize("task", TASKS)
def test_the_worst_step_loses_all_but_the_contact_penalty(task: str) -> None:
    view = make_view(1, base_quat=quat("x", np.pi), torque=np.full((1, 10), 1e6), body_contact=np.array([True]))
    view.reference[:, 3] += 100.0
    np.testing.assert_allclose(total(task, view), [0.475 * np.exp(-5.0) - 0.3])


def test_position_tracking_falls_with_the_distance_in_three_dimensions() -> None:
    view = make_view(2)
    view.reference[1, 3:6] += [0.2, -0.3, 0.6]  # 0.7 m
    found = position_tracking(view, weight=2.0, sharpness=5.0)
    np.testing.assert_allclose(found, [2.0, 2.0 * np.exp(-5.0 * 0.7)])


def test_position_tracking_sees_nothing_but_the_position() -> None:
    view = make_view(1)
    view.reference[:, [0, 1, 2, 6, 7, 8, 9, 10, 11]] += 3.0
    np.testing.assert_allclose(position_tracking(view, 1.0, 5.0), [1.0])


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("angle", [0.0, 0.4, -1.2, 3.0, np.pi])
def test_orientation_tracking_falls_with_the_sine_squared_of_half_the_angle(axis: str, angle: float) -> None:
    turned = Rotation.from_euler("zyx", [[0.3, -0.2, 0.5]])
    actual = turned * Rotation.from_rotvec(angle * AXES[axis])
    wxyz = [r.as_quat()[:, [3, 0, 1, 2]] for r in (actual, turned)]
    view = make_view(1, base_quat=wxyz[0], reference_quat=wxyz[1])
    expected = 0.475 * np.exp(-5.0 * np.sin(angle / 2) ** 2)
    np.testing.assert_allclose(orientation_tracking(view, 0.475, 5.0), [expected])


def test_a_quaternion_and_its_negative_are_the_same_orientation() -> None:
    one, other = quat("y", 1.0), quat("y", 1.3)
    found = [orientation_tracking(make_view(1, base_quat=s * one, reference_quat=other), 1.0, 5.0) for s in (1.0, -1.0)]
    np.testing.assert_allclose(*found)


def test_torque_regulation_falls_with_the_norm_over_the_joints() -> None:
    torque = np.zeros((2, 10))
    torque[1, [0, 9]] = [30.0, -40.0]
    found = torque_regulation(make_view(2, torque=torque), weight=0.05, sharpness=0.01)
    np.testing.assert_allclose(found, [0.05, 0.05 * np.exp(-0.5)])


def test_body_contact_is_paid_once_a_step() -> None:
    found = body_contact(make_view(3, body_contact=np.array([True, False, True])), weight=-0.3)
    np.testing.assert_allclose(found, [-0.3, 0.0, -0.3])
