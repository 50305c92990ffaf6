"""Tracking gains against the equations that define them; the oracles' own are compared with python-control."""

import numpy as np
import pytest

from ogmp_sb3.config.robot import SRB
from ogmp_sb3.guidance.riccati import tracking_gains
from ogmp_sb3.guidance.srb import srb_dynamics

BODY = SRB(mass=14.0, inertia=(0.37, 0.33, 0.13))
ORIENTATIONS = [(0.0, 0.0, 0.0), (0.0, 2.5, 0.0), (0.4, -0.3, 0.9)]  # rad
Q = np.diag([1e-6, 1e-6, 1e-6, 1e-6, 3.0, 11000.0, 1.0, 1.0, 1.0, 10.0, 3.0, 10.0])
R = np.diag([1e-4, 1e-5, 1e-3] * 2 + [1e-4] * 6)


@pytest.fixture(params=ORIENTATIONS, ids=str)
def model(request):
    return srb_dynamics(BODY, 0.03, np.array(request.param))


def test_cost_solves_the_riccati_equation(model):
    A, B, (_, P) = model.A, model.B, tracking_gains(model, Q, R)
    BtPA = B.T @ P @ A
    residual = A.T @ P @ A - BtPA.T @ np.linalg.solve(R + B.T @ P @ B, BtPA) + Q - P
    assert np.abs(residual).max() < 1e-9 * np.abs(P).max()
    np.testing.assert_allclose(P, P.T, rtol=0, atol=1e-9 * np.abs(P).max())
    assert np.linalg.eigvalsh(P).min() > 0


def test_cost_is_what_the_closed_loop_pays_from_any_state_on(model):
    K, P = tracking_gains(model, Q, R)
    x0 = np.array([0.1, -0.2, 0.3, 0.0, 0.5, -0.1, 1.0, -1.0, 0.5, 1.0, -1.0, 0.5])
    x0[[0, 1, 2, 3]] = 0.0  # these have almost no weight: their cost takes for ever to pay
    paid, x = 0.0, x0
    for _ in range(20000):
        u = -K @ x
        paid += x @ Q @ x + u @ R @ u
        x = model.A @ x + model.B @ u
    assert paid == pytest.approx(x0 @ P @ x0, rel=1e-3)


def test_closed_loop_is_stable(model):
    K, _ = tracking_gains(model, Q, R)
    assert np.abs(np.linalg.eigvals(model.A - model.B @ K)).max() < 1


@pytest.mark.parametrize(
    ("state_weights", "input_weights"),
    [(-Q, R), (np.full((12, 12), np.nan), R), (Q, -R)],
    ids=["negative Q", "nan Q", "negative R"],
)
def test_a_bad_weight_is_one_sentence(state_weights, input_weights):
    model = srb_dynamics(BODY, 0.03, np.zeros(3))
    with pytest.raises(ValueError, match="oracle weights") as caught:
        tracking_gains(model, state_weights, input_weights)
    message = str(caught.value)
    assert "\n" not in message and message.endswith(".")
