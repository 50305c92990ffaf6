"""Set-points laid out in time: places, heights, contacts and turns, from wherever the robot is."""

import numpy as np
import pytest

from helpers import queries
from ogmp_sb3.config.task import GaitConfig
from ogmp_sb3.guidance.modes import BLOCK_LEAD, BLOCK_TAIL, Contact
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.set_points import (
    CONTACT,
    END,
    FOREVER,
    SPAN_SIZE,
    SetPoints,
    append_spans,
    set_points,
    span_array,
    span_row,
)
from ogmp_sb3.guidance.srb import GRAVITY, OMEGA, POS, RPY, STATE_SIZE, VEL

DT = 0.03  # s
GAIT = GaitConfig(height=0.55, cycle=0.25)
X, Y, Z = range(POS.start, POS.stop)
VX, VY, VZ = range(VEL.start, VEL.stop)
PACE = ModeCall("pace", {"v": 0.8, "length": 3.0})


def laid(*calls: ModeCall) -> np.ndarray:
    """The spans of modes one after another, and a hold, shape (1, spans, SPAN_SIZE)."""
    return queries.laid(*calls)[None]


def ask(spans: np.ndarray, steps: int, timed: bool = False, gait: GaitConfig = GAIT, **start: float) -> SetPoints:
    """The set-points of one row from a state with the given x, y, z (m)."""
    x0 = np.zeros((1, STATE_SIZE))
    x0[0, POS] = start.get("x", 0.0), start.get("y", 0.0), start.get("z", gait.height)
    return set_points(spans, np.array([timed]), x0, np.array([steps]), DT, gait)


def flip(r: str = "front", h: float = 1.0) -> tuple[SetPoints, float]:
    """A whole flip as the environment asks for it, and when it ends, s."""
    spans = laid(ModeCall("flip", {"r": r, "h": h}))
    end = spans[0, -2, END]
    return ask(spans, round(end / DT), timed=True, z=h + GAIT.height), end


def runs(stance: np.ndarray) -> list[tuple[bool, int]]:
    """Lengths of the runs of equal values."""
    edges = np.flatnonzero(np.diff(stance.astype(int))) + 1
    return [(bool(part[0]), len(part)) for part in np.split(stance, edges)]


def test_a_span_as_a_row_starts_where_its_mode_starts():
    span = ModeCall("jump", {"w": 0.4, "h": 0.3}).segment().spans[1]
    here, there = span_row(span, 0.0), span_row(span, 100.0)
    assert len(here) == SPAN_SIZE
    assert there[END] == 100.0 + span.end
    assert here[1:] == there[1:]


def test_a_hold_goes_on_where_the_last_span_ends():
    last = np.array(span_row(ModeCall("flip", {"r": "back", "h": 1.5}).segment().spans[0], 0.0))
    points = ask(span_array([tuple(last)])[None], 40, timed=True)
    after = np.arange(41) * DT > 0.5 + 1e-9
    np.testing.assert_allclose(points.state[0, after, Z], 1.5 + GAIT.height)
    np.testing.assert_allclose(points.state[0, after, OMEGA.start + 1], last[-1])
    np.testing.assert_allclose(points.state[0, after, VX], -1.0)


def test_knots_are_one_control_step_apart_at_the_asked_speed():
    points = ask(laid(PACE), 30, x=0.37)
    assert points.state.shape == (1, 31, STATE_SIZE)
    assert points.stance.shape == points.span.shape == (1, 30)
    np.testing.assert_allclose(points.state[0, :, X], 0.37 + 0.8 * DT * np.arange(31), rtol=1e-13)
    np.testing.assert_allclose(points.state[0, :, VX], 0.8)
    np.testing.assert_allclose(points.state[0, :, Z], GAIT.height)


def test_speed_changes_where_the_next_mode_begins():
    points = ask(laid(ModeCall("pace", {"v": 1.0, "length": 0.3}), ModeCall("pace", {"v": 0.5, "length": 3.0})), 30)
    time = DT * np.arange(31)
    np.testing.assert_allclose(points.state[0, :, X], np.where(time < 0.3, time, 0.3 + 0.5 * (time - 0.3)), atol=1e-12)
    np.testing.assert_allclose(points.state[0, :11, VX], 1.0)
    np.testing.assert_allclose(points.state[0, 11:, VX], 0.5)


