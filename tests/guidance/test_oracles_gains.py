"""The weights of the oracles and their stationary gains, against python-control."""

from dataclasses import replace
from functools import partial

import control
import numpy as np
import pytest

from helpers.queries import Z, models, query, weights
from ogmp_sb3.config.registry import oracles
from ogmp_sb3.config.robot import INPUT_NAMES, STATE_NAMES
from ogmp_sb3.guidance.oracles import input_weights, state_weights, stationary_gains
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.srb import GRAVITY, STATE_SIZE, srb_dynamics


def test_states_without_a_weight_weigh_eps():
    found = state_weights({"z": 5.0, "vx": 2.0, "x": 0.0}, eps=1e-6)
    expected = {name: 1e-6 for name in STATE_NAMES} | {"z": 5.0, "vx": 2.0}
    np.testing.assert_array_equal(found, list(expected.values()))


def test_input_weights_follow_the_order_of_the_inputs():
    values = {name: float(i) for i, name in enumerate(INPUT_NAMES)}
    np.testing.assert_array_equal(input_weights(dict(reversed(values.items()))), np.arange(6.0))


@pytest.mark.parametrize("task", ["parkour", "dive"])
@pytest.mark.parametrize("mean_rpy", [(0.0, 0.0, 0.0), (0.0, 2.5, 0.0), (-3.0, 0.0, 0.0)])
def test_stationary_gain_equals_control_dlqr_of_all_twelve_inputs(task, mean_rpy):
    q = query(task, [(ModeCall("settle", {}),)], np.zeros((1, STATE_SIZE)))
    Q, R, _ = weights(q)
    model = srb_dynamics(q.plant().srb, q.plant().dt, np.array(mean_rpy))
    K, P, poles = control.dlqr(model.A, model.B, Q, R, method="scipy")
    feedback, cost = stationary_gains(q.plant(), **q.params(), mean_rpy=mean_rpy)
    np.testing.assert_allclose(feedback, K, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(cost, P, rtol=1e-10, atol=1e-10)
    assert np.abs(poles).max() < 1


@pytest.mark.parametrize("r", ["front", "left"])
def test_lqr_moves_as_twelve_inputs_with_the_gain_of_control_dlqr_would(r):
    """Half of the weight on each of two feet is the same as 6 inputs that carry it all."""
    x0 = np.linspace(-0.2, 0.2, STATE_SIZE)[None] + np.eye(STATE_SIZE)[Z] * 1.5
    q = query("dive", [(ModeCall("flip", {"r": r, "h": 1.0}),)], x0)
    Q, R, _ = weights(q)
    weight = np.zeros(12)
    weight[[2, 5]] = 0.5 * q.plant().srb.mass * GRAVITY
    x, expected = x0[0], [x0[0]]
    for k, model in enumerate(models(q)):
        u = np.zeros(12)
        if q.points.stance[0, k]:
            K, _, _ = control.dlqr(model.A, model.B, Q, R, method="scipy")
            u = weight - K @ (x - q.points.state[0, k])
        x = model.A @ x + model.B @ u + model.d
        expected.append(x)
    np.testing.assert_allclose(q.ask("lqr").state[0], expected, rtol=0, atol=1e-9)


def test_a_robot_with_four_feet_has_the_gain_of_control_dlqr_of_all_its_inputs():
    q = query("parkour", [(ModeCall("settle", {}),)], np.zeros((1, STATE_SIZE)))
    Q, R, _ = weights(q)
    model = srb_dynamics(q.plant().srb, q.plant().dt, np.zeros(3))
    force, moment = slice(0, 3), slice(6, 9)  # of the first foot; the others are the same
    B = np.concatenate([model.B[:, force]] * 4 + [model.B[:, moment]] * 4, axis=1)
    R = np.diag(np.concatenate([np.diag(R)[force]] * 4 + [np.diag(R)[moment]] * 4))
    K, P, _ = control.dlqr(model.A, B, Q, R, method="scipy")
    feedback, cost = stationary_gains(replace(q.plant(), feet=4), **q.params(), mean_rpy=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(cost, P, rtol=1e-9, atol=1e-9)
    for total, part in ((feedback[:6], K[:12]), (feedback[6:], K[12:])):
        np.testing.assert_allclose(total.reshape(2, 3, 12).sum(axis=0), part.reshape(4, 3, 12).sum(axis=0), atol=1e-8)


@pytest.mark.parametrize("oracle", ["lqr", "preview"])
def test_four_feet_move_the_body_as_two_of_half_the_weight(oracle):
    q = query("dive", [(ModeCall("flip", {"r": "front", "h": 1.0}),)], np.eye(STATE_SIZE)[[Z]] * 1.4)
    Q, R, eps = q.params().values()
    ask = partial(oracles.get(oracle), q.points, q.x0, Q=Q, eps=eps)
    four = ask(plant=replace(q.plant(), feet=4), R=R).state
    two = ask(plant=q.plant(), R={name: weight / 2 for name, weight in R.items()}).state
    np.testing.assert_allclose(four, two, atol=1e-12)
    assert np.abs(four - ask(plant=q.plant(), R=R).state).max() > 1e-4
