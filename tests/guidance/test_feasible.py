"""How close feasible motions come to references, against distances known in advance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from helpers.queries import NAMES, TASKS, Query, Z, query, random_query
from ogmp_sb3.config.weights import TrackingWeights
from ogmp_sb3.guidance.feasible import GREATEST_HEIGHT, LEAST_HEIGHT, STRIDE, Footing, footing, least_deviation
from ogmp_sb3.guidance.oracles import phase_weights
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.srb import GRAVITY, POS, STATE_SIZE

DT = 0.03
X, XD, ZD = POS.start, POS.start + 6, Z + 6


def unit(*states: int) -> np.ndarray:
    return np.isin(np.arange(STATE_SIZE), states).astype(float)


def anywhere(stance: list[bool]) -> Footing:
    """Feet that hold the base at any height."""
    knots = len(stance) + 1
    return Footing(np.array(stance), np.full(knots, -100.0), np.full(knots, 100.0))


def test_nothing_holds_a_body_in_flight() -> None:
    reference = np.zeros((11, STATE_SIZE))
    drop = 0.5 * GRAVITY * 0.3**2
    assert least_deviation(reference, reference[0], unit(Z), anywhere([False] * 10), DT) == pytest.approx(drop)
    assert least_deviation(reference, reference[0], 2.0 * unit(ZD), anywhere([False] * 10), DT) == pytest.approx(
        2.0 * GRAVITY * 0.3
    )
    for scale in (1e-9, 1e9):  # of the unit alone
        scaled = least_deviation(reference, reference[0], scale * unit(Z), anywhere([False] * 10), DT)
        assert scaled == pytest.approx(scale * drop)
    both = least_deviation(reference, reference[0], unit(Z, ZD), anywhere([False] * 10), DT)
    assert both == pytest.approx(math.hypot(drop, GRAVITY * 0.3))


def test_a_body_in_flight_goes_on_turning_as_it_did_and_in_stance_as_it_likes() -> None:
    reference, wy, pitch = np.zeros((11, STATE_SIZE)), 7, 1
    reference[1:, wy] = 3.0
    start = unit(wy) * 1.0
    assert least_deviation(reference, start, unit(wy), anywhere([False] * 10), DT) == pytest.approx(2.0)
    assert least_deviation(reference, start, unit(wy), anywhere([True] * 10), DT) == pytest.approx(0.0, abs=1e-6)
    reference[1:, pitch] = 3.0 * DT * np.arange(10) + 0.5 * DT * (1.0 + 3.0)
    both = least_deviation(reference, start, unit(pitch, wy), anywhere([True] + [False] * 9), DT)
    assert both == pytest.approx(0.0, abs=1e-6)


def test_the_ground_does_not_pull() -> None:
    """Lower than a fall is out of reach: it costs half the distance, up and down, of what falls too little."""
    reference = np.zeros((2, STATE_SIZE))
    reference[1, Z] = -0.1
    fallen = 0.5 * GRAVITY * DT**2
    assert least_deviation(reference, reference[0], unit(Z), anywhere([True]), DT) == pytest.approx(0.1 - fallen)
    reference[1, Z] = 0.1
    assert least_deviation(reference, reference[0], unit(Z), anywhere([True]), DT) == pytest.approx(0.0, abs=1e-6)


def test_friction_limits_how_far_a_body_goes_aside() -> None:
    """After one step it is in an upright cone of 45 degrees whose apex is where it would have fallen to."""
    reference, fallen = np.zeros((2, STATE_SIZE)), 0.5 * GRAVITY * DT**2
    reference[1, [X, Z]] = 0.2, -fallen
    found = least_deviation(reference, np.zeros(STATE_SIZE), unit(X, Z), anywhere([True]), DT)
    assert found == pytest.approx(0.2 / math.sqrt(2.0), abs=1e-3)  # not 0.1, the greatest error of one state
    reference[1, Z] = 0.3
    assert least_deviation(reference, np.zeros(STATE_SIZE), unit(X, Z), anywhere([True]), DT) < 1e-3


def test_a_body_in_stance_is_neither_too_low_nor_too_high() -> None:
    feet = Footing(np.array([True] * 20), np.full(21, 0.3), np.full(21, 0.7))
    for height, error in ((0.25, 0.05), (0.5, 0.0), (0.8, 0.1)):
        reference = np.tile(unit(Z) * height, (21, 1))
        start = unit(Z) * np.clip(height, 0.3, 0.7)
        assert least_deviation(reference, start, unit(Z), feet, DT) == pytest.approx(error, abs=1e-6)


def test_a_body_is_not_falling_too_fast_to_be_stopped_at_the_end() -> None:
    """It pushes a little harder in the only step of stance: the velocity that it gains counts for a step more."""
    feet = Footing(np.array([True] + [False] * 10), np.array([0.0] * 11 + [0.34]), np.full(12, 2.0))
    time = DT * np.arange(11)
    reference = np.tile(unit(Z) * 0.8, (12, 1))
    reference[1:, Z] -= 0.5 * GRAVITY * time**2
    reference[1:, ZD] = -GRAVITY * time
    short = 0.34 - (reference[-1, Z] + 0.5 * DT * reference[-1, ZD])
    assert reference[-1, Z] > 0.34 > 0.34 - short
    end = 11 * DT
    found = least_deviation(reference, reference[0], unit(Z), feet, DT)
    assert found == pytest.approx(short * (end - 0.5 * DT) / end, abs=1e-6)


def test_a_contact_schedule_that_no_body_can_keep_to_is_infinitely_far() -> None:
    feet = Footing(np.array([False, True]), np.full(3, 0.3), np.full(3, 0.7))
    reference = np.zeros((3, STATE_SIZE))
    assert least_deviation(reference, unit(Z) * 5.0, unit(Z), feet, DT) == math.inf


def test_feet_stand_on_ground_that_set_points_in_stance_are_close_to() -> None:
    set_points = np.zeros((7, STATE_SIZE))
    set_points[:, X] = 0.1 * np.arange(7)
    set_points[:, Z] = 0.55 + np.array([0.0, 0.0, 0.0, 0.3, 0.3, 0.3, 0.3])
    feet = footing(set_points, np.array([True, False, True, True, False, False]), 0.5, 0.55)
    assert STRIDE == 0.15  # one knot to each side
    ground = [(0.0, 0.0), (0.0, 0.0), (0.0, 0.3), (0.0, 0.3), (0.3, 0.3), (0.3, 0.3), (0.3, 0.3)]
    np.testing.assert_allclose(feet.low - LEAST_HEIGHT * 0.5, [low for low, _ in ground], atol=1e-12)
    np.testing.assert_allclose(feet.high - GREATEST_HEIGHT * 0.5, [high for _, high in ground], atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("oracle", ["lqr", "preview"])
def test_the_answer_of_a_dynamic_oracle_is_feasible_where_it_does_not_pull_at_the_ground(
    oracle: str, seed: int
) -> None:
    q = random_query("flip", seed)
    state = q.ask(oracle).state[0]
    push = (np.diff(state[:, ZD]) / DT + GRAVITY)[q.points.stance[0]]
    feet = anywhere(q.points.stance[0].tolist())
    found = least_deviation(state, q.x0[0], unit(Z), feet, DT)
    assert (found < 1e-6) == (push.min() >= -1e-6)


# ---- epsilon of the oracles ----

HEIGHTS = [1.0, 1.375, 1.75, 2.0, 2.5]
BOUNDS = {"of the task": {"z": 1.0, "wx": 0.025, "wy": 0.025}, "of the paper": {"z": 1.0}}


def epsilon(oracle: str, r: str, h: float, weights: np.ndarray, Q: TrackingWeights | None = None) -> float:
    """The least deviation of feasible motions from a flip's reference."""
    task = TASKS["dive", oracle]
    nominal = task.robot_config.nominal_height
    q: Query = replace(query("dive", [(ModeCall("flip", {"r": r, "h": h}),)], unit(Z)[None] * (h + nominal)), Q=Q)
    feet = footing(q.points.state[0], q.points.stance[0], nominal, task.gait.height)
    own = {} if Q is None or oracle == "linear" else {"Q": Q}
    assert own or Q is None
    return least_deviation(q.ask(oracle).state[0], q.x0[0], weights, feet, DT)


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("r", ["front", "back", "left", "right"])
def test_preview_errs_no_more_than_lqr_and_lqr_no_more_than_linear(r: str, bound: str) -> None:
    """The order of the paper (sec. IV, choice of oracle), eps_li >= eps_lqr >= eps_prev, at all heights of the dive."""
    weights = np.array(replace(TASKS["dive", "linear"], bound=BOUNDS[bound]).bound_weights)
    for h in HEIGHTS:
        li, by_lqr, prev = (epsilon(oracle, r, h, weights) for oracle in NAMES)
        assert li > 0.1 > by_lqr + 1e-6 >= prev, h


@pytest.mark.parametrize("h", [1.75, 2.0, 2.5])
def test_with_the_height_tracked_in_flight_preview_would_err_more_than_lqr(h: float) -> None:
    Q = phase_weights(TASKS["dive", "preview"].oracle_params["preview"]["Q"])["stance"]
    assert epsilon("preview", "front", h, unit(Z), Q) > 0.05
    assert epsilon("lqr", "front", h, unit(Z), Q) < 1e-6
