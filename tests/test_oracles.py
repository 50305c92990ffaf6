"""Oracles against brute-force least squares, python-control and the laws of flight."""

from dataclasses import dataclass, replace
from functools import partial

import control
import numpy as np
import pytest

from ogmp_sb3.config import load_task
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.oracles import ORIENTATION_STEP, Plant, input_weights, state_weights, stationary_gains
from ogmp_sb3.reference import END, Reference, SetPoints, set_points, span_array, span_row
from ogmp_sb3.registry import oracles
from ogmp_sb3.sampling import ModeCall
from ogmp_sb3.srb import GRAVITY, INPUT_NAMES, OMEGA, POS, RPY, STATE_NAMES, STATE_SIZE, VEL, SRBDynamics, srb_dynamics

NAMES = ["linear", "lqr", "preview"]
TASKS = {
    (task, oracle): load_task(task, {"oracle": oracle}) for task in ("parkour", "dive") for oracle in NAMES
}  # fmt: skip
X, Y, Z = range(POS.start, POS.stop)
FLAT = ModeCall("pace", {"v": 0.8, "length": 5.0})


@dataclass(frozen=True)
class Query:
    """Set-points of one task and the state they are asked from."""

    task: str
    points: SetPoints
    x0: np.ndarray

    def plant(self) -> Plant:
        config = TASKS[self.task, "linear"]
        return Plant(config.robot_config.srb, config.control_dt)

    def params(self) -> dict:
        return TASKS[self.task, "preview"].oracle_params["preview"]

    def ask(self, oracle: str) -> Reference:
        config: TaskConfig = TASKS[self.task, oracle]
        return oracles.get(oracle)(self.points, self.x0, self.plant(), **config.oracle_params[oracle])


def laid(*calls: ModeCall) -> np.ndarray:
    """The spans of modes one after another, and a hold, shape (spans, SPAN_SIZE)."""
    rows, offset = [], 0.0
    for call in calls:
        segment = call.segment()
        rows += [span_row(span, offset) for span in segment.spans]
        offset += segment.length
    return span_array(rows)


def query(task: str, sequences: list[tuple[ModeCall, ...]], x0: np.ndarray, steps: list[int] | None = None) -> Query:
    """One row for each sequence of modes; timed modes are asked for whole, others for 30 steps."""
    config, every = TASKS[task, "linear"], [laid(*calls) for calls in sequences]
    most = max(len(spans) for spans in every)
    spans = np.stack([np.pad(s, ((0, most - len(s)), (0, 0)), mode="edge") for s in every])
    timed = np.array([calls[0].segment().timed for calls in sequences])
    if steps is None:
        ends = [s[-2, END] for s in every]
        steps = [round(e / config.control_dt) if t else 30 for e, t in zip(ends, timed, strict=True)]
    points = set_points(spans, timed, x0, np.array(steps), config.control_dt, config.gait)
    return Query(task, points, x0)


def sequence(mode: str, rng: np.random.Generator) -> tuple[ModeCall, ...]:
    """A mode with random parameters, in the paper's ranges and beyond, and flat ground behind it."""
    u = rng.uniform
    if mode == "pace":
        return (ModeCall("pace", {"v": u(0.2, 1.5), "length": u(0.2, 1.5)}), FLAT)
    if mode == "jump":
        return (
            ModeCall("jump", {"w": u(0.2, 0.6), "h": u(0.05, 0.4), "v": u(0.4, 1.2), "run_up": u(0.1, 0.6)}),
            FLAT,
        )
    if mode == "leap":
        gap = {"w": u(0.1, 0.5), "d": 0.5, "v": u(0.4, 1.2), "run_up": u(0.1, 0.6)}
        return (ModeCall("leap", gap), FLAT)
    if mode == "flip":
        r = ("front", "back", "left", "right")[int(rng.integers(4))]
        return (ModeCall("flip", {"r": r, "h": u(0.5, 2.0)}),)
    return (ModeCall("settle", {}),)


MODES = {"pace": "parkour", "jump": "parkour", "leap": "parkour", "flip": "dive", "settle": "dive"}


def random_query(mode: str, seed: int, rows: int = 1) -> Query:
    """A mode with random parameters from random states: every component differs from 0."""
    rng = np.random.default_rng(seed)
    sequences = [sequence(mode, rng) for _ in range(rows)]
    x0 = rng.normal(scale=0.2, size=(rows, STATE_SIZE))
    for row, calls in enumerate(sequences):
        x0[row, X] = rng.uniform(-0.2, 0.4)
        x0[row, Z] += 0.5 + calls[0].segment().start_height
    return query(MODES[mode], sequences, x0)