def test_on_a_track_the_lateral_target_is_the_centre_line_and_in_a_timed_mode_the_present_place():
    np.testing.assert_array_equal(ask(laid(PACE), 10, y=0.3).state[0, :, Y], 0.0)
    np.testing.assert_array_equal(ask(laid(ModeCall("settle", {})), 10, True, y=0.3).state[0, :, Y], 0.3)


@pytest.mark.parametrize("start", [0.0, 0.17, 0.399, 0.41, 0.8, 1.1, 1.6])
def test_a_query_in_the_middle_of_a_span_looks_ahead_by_distance(start):
    w, h, run_up = 0.4, 0.3, 0.45
    spans = laid(ModeCall("jump", {"w": w, "h": h, "run_up": run_up}), PACE)
    points = ask(spans, 30, x=start)
    x = points.state[0, 1:, X]
    raised = (x > run_up - BLOCK_LEAD) & (x <= run_up + w + BLOCK_TAIL)
    clear = np.minimum(np.abs(x - run_up + BLOCK_LEAD), np.abs(x - run_up - w - BLOCK_TAIL)) > 1e-6
    expected = GAIT.height + np.where(raised, h, 0.0)
    np.testing.assert_allclose(points.state[0, 1:, Z][clear], expected[clear])


def test_spans_behind_the_robot_do_not_reach_into_its_set_points():
    block_behind = laid(ModeCall("jump", {"w": 0.4, "h": 0.3}), PACE)[:, 1:]
    np.testing.assert_allclose(ask(block_behind, 10, x=1.3).state[0, :, Z], GAIT.height)
    flat_behind = laid(ModeCall("jump", {"w": 0.4, "h": 0.3}), PACE)
    np.testing.assert_allclose(ask(flat_behind, 5, x=0.7).state[0, :, Z], GAIT.height + 0.3)


def test_a_query_far_down_the_track_equals_one_at_its_start():
    modes = [ModeCall("jump", {"w": 0.4, "h": 0.3}), ModeCall("leap", {"w": 0.3, "d": 0.5}), PACE]
    here, there = laid(*modes), laid(*modes)
    there[0, :-1, END] += 8192.0
    near, far = ask(here, 40, x=0.137), ask(there, 40, x=8192.137)  # no step on the edge of a hop
    far.state[..., X] -= 8192.0
    np.testing.assert_allclose(far.state, near.state, atol=1e-8)
    np.testing.assert_array_equal(far.stance, near.stance)


