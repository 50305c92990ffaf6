"""The single rigid body against numerical integration of its continuous equations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from ogmp_sb3.config.robot import SRB, STATE_NAMES
from ogmp_sb3.guidance.srb import GRAVITY, OMEGA, POS, RPY, STATE_SIZE, VEL, srb_dynamics

BODY = SRB(mass=14.0, inertia=(0.37, 0.33, 0.13))
DT = 0.03  # s
ORIENTATIONS = [(0.0, 0.0, 0.0), (0.4, -0.3, 0.9), (0.0, 2.5, 0.0), (3.0, 0.0, 0.0)]  # rad, as in flips


def derivative(x: np.ndarray, u: np.ndarray, mean_rpy: tuple[float, ...]) -> np.ndarray:
    """eq:srb, written a second time: m (p'' + g) = sum f, I omega' = sum tau, angle rates at the mean orientation."""
    roll, pitch, yaw = mean_rpy
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    inertia_w = rotation @ np.diag(BODY.inertia) @ rotation.T
    # Angular velocity of the axes that yaw, pitch and roll turn about, as columns; angle rates are its inverse.
    after_yaw = Rotation.from_euler("Z", yaw)
    axes = np.stack([rotation[:, 0], after_yaw.apply([0, 1, 0]), [0, 0, 1]], axis=1)
    force, moment = u[:3] + u[3:6], u[6:9] + u[9:12]
    rate = np.empty(STATE_SIZE)
    rate[RPY] = np.linalg.solve(axes, x[OMEGA])
    rate[POS] = x[VEL]
    rate[OMEGA] = np.linalg.solve(inertia_w, moment)
    rate[VEL] = force / BODY.mass - [0, 0, GRAVITY]
    return rate


def test_slices_cover_the_named_states_in_order():
    names = np.array(STATE_NAMES)
    assert [list(names[s]) for s in (RPY, POS, OMEGA, VEL)] == [
        ["roll", "pitch", "yaw"], ["x", "y", "z"], ["wx", "wy", "wz"], ["vx", "vy", "vz"],
    ]  # fmt: skip


@pytest.mark.parametrize("mean_rpy", ORIENTATIONS)
def test_one_step_equals_the_integral_of_the_continuous_equations(mean_rpy):
    rng = np.random.default_rng(0)
    model = srb_dynamics(BODY, DT, np.array(mean_rpy))
    for _ in range(3):
        x, u = rng.normal(size=STATE_SIZE), rng.normal(scale=50.0, size=12)
        truth = solve_ivp(lambda t, y, u=u: derivative(y, u, mean_rpy), (0, DT), x, rtol=1e-11, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(model.A @ x + model.B @ u + model.d, truth, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("mean_rpy", ORIENTATIONS)
def test_flight_without_input_is_exactly_ballistic(mean_rpy):
    model = srb_dynamics(BODY, DT, np.array(mean_rpy))
    start = np.arange(1.0, 13.0)
    x, steps = start.copy(), 40
    for _ in range(steps):
        x = model.A @ x + model.d
    t = steps * DT
    fall = np.array([0.0, 0.0, -GRAVITY])
    np.testing.assert_allclose(x[POS], start[POS] + t * start[VEL] + 0.5 * t**2 * fall, rtol=1e-13)
    np.testing.assert_allclose(x[VEL], start[VEL] + t * fall, rtol=1e-13)
    np.testing.assert_array_equal(x[OMEGA], start[OMEGA])


def test_two_feet_push_like_one_foot_twice_as_hard():
    model = srb_dynamics(BODY, DT, np.array([0.2, -0.5, 1.0]))
    force, moment, nothing = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), np.zeros(3)
    both = model.B @ np.concatenate([force, force, moment, moment])
    left = model.B @ np.concatenate([2 * force, nothing, 2 * moment, nothing])
    right = model.B @ np.concatenate([nothing, 2 * force, nothing, 2 * moment])
    np.testing.assert_allclose(left, both, rtol=1e-14)
    np.testing.assert_allclose(right, both, rtol=1e-14)


def test_two_half_steps_without_input_equal_one_step():
    whole, half = (srb_dynamics(BODY, dt, np.array([0.2, -0.5, 1.0])) for dt in (DT, DT / 2))
    x = np.arange(1.0, 13.0)
    twice = half.A @ (half.A @ x + half.d) + half.d
    np.testing.assert_allclose(whole.A @ x + whole.d, twice, rtol=1e-13)