CASES = [pytest.param(mode, seed, id=f"{mode}-{seed}") for mode in MODES for seed in range(3)]


def models(q: Query, row: int = 0) -> list[SRBDynamics]:
    """The linear model of each step: each span's at its own mean orientation, as the paper has it."""
    points, plant, steps = q.points, q.plant(), q.points.steps[row]
    rpy = 0.5 * (points.state[row, :-1, RPY] + points.state[row, 1:, RPY])
    made = {}
    for span in np.unique(points.span[row, :steps]):
        mean = rpy[points.span[row] == span].mean(axis=0)
        made[span] = srb_dynamics(plant.srb, plant.dt, np.round(mean / ORIENTATION_STEP) * ORIENTATION_STEP)
    return [made[span] for span in points.span[row, :steps]]


def weights(q: Query) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Q, R of all 12 inputs, and the terminal cost: the Riccati solution of the upright body."""
    plant, params = q.plant(), q.params()
    Q = np.diag([max(params["Q"].get(name, 0.0), params["eps"]) for name in STATE_NAMES])
    foot = [params["R"][name] for name in INPUT_NAMES]
    R = np.diag(foot[:3] * 2 + foot[3:] * 2)
    upright = srb_dynamics(plant.srb, plant.dt, np.zeros(3))
    _, P, _ = control.dlqr(upright.A, upright.B, Q, R, method="scipy")
    return Q, R, P


def least_squares(q: Query, row: int = 0) -> np.ndarray:
    """The trajectory of least tracking cost over all 12 inputs of every stance step, shape (steps + 1, 12).

    Every state is written as a linear map of all inputs; square roots of the weights make the cost one sum of
    squares.
    """
    Q, R, P = weights(q)
    steps, r, x0 = q.points.steps[row], q.points.state[row], q.x0[row]
    stances = np.flatnonzero(q.points.stance[row, :steps])
    maps, offset, states = np.zeros((STATE_SIZE, 12 * len(stances))), x0, []
    for k, model in enumerate(models(q, row)):
        maps, offset = model.A @ maps, model.A @ offset + model.d
        if q.points.stance[row, k]:
            column = 12 * int(np.searchsorted(stances, k))
            maps[:, column : column + 12] += model.B
        states.append((maps.copy(), offset))
    roots = [np.sqrt(Q)] * (steps - 1) + [np.linalg.cholesky(P).T]
    left = [root @ m for root, (m, _) in zip(roots, states, strict=True)]
    right = [root @ (r[k + 1] - o) for k, (root, (_, o)) in enumerate(zip(roots, states, strict=True))]
    left.append(np.kron(np.eye(len(stances)), np.sqrt(R)))
    right.append(np.zeros(12 * len(stances)))
    inputs, *_ = np.linalg.lstsq(np.concatenate(left), np.concatenate(right), rcond=None)
    return np.stack([x0, *(m @ inputs + o for m, o in states)])


def best_inputs(q: Query, state: np.ndarray, row: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The inputs that explain a trajectory best, none in flight, (steps, 12); and what they leave unexplained."""
    inputs, left = [], []
    for k, model in enumerate(models(q, row)):
        missing = state[k + 1] - model.A @ state[k] - model.d
        u = np.linalg.lstsq(model.B, missing, rcond=None)[0] if q.points.stance[row, k] else np.zeros(12)
        inputs.append(u)
        left.append(missing - model.B @ u)
    return np.array(inputs), np.array(left)


def tracking_cost(q: Query, state: np.ndarray, row: int = 0) -> float:
    """What a trajectory pays: for its errors, its inputs and its end."""
    Q, R, P = weights(q)
    steps = q.points.steps[row]
    u, _ = best_inputs(q, state, row)
    e = state[: steps + 1] - q.points.state[row, : steps + 1]
    running = np.einsum("ki,ij,kj", e[:-1], Q, e[:-1]) + np.einsum("ki,ij,kj", u, R, u)
    return float(running + e[-1] @ P @ e[-1])


# ------------------------------------------------------------------ all oracles


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


# ------------------------------------------------------------------ linear


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


# ------------------------------------------------------------------ lqr and preview


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


# ------------------------------------------------------------------ weights and gains


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
    gains = stationary_gains(q.plant(), **q.params(), mean_rpy=mean_rpy)
    np.testing.assert_allclose(gains.K, K, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(gains.P, P, rtol=1e-10, atol=1e-10)
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
    gains = stationary_gains(replace(q.plant(), feet=4), **q.params(), mean_rpy=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(gains.P, P, rtol=1e-9, atol=1e-9)
    for total, part in ((gains.K[:6], K[:12]), (gains.K[6:], K[12:])):
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