@pytest.mark.parametrize("length", [0.2, 0.3, 0.45, 0.8, 1.2])
def test_hops_are_half_stance_half_flight_in_whole_cycles_near_the_gaits(length):
    v, dt = 0.8, 0.001
    x0 = np.zeros((1, STATE_SIZE))
    duration = length / v
    steps = round(duration / dt)
    spans = laid(ModeCall("pace", {"v": v, "length": length}))
    stance = set_points(spans, np.array([False]), x0, np.array([steps]), dt, GAIT).stance[0]
    hops = runs(stance)
    assert [on for on, _ in hops] == [True, False] * (len(hops) // 2)
    lengths = np.array([count for _, count in hops]) * dt
    np.testing.assert_allclose(lengths, lengths.mean(), atol=2 * dt)
    cycle = 2 * lengths.mean()
    assert 0.6 * GAIT.cycle <= cycle <= 1.4 * GAIT.cycle + 2 * dt
    assert cycle * (len(hops) // 2) == pytest.approx(duration, abs=2 * dt)


def test_leap_stands_over_the_first_half_of_its_gap_and_flies_over_the_second():
    w, run_up = 0.48, 0.48  # m: ten control steps for each half gap
    points = ask(laid(ModeCall("leap", {"w": w, "d": 0.5, "run_up": run_up}), PACE), 45)
    middle = 0.5 * (points.state[0, 1:, X] + points.state[0, :-1, X])
    first = (middle > run_up) & (middle < run_up + w / 2)
    second = (middle > run_up + w / 2) & (middle < run_up + w)
    assert first.sum() == second.sum() == 10
    assert points.stance[0, first].all() and not points.stance[0, second].any()


def test_leap_asks_for_its_lift_off_velocity_and_lands_as_fast_as_it_took_off():
    w, run_up, v = 0.48, 0.48, 0.8
    points = ask(laid(ModeCall("leap", {"w": w, "d": 0.5, "run_up": run_up, "v": v}), PACE), 45)
    flight_time = 0.5 * w / v
    vz, z = points.state[0, :, VZ], points.state[0, :, Z]
    np.testing.assert_allclose(vz[:21], 0.0)  # hops have no vertical velocity
    np.testing.assert_allclose(vz[21:31], 0.5 * GRAVITY * flight_time)  # the push-off
    airborne = DT * np.arange(1, 11)
    np.testing.assert_allclose(vz[31:41], 0.5 * GRAVITY * flight_time - GRAVITY * airborne, atol=1e-9)
    np.testing.assert_allclose(vz[41:], 0.0)
    assert z.max() == pytest.approx(GAIT.height + GRAVITY * flight_time**2 / 8)
    np.testing.assert_allclose(z[[30, 40, 45]], GAIT.height)


@pytest.mark.parametrize("h", [0.75, 1.0, 1.2, 1.75, 2.5])
def test_flip_asks_for_the_lift_off_velocity_that_falls_from_its_block_in_its_flight_time(h):
    points, end = flip(h=h)
    flight_time = end - 0.5
    lift_off = points.state[0, 5, VZ]
    assert lift_off == pytest.approx(0.5 * GRAVITY * flight_time - h / flight_time)
    assert lift_off * flight_time - 0.5 * GRAVITY * flight_time**2 == pytest.approx(-h)
    on_block = DT * np.arange(points.state.shape[1]) <= 0.5
    np.testing.assert_allclose(points.state[0, on_block, VZ], lift_off)
    np.testing.assert_allclose(points.state[0, on_block, Z], GAIT.height + h)


@pytest.mark.parametrize("h", [0.75, 1.0, 1.2, 1.75, 2.5])
def test_vertical_velocity_of_a_flip_falls_with_gravity_to_its_last_knot(h):
    points, _ = flip(h=h)
    in_flight = points.state[0, DT * np.arange(points.state.shape[1]) > 0.5, VZ]
    np.testing.assert_allclose(np.diff(in_flight), -GRAVITY * DT, atol=1e-9)


@pytest.mark.parametrize("h", [0.75, 1.0, 1.2, 1.75, 2.5])
@pytest.mark.parametrize("r", ["front", "back", "left", "right"])
def test_a_flip_has_turned_once_and_come_down_at_its_last_knot(r, h):
    points, end = flip(r, h)
    last = points.state[0, points.steps[0]]
    axis = {"front": 1, "back": -1, "left": -1, "right": 1}[r]
    angle = RPY.start + (1 if r in ("front", "back") else 0)
    rate = np.abs(points.state[0, -1, OMEGA]).max()
    assert abs(points.steps[0] * DT - end) <= DT / 2 + 1e-9
    assert last[angle] == pytest.approx(axis * 2 * np.pi, abs=rate * DT)
    assert last[Z] == pytest.approx(GAIT.height, abs=h / (end - 0.5) * DT)
    horizontal = np.hypot(*(last[[X, Y]] - points.state[0, 0, [X, Y]]))
    assert horizontal == pytest.approx(points.steps[0] * DT * 1.0)


def test_angles_of_a_flip_are_the_integral_of_its_rates():
    points, _ = flip("left", 1.5)
    rate, angle = points.state[0, :, OMEGA.start], points.state[0, :, RPY.start]
    np.testing.assert_allclose(np.diff(angle), 0.5 * DT * (rate[1:] + rate[:-1]), atol=1e-12)
    ramp = DT * np.arange(17)  # the last knot before lift-off is at 0.48 s
    np.testing.assert_allclose(rate[:17], ramp / 0.5 * rate[-1], atol=1e-12)
    np.testing.assert_allclose(points.state[0, :, OMEGA.start + 1 : OMEGA.stop], 0.0)


def test_a_flip_pushes_for_half_a_second_and_then_flies():
    points, _ = flip()
    middle = DT * (np.arange(points.steps[0]) + 0.5)
    np.testing.assert_array_equal(points.stance[0], middle < 0.5)
    np.testing.assert_array_equal(points.span[0][middle < 0.5], 0)


def test_settle_stands_where_the_robot_is():
    points = ask(laid(ModeCall("settle", {})), 40, timed=True, x=1.3, y=-0.4, z=0.9)
    assert points.stance.all()
    expected = np.zeros((41, STATE_SIZE))
    expected[:, POS] = 1.3, -0.4, GAIT.height
    np.testing.assert_allclose(points.state[0], expected, atol=1e-12)


def test_a_mode_without_speed_hops_on_the_spot():
    points = ask(laid(ModeCall("pace", {"v": 0.0, "length": 1.0})), 30, x=0.5)
    np.testing.assert_allclose(points.state[0, :, X], 0.5)
    assert points.stance.any() and not points.stance.all()


def test_rows_do_not_mix():
    calls = [
        (ModeCall("jump", {"w": 0.4, "h": 0.3}), PACE),
        (ModeCall("leap", {"w": 0.3, "d": 0.5}), ModeCall("pace", {"v": 0.3, "length": 2.0})),
    ]
    spans = [laid(*c) for c in calls]
    most = max(s.shape[1] for s in spans)
    padded = np.concatenate([np.pad(s, ((0, 0), (0, most - s.shape[1]), (0, 0)), mode="edge") for s in spans])
    starts, steps = np.array([0.2, 0.6]), np.array([30, 12])
    x0 = np.zeros((2, STATE_SIZE))
    x0[:, X], x0[:, Y] = starts, 0.1
    before = padded.copy(), x0.copy()
    together = set_points(padded, np.array([False, False]), x0, steps, DT, GAIT)
    np.testing.assert_array_equal(padded, before[0])
    np.testing.assert_array_equal(x0, before[1])
    np.testing.assert_array_equal(together.steps, steps)
    for row, (start, count) in enumerate(zip(starts, steps, strict=True)):
        alone = ask(spans[row], int(count), x=start, y=0.1)
        np.testing.assert_allclose(together.state[row, : count + 1], alone.state[0], atol=1e-12)
        np.testing.assert_array_equal(together.stance[row, :count], alone.stance[0])
    assert set(padded[..., CONTACT].ravel()) <= set(Contact)


@pytest.mark.parametrize(("first", "second"), [(0.05, 0.2), (0.2, 0.05)])
def test_on_blocks_that_touch_set_points_rise_before_a_step_and_come_down_behind_it(first, second):
    blocks = [ModeCall("jump", {"w": 0.4, "h": h, "v": 0.6, "run_up": 0.0}) for h in (first, second)]
    spans = np.zeros((20, SPAN_SIZE))
    count, offset = 0, 0.0
    for call in (ModeCall("pace", {"v": 0.6, "length": 0.5}), *blocks):
        new = np.array([span_row(span, offset) for span in call.segment().spans])
        count = append_spans(spans, count, new, -1.0)
        offset += call.segment().length
    state = ask(spans[None], 75).state[0]
    x, ground = state[:, X], state[:, Z] - GAIT.height
    step = 0.9 - BLOCK_LEAD if second > first else 0.9 + BLOCK_TAIL
    margin = 0.02  # m: a control step
    for low, high, expected in ((0.5, step, first), (step, 1.3, second)):
        inside = (x > low + margin) & (x < high - margin)
        assert inside.sum() > 5
        np.testing.assert_allclose(ground[inside], expected, atol=1e-9)


def test_appending_keeps_what_is_ahead_and_never_overwrites_what_does_not_fit():
    spans = np.zeros((4, SPAN_SIZE))
    row = np.arange(SPAN_SIZE, dtype=float)
    new = np.stack([row, row + 100, row + 50])
    new[:, END] = [1.0, 2.0, 1.5]
    assert append_spans(spans, 0, new, -1.0) == 3
    np.testing.assert_array_equal(spans[:3, END], [1.0, 2.0, 2.0])  # none ends before the one in front of it
    np.testing.assert_array_equal(spans[:3, 1:], new[:, 1:])
    assert spans[3, END] == FOREVER
    assert append_spans(spans.copy(), 3, new[:1], 0.5) == -1
    assert append_spans(spans.copy(), 3, new[:1], 1.0) == -1  # the one that ended at 1.0 says where the next starts
    assert append_spans(spans, 3, np.array([[3.0, *row[1:]]]), 2.0) == 2
    np.testing.assert_array_equal(spans[:2, END], [2.0, 3.0])
