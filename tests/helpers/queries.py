"""Questions to oracles, and their answers by least squares."""

from dataclasses import dataclass

import control
import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.registry import oracles
from ogmp_sb3.config.robot import INPUT_NAMES, STATE_NAMES
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.weights import TrackingWeights
from ogmp_sb3.guidance.oracles import ORIENTATION_STEP, Plant, phase_weights
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.set_points import END, Reference, SetPoints, set_points, span_array, span_row
from ogmp_sb3.guidance.srb import POS, RPY, STATE_SIZE, SRBDynamics, srb_dynamics

NAMES = ["linear", "lqr", "preview"]
TASKS = {
    (task, oracle): load_task(task, {"oracle": oracle}) for task in ("parkour", "dive") for oracle in NAMES
}  # fmt: skip
X, Y, Z = range(POS.start, POS.stop)
FLAT = ModeCall("pace", {"v": 0.8, "length": 5.0})


@dataclass(frozen=True)
class Query:
    """Set-points of one task and the state they are asked from; ``Q`` in place of the task's weights."""

    task: str
    points: SetPoints
    x0: np.ndarray
    Q: TrackingWeights | None = None

    def plant(self) -> Plant:
        config = TASKS[self.task, "linear"]
        return Plant(config.robot_config.srb, config.control_dt)

    def params(self, phase: str = "stance") -> dict:
        """The parameters of ``preview`` and ``lqr`` in one phase of contact."""
        given = TASKS[self.task, "preview"].oracle_params["preview"]
        return {**given, "Q": phase_weights(self.Q or given["Q"])[phase]}

    def ask(self, oracle: str) -> Reference:
        config: TaskConfig = TASKS[self.task, oracle]
        own = {} if self.Q is None else {"Q": self.Q}
        return oracles.get(oracle)(self.points, self.x0, self.plant(), **{**config.oracle_params[oracle], **own})


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


def random_query(mode: str, seed: int, rows: int = 1, steps: list[int] | None = None) -> Query:
    """A mode with random parameters from random states: every component differs from 0."""
    rng = np.random.default_rng(seed)
    sequences = [sequence(mode, rng) for _ in range(rows)]
    x0 = rng.normal(scale=0.2, size=(rows, STATE_SIZE))
    for row, calls in enumerate(sequences):
        x0[row, X] = rng.uniform(-0.2, 0.4)
        x0[row, Z] += 0.5 + calls[0].segment().start_height
    return query(MODES[mode], sequences, x0, steps)


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


def weights(q: Query, phase: str = "stance") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Q, R of all 12 inputs, and the terminal cost: the Riccati solution of the upright body."""
    plant, params = q.plant(), q.params(phase)
    Q = np.diag([max(params["Q"].get(name, 0.0), params["eps"]) for name in STATE_NAMES])
    foot = [params["R"][name] for name in INPUT_NAMES]
    R = np.diag(foot[:3] * 2 + foot[3:] * 2)
    upright = srb_dynamics(plant.srb, plant.dt, np.zeros(3))
    _, P, _ = control.dlqr(upright.A, upright.B, Q, R, method="scipy")
    return Q, R, P


def knot_weights(q: Query, row: int = 0) -> list[np.ndarray]:
    """The weights of every knot, those of the step that begins there; at the end, the last step's terminal cost."""
    phases = {True: weights(q, "stance"), False: weights(q, "flight")}
    stance = [bool(each) for each in q.points.stance[row, : q.points.steps[row]]]
    return [*(phases[each][0] for each in stance), phases[stance[-1]][2]]


def least_squares(q: Query, row: int = 0) -> np.ndarray:
    """The trajectory of least tracking cost over all 12 inputs of every stance step, shape (steps + 1, 12).

    Every state is written as a linear map of all inputs; square roots of the weights make the cost one sum of
    squares.
    """
    _, R, _ = weights(q)
    steps, r, x0 = q.points.steps[row], q.points.state[row], q.x0[row]
    stances = np.flatnonzero(q.points.stance[row, :steps])
    maps, offset, states = np.zeros((STATE_SIZE, 12 * len(stances))), x0, []
    for k, model in enumerate(models(q, row)):
        maps, offset = model.A @ maps, model.A @ offset + model.d
        if q.points.stance[row, k]:
            column = 12 * int(np.searchsorted(stances, k))
            maps[:, column : column + 12] += model.B
        states.append((maps.copy(), offset))
    *running, P = knot_weights(q, row)[1:]
    roots = [np.sqrt(Q) for Q in running] + [np.linalg.cholesky(P).T]
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
    _, R, _ = weights(q)
    steps = q.points.steps[row]
    u, _ = best_inputs(q, state, row)
    e = state[: steps + 1] - q.points.state[row, : steps + 1]
    errors = sum(error @ Q @ error for error, Q in zip(e, knot_weights(q, row), strict=True))
    return float(errors + np.einsum("ki,ij,kj", u, R, u))
