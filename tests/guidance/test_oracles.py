"""Oracles against brute-force least squares and the laws of flight."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.queries import (
    CASES,
    FLAT,
    MODES,
    NAMES,
    TASKS,
    Query,
    X,
    Y,
    Z,
    best_inputs,
    laid,
    least_squares,
    query,
    random_query,
    tracking_cost,
)
from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.config.weights import PhaseWeights
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.set_points import SetPoints, set_points
from ogmp_sb3.guidance.srb import GRAVITY, OMEGA, POS, RPY, STATE_SIZE, VEL

# ---- all oracles ----


@pytest.mark.parametrize("oracle", NAMES)
@pytest.mark.parametrize(("mode", "seed"), CASES)
def test_the_first_knot_is_the_state_at_the_query(oracle, mode, seed):
    q = random_query(mode, seed, rows=2)
    reference = q.ask(oracle)
    assert reference.state.shape == q.points.state.shape
    np.testing.assert_array_equal(reference.state[:, 0], q.x0)
    np.testing.assert_array_equal(reference.steps, q.points.steps)
    assert np.isfinite(reference.state).all()


@pytest.mark.parametrize("oracle", NAMES)
def test_the_same_question_has_the_same_answer_and_changes_no_argument(oracle):
    q = random_query("flip", 5, rows=3)
    arrays = (q.points.state, q.points.stance, q.points.span, q.points.steps, q.x0)
    before = [a.copy() for a in arrays]
    first = q.ask(oracle).state.copy()
    random_query("leap", 6).ask(oracle)  # nothing is remembered from other questions
    np.testing.assert_array_equal(q.ask(oracle).state, first)
    for array, copy in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, copy)
    assert not np.shares_memory(q.ask(oracle).state, q.points.state)


@pytest.mark.parametrize("oracle", NAMES)
@pytest.mark.parametrize("mode", MODES)
def test_many_rows_are_answered_like_one_at_a_time(oracle, mode):
    q = random_query(mode, 7, rows=4)  # flips of different heights take different numbers of steps
    together = q.ask(oracle).state
    for row, steps in enumerate(q.points.steps):
        p = q.points
        one = slice(row, row + 1)
        alone = replace(
            q,
            points=SetPoints(
                p.state[one, : steps + 1], p.stance[one, :steps], p.span[one, :steps], p.steps[one], p.blend
            ),
            x0=q.x0[one],
        )
        np.testing.assert_allclose(together[row, : steps + 1], alone.ask(oracle).state[0], rtol=0, atol=1e-10)


@pytest.mark.parametrize("oracle", NAMES)
def test_how_far_other_rows_look_changes_no_answer(oracle):
    calls = (ModeCall("jump", {"w": 0.4, "h": 0.3}), FLAT)
    x0 = np.tile(np.linspace(0.1, 0.6, STATE_SIZE), (2, 1))
    together = query("parkour", [calls, calls], x0, steps=[10, 30]).ask(oracle).state
    for row, steps in enumerate((10, 30)):
        alone = query("parkour", [calls], x0[:1], steps=[steps]).ask(oracle).state
        np.testing.assert_allclose(together[row, : steps + 1], alone[0], rtol=0, atol=1e-10)


def test_preview_holds_its_last_knot_beyond_what_is_asked():
    calls = (ModeCall("jump", {"w": 0.4, "h": 0.3}), FLAT)
    q = query("parkour", [calls, calls], np.full((2, STATE_SIZE), 0.1), steps=[10, 30])
    state = q.ask("preview").state
    np.testing.assert_array_equal(state[0, 10:], np.broadcast_to(state[0, 10], (21, STATE_SIZE)))
    assert (np.diff(state[1, :, X]) != 0).all()


@pytest.mark.parametrize("oracle", NAMES)
def test_answers_move_with_the_robot_along_the_track(oracle):
    here = random_query("jump", 3)
    shift = np.zeros(STATE_SIZE)
    shift[X] = 4096.0
    there = replace(here, points=replace(here.points, state=here.points.state + shift), x0=here.x0 + shift)
    np.testing.assert_allclose(there.ask(oracle).state - shift, here.ask(oracle).state, rtol=0, atol=1e-6)


# ---- linear ----


@pytest.mark.parametrize(("mode", "seed"), CASES)
def test_linear_ends_on_the_set_points(mode, seed):
    q = random_query(mode, seed)
    state, asked = q.ask("linear").state[0], q.points.state[0]
    np.testing.assert_allclose(state[-1, POS], asked[-1, POS], atol=1e-12)
    np.testing.assert_allclose(state[1:, RPY], asked[1:, RPY], atol=1e-12)
    over_one_hop = int(np.ceil(q.points.blend))
    np.testing.assert_allclose(state[over_one_hop:, Z], asked[over_one_hop:, Z], atol=1e-12)


@pytest.mark.parametrize(("mode", "seed"), CASES)
def test_velocities_of_linear_are_differences_of_its_positions(mode, seed):
    state = random_query(mode, seed).ask("linear").state[0]
    moved = state[0, POS] + 0.03 * np.cumsum(state[1:, VEL], axis=0)
    np.testing.assert_allclose(moved, state[1:, POS], atol=1e-12)


def test_linear_goes_straight_from_the_present_place_to_the_centre_line():
    x0 = np.zeros((1, STATE_SIZE))
    x0[0, POS] = 0.0, 0.6, 0.55
    state = query("parkour", [(FLAT,)], x0).ask("linear").state[0]
    np.testing.assert_allclose(state[:, Y], np.linspace(0.6, 0.0, 31), atol=1e-12)
    np.testing.assert_allclose(state[:, Z], 0.55, atol=1e-12)


@pytest.mark.parametrize("oracle", ["linear", "lqr"])
@pytest.mark.parametrize("x", [0.7, 1.2])
def test_what_lies_behind_the_robot_does_not_lift_or_drop_it(oracle, x):
    """The robot is where its set-points are: on a block with flat ground behind, or the other way round."""
    behind = (ModeCall("pace", {"v": 0.8, "length": 0.1}), ModeCall("jump", {"w": 0.4, "h": 0.3, "run_up": 0.4}))
    spans = laid(*behind, FLAT)[None]
    spans = spans[:, 2:] if x > 1.1 else spans  # the environment forgets what lies 0.8 m behind
    config = TASKS["parkour", "linear"]
    height = config.gait.height + (0.3 if x < 1.1 else 0.0)
    x0 = np.zeros((1, STATE_SIZE))
    x0[0, [X, Z]], x0[0, VEL.start] = (x, height), 0.8
    points = set_points(spans, np.array([False]), x0, np.array([5]), config.control_dt, config.gait)
    state = Query("parkour", points, x0).ask(oracle).state[0]
    np.testing.assert_allclose(state[1, Z], height, atol=0.01)


# ---- lqr and preview ----


@pytest.mark.parametrize("oracle", ["lqr", "preview"])
@pytest.mark.parametrize(("mode", "seed"), CASES)
def test_motion_obeys_the_dynamics_with_input_in_stance_and_none_in_flight(oracle, mode, seed):
    q = random_query(mode, seed)
    _, unexplained = best_inputs(q, q.ask(oracle).state[0])
    assert np.abs(unexplained).max() < 1e-9


@pytest.mark.parametrize(("mode", "seed"), CASES)
def test_linear_does_not_obey_the_dynamics(mode, seed):
    q = random_query(mode, seed)
    _, unexplained = best_inputs(q, q.ask("linear").state[0])
    assert np.abs(unexplained).max() > 1e-3


@pytest.mark.parametrize("oracle", ["lqr", "preview"])
@pytest.mark.parametrize("mode", ["pace", "jump", "leap", "flip"])
def test_flight_is_ballistic(oracle, mode):
    q = random_query(mode, 11)
    state, stance = q.ask(oracle).state[0], q.points.stance[0]
    edges = np.flatnonzero(np.diff(np.concatenate([[True], stance, [True]]).astype(int)))
    flights = list(zip(edges[::2], edges[1::2], strict=True))
    assert flights
    for start, end in flights:
        t = 0.03 * np.arange(end - start + 1)[:, None]
        p, v = state[start, POS], state[start, VEL]
        fall = np.array([0.0, 0.0, -GRAVITY])
        np.testing.assert_allclose(state[start : end + 1, POS], p + t * v + 0.5 * t**2 * fall, atol=1e-12)
        np.testing.assert_allclose(state[start : end + 1, VEL], v + t * fall, atol=1e-12)
        np.testing.assert_allclose(np.diff(state[start : end + 1, OMEGA], axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_preview_in_one_stance_is_the_least_squares_optimum(seed):
    q = random_query("settle", seed)
    assert q.points.stance.all()
    np.testing.assert_allclose(q.ask("preview").state[0], least_squares(q), rtol=0, atol=1e-8)


@pytest.mark.parametrize("task", ["parkour", "dive"])
def test_preview_in_one_stance_is_the_optimum_for_set_points_that_move(task):
    settle = query(task, [(ModeCall("settle", {}),)], np.full((1, STATE_SIZE), 0.2))
    rng = np.random.default_rng(1)
    moving = np.cumsum(rng.normal(scale=0.02, size=settle.points.state.shape), axis=1)
    moving[..., RPY] = moving[..., OMEGA] = 0.0  # one orientation, one segment
    q = replace(settle, points=replace(settle.points, state=settle.points.state + moving))
    np.testing.assert_allclose(q.ask("preview").state[0], least_squares(q), rtol=0, atol=1e-8)


@pytest.mark.parametrize(("mode", "seed"), [c for c in CASES if c.values[0] != "settle"])
def test_preview_is_the_least_squares_optimum_across_stance_and_flight(mode, seed):
    q = random_query(mode, seed)
    assert 0 < q.points.stance.sum() < q.points.stance.size
    np.testing.assert_allclose(q.ask("preview").state[0], least_squares(q), rtol=0, atol=1e-7)


PHASES = PhaseWeights(
    stance={"z": 8000.0, "y": 2.0, "vx": 20.0, "wx": 50.0, "wy": 70.0, "roll": 5.0},
    flight={"z": 30.0, "vz": 900.0, "vx": 3.0, "wy": 4.0, "wz": 6.0, "pitch": 40.0},
)


@pytest.mark.parametrize(("mode", "seed"), CASES)
@pytest.mark.parametrize("steps", [None, [9], [13]])
def test_preview_with_weights_of_its_own_in_flight_is_the_least_squares_optimum(mode, seed, steps):
    """Horizons that end in stance and in flight: each ends with the terminal cost of its own phase."""
    q = replace(random_query(mode, seed, steps=steps), Q=PHASES)
    found = q.ask("preview").state[0]
    np.testing.assert_allclose(found, least_squares(q), rtol=0, atol=1e-7)
    for one in (PHASES["stance"], PHASES["flight"]):
        if not q.points.stance.all() or one is PHASES["flight"]:
            assert np.abs(found - replace(q, Q=one).ask("preview").state[0]).max() > 1e-4


@pytest.mark.parametrize("oracle", ["lqr", "preview"])
@pytest.mark.parametrize(("mode", "seed"), CASES)
def test_one_mapping_of_weights_means_both_phases_to_the_bit(oracle, mode, seed):
    q, one = random_query(mode, seed), PHASES["stance"]
    for_each = replace(q, Q=PhaseWeights(stance=one, flight=one)).ask(oracle).state
    np.testing.assert_array_equal(replace(q, Q=one).ask(oracle).state, for_each)


@pytest.mark.parametrize(("mode", "seed"), CASES)
def test_lqr_weighs_as_in_stance(mode, seed):
    q = random_query(mode, seed)
    np.testing.assert_array_equal(
        replace(q, Q=PHASES).ask("lqr").state, replace(q, Q=PHASES["stance"]).ask("lqr").state
    )


@pytest.mark.parametrize("h", [1.0, 1.375, 1.75, 2.0, 2.5])
@pytest.mark.parametrize("r", ["front", "back", "left", "right"])
def test_preview_does_not_sink_before_it_dives(r, h):
    """Were the height tracked in flight too, which no input changes, it would lift off as low as 0.28 m."""
    start = np.eye(STATE_SIZE)[[Z]] * (h + 0.5)
    q = query("dive", [(ModeCall("flip", {"r": r, "h": h}),)], start)
    standing = np.flatnonzero(q.points.stance[0])
    height = q.ask("preview").state[0, : standing[-1] + 2, Z] - h
    np.testing.assert_allclose(height, 0.5, atol=0.005)
    sunk = replace(q, Q=q.params("stance")["Q"]).ask("preview").state[0, standing[-1] + 1, Z] - h
    assert sunk < 0.44


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", range(0, 80, 10))
def test_preview_never_tracks_worse_than_lqr(mode, seed):
    q = random_query(mode, seed, rows=3)
    by_preview, by_lqr = q.ask("preview").state, q.ask("lqr").state
    for row in range(3):
        assert tracking_cost(q, by_preview[row], row) <= tracking_cost(q, by_lqr[row], row) * (1 + 1e-9)


def test_preview_prepares_for_what_lqr_cannot_see():
    """Until the block's set-points begin, two tracks look the same to lqr; preview already rises for one."""
    x0 = np.zeros((1, STATE_SIZE))
    x0[0, [Z, VEL.start]] = 0.55, 0.8
    flat, block = ((ModeCall("jump", {"w": 0.4, "h": h, "run_up": 0.53}), FLAT) for h in (0.0, 0.3))
    difference = {
        name: query("parkour", [block], x0).ask(name).state - query("parkour", [flat], x0).ask(name).state
        for name in ("lqr", "preview")
    }
    begins = 20  # (0.53 - 0.05) m at 0.8 m/s
    np.testing.assert_array_equal(difference["lqr"][0, :begins], 0.0)
    assert difference["preview"][0, begins, Z] > 0.05


