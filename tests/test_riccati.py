"""Tracking gains against python-control and the equations that define them."""

import control
import numpy as np
import pytest

from ogmp_sb3.riccati import tracking_gains
from ogmp_sb3.srb import SRB, srb_dynamics

BODY = SRB(mass=14.0, inertia=(0.37, 0.33, 0.13))
ORIENTATIONS = [(0.0, 0.0, 0.0), (0.0, 2.5, 0.0), (0.4, -0.3, 0.9)]  # rad
Q = np.diag([1e-6, 1e-6, 1e-6, 1e-6, 3.0, 11000.0, 1.0, 1.0, 1.0, 10.0, 3.0, 10.0])
R = np.diag([1e-4, 1e-5, 1e-3] * 2 + [1e-4] * 6)


@pytest.fixture(params=ORIENTATIONS, ids=str)
def model(request):
    return srb_dynamics(BODY, 0.03, np.array(request.param))


def test_feedback_equals_the_gain_of_control_dlqr(model):
    K, P, _ = control.dlqr(model.A, model.B, Q, R, method="scipy")
    gains = tracking_gains(model, Q, R)
    np.testing.assert_allclose(gains.K, K, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(gains.P, P, rtol=1e-12, atol=1e-12)


def test_cost_solves_the_riccati_equation(model):
    A, B, P = model.A, model.B, tracking_gains(model, Q, R).P
    BtPA = B.T @ P @ A
    residual = A.T @ P @ A - BtPA.T @ np.linalg.solve(R + B.T @ P @ B, BtPA) + Q - P
    assert np.abs(residual).max() < 1e-9 * np.abs(P).max()
    np.testing.assert_allclose(P, P.T, rtol=0, atol=1e-9 * np.abs(P).max())
    assert np.linalg.eigvalsh(P).min() > 0


def test_cost_is_what_the_closed_loop_pays_from_any_state_on(model):
    gains = tracking_gains(model, Q, R)
    x0 = np.array([0.1, -0.2, 0.3, 0.0, 0.5, -0.1, 1.0, -1.0, 0.5, 1.0, -1.0, 0.5])
    x0[[0, 1, 2, 3]] = 0.0  # these have almost no weight: their cost takes for ever to pay
    paid, x = 0.0, x0
    for _ in range(20000):
        u = -gains.K @ x
        paid += x @ Q @ x + u @ R @ u
        x = model.A @ x + model.B @ u
    assert paid == pytest.approx(x0 @ gains.P @ x0, rel=1e-3)


def test_closed_loop_is_stable(model):
    gains = tracking_gains(model, Q, R)
    np.testing.assert_allclose(gains.closed_loop, model.A - model.B @ gains.K, rtol=1e-14, atol=1e-14)
    assert np.abs(np.linalg.eigvals(gains.closed_loop)).max() < 1


def test_feed_forward_is_the_best_answer_to_a_coming_linear_cost(model):
    gains = tracking_gains(model, Q, R)
    P, B = gains.P, model.B
    np.testing.assert_allclose((R + B.T @ P @ B) @ gains.M, B.T, rtol=0, atol=1e-9)
    # u = M w is where u'Ru/2 + (Bu)'P(Bu)/2 - w'Bu has no slope.
    w = np.arange(12.0)
    u = gains.M @ w
    np.testing.assert_allclose(R @ u + B.T @ P @ B @ u - B.T @ w, 0, atol=1e-8)


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
