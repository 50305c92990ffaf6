"""Motion traces of episodes made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.records import record
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.traces import Ground, ground_rows, make_trace, trace_rows
from ogmp_sb3.guidance.terrain import height_at

STEPS = 7
PARKOUR, DIVE = load_task("parkour"), load_task("dive")
MODES = (
    {"mode": "pace", "v": 0.8, "length": 0.6},
    {"mode": "leap", "w": 0.3, "d": 0.5, "v": 0.8, "run_up": 0.4},
    {"mode": "jump", "w": 0.4, "h": 0.2, "v": 0.8, "run_up": 0.45},
)


def episode(axis: int = 0, modes: tuple = MODES):
    """Seven steps with queries at 0, 3 and 6; the reference is one metre ahead and a metre up."""
    ramp = np.arange(STEPS + 1, dtype=float)
    base = np.zeros((STEPS + 1, 3))
    base[:, axis], base[:, 2] = 0.1 * ramp, 0.5
    ahead = base.copy()
    ahead[:, axis] += ramp
    ahead[:, 2] += 1.0
    return replace(
        record(), base_pos_w=base, base_quat=np.tile([1.0, 0, 0, 0], (STEPS + 1, 1)), reference_pos_w=ahead,
        phase=np.array([0, 1, 2, 3, 1, 2, 3, 1]), deviation=ramp, reward=np.zeros(STEPS + 1), modes=modes,
    )  # fmt: skip


def test_references_are_cut_where_the_oracle_was_asked_again() -> None:
    trace = make_trace(episode(), PARKOUR, "test")
    assert [len(part) for part in trace.references] == [3, 3, 1]
    np.testing.assert_allclose(trace.references[1][:, 0], 1.1 * np.array([4, 5, 6]))
    np.testing.assert_allclose(trace.references[1][:, 1], 1.5)
    np.testing.assert_allclose(trace.up, np.tile([0.0, 1.0], (STEPS + 1, 1)))
    assert trace.title == "test, 7 steps, 0.7 m along x"


def test_a_motion_to_the_side_is_seen_from_the_front() -> None:
    flip = ({"mode": "flip", "r": "left", "h": 1.2}, {"mode": "settle"})
    trace = make_trace(episode(axis=1, modes=flip), DIVE, "test")
    assert trace.axis == 1
    np.testing.assert_allclose(trace.base[:, 0], 0.1 * np.arange(STEPS + 1))
    assert Ground("flip", -0.2, 0.2, 1.2) in trace.ground


def test_the_band_is_the_bound_over_the_weight_of_the_height() -> None:
    assert make_trace(episode(), PARKOUR, "").half_band is None  # bounds x alone
    weighted = load_task("parkour", {"rho": 0.4, "bound": {"x": 1.0, "z": 2.0}})
    assert make_trace(episode(), weighted, "").half_band == pytest.approx(0.2)
    unbounded = load_task("parkour", {"rho": None, "bound": {"z": 2.0}})
    assert make_trace(episode(), unbounded, "").half_band is None


def test_the_ground_is_that_of_the_simulation() -> None:
    from ogmp_sb3.env.batch_env import BatchEnv

    env = BatchEnv(PARKOUR, seed=5)
    env.reset()
    modes = tuple({"mode": call.name, **call.parameters} for call in env.modes[0])
    ground = make_trace(episode(modes=modes), PARKOUR, "").ground
    ends = {piece.end for piece in ground} | {piece.start for piece in ground}
    x = np.array([v for v in np.arange(-1.9, max(ends), 0.013) if min(abs(v - end) for end in ends) > 1e-6])
    expected = height_at(env.terrain, np.stack([x, np.zeros_like(x)], axis=1)[None])[0]
    found = [max((p.top for p in ground if p.start <= v < p.end), default=-50.0) for v in x]
    np.testing.assert_allclose(found, expected)


def test_rows_hold_every_step_with_its_query_and_reference() -> None:
    trace = make_trace(episode(), PARKOUR, "test")
    rows = trace_rows([trace, trace])
    assert len(rows) == 2 * (STEPS + 1)
    assert [row["query"] for row in rows[: STEPS + 1]] == [0, 1, 1, 1, 2, 2, 2, 3]
    assert [row["deviation"] for row in rows[: STEPS + 1]] == list(range(STEPS + 1))
    assert rows[5]["reference_along_m"] == pytest.approx(5.5)
    assert {row["mode"] for row in ground_rows([trace])} == {"", "pace", "leap", "jump"}