@pytest.mark.parametrize("task", ["parkour", "dive"])
def test_lqr_at_rest_is_preview_of_a_set_point_held_for_long(task):
    x0 = np.linspace(-0.3, 0.3, STATE_SIZE)[None]
    q = query(task, [(ModeCall("settle", {}),)], x0, steps=[200])
    by_lqr, by_preview = q.ask("lqr").state[0], q.ask("preview").state[0]
    # Gravity does not enter the terminal cost, so preview lets go of the weight at the very end.
    np.testing.assert_allclose(by_lqr[:100], by_preview[:100], rtol=0, atol=1e-6)
    unloaded = [i for i in range(STATE_SIZE) if STATE_NAMES[i] not in ("z", "vz")]
    np.testing.assert_allclose(by_lqr[:, unloaded], by_preview[:, unloaded], rtol=0, atol=1e-8)


@pytest.mark.parametrize("task", ["parkour", "dive"])
def test_lqr_comes_to_rest_on_a_set_point_that_rests(task):
    q = query(task, [(ModeCall("settle", {}),)], np.linspace(-0.1, 0.1, STATE_SIZE)[None], steps=[400])
    state = q.ask("lqr").state[0]
    assert state[-1, Z] == pytest.approx(q.points.state[0, -1, Z], abs=1e-9)
    assert np.abs(state[-1, VEL.start + 2]) < 1e-9
