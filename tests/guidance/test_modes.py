"""What each mode asks for: terrain, spans, and which way a flip turns."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ogmp_sb3.guidance.modes import BLOCK_LEAD, BLOCK_TAIL, FLIP_STANCE, Contact, flip, jump, leap, pace, settle
from ogmp_sb3.guidance.srb import GRAVITY

TRACK_MODES = {
    "pace": pace(v=0.7, length=0.9),
    "jump": jump(w=0.4, h=0.25, v=0.7, run_up=0.5),
    "leap": leap(w=0.3, d=0.6, v=0.7, run_up=0.4),
}
HEIGHTS = [0.0, 0.75, 1.0, 1.75, 3.0]  # m
HEADINGS = {"front": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}  # x forward, y left


@pytest.mark.parametrize("name", TRACK_MODES)
def test_plateaus_cover_the_length_of_the_mode_without_holes(name):
    segment = TRACK_MODES[name]
    assert segment.plateaus[0].start == 0.0
    assert segment.plateaus[-1].end == segment.length
    for before, after in pairwise(segment.plateaus):
        assert before.end == after.start


@pytest.mark.parametrize("name", TRACK_MODES)
def test_spans_follow_each_other_past_the_end_at_the_asked_speed(name):
    segment = TRACK_MODES[name]
    ends = [span.end for span in segment.spans]
    assert ends == sorted(ends) and ends[-1] >= segment.length
    assert all(span.velocity == (0.7, 0.0) for span in segment.spans)
    assert not segment.timed and segment.start_height == 0.0


def test_pace_is_flat_ground_crossed_in_hops():
    segment = pace(v=0.7, length=0.9)
    assert [(p.start, p.end, p.top) for p in segment.plateaus] == [(0.0, 0.9, 0.0)]
    (span,) = segment.spans
    assert (span.end, span.ground, span.contact, span.apex) == (0.9, (0.0, 0.0), Contact.HOP, 0.0)


def test_jump_has_its_block_behind_the_run_up_and_set_points_that_clear_its_edges():
    w, h, run_up = 0.4, 0.25, 0.5
    segment = jump(w=w, h=h, run_up=run_up)
    assert segment.length == pytest.approx(run_up + w)
    flat, block = segment.plateaus
    assert (flat.start, flat.end, flat.top) == (0.0, run_up, 0.0)
    assert (block.start, block.top, block.end - block.start) == (run_up, h, pytest.approx(w))
    approach, over = segment.spans
    assert approach.ground == (0.0, 0.0) and approach.end == pytest.approx(run_up - BLOCK_LEAD)
    assert over.ground == (h, h) and over.end == pytest.approx(run_up + w + BLOCK_TAIL)


def test_leap_has_its_gap_behind_the_run_up_and_flies_over_the_second_half():
    w, d, run_up, v = 0.3, 0.6, 0.4, 0.7
    segment = leap(w=w, d=d, v=v, run_up=run_up)
    flat, gap = segment.plateaus
    assert (flat.start, flat.end, flat.top) == (0.0, run_up, 0.0)
    assert (gap.start, gap.top, gap.end - gap.start) == (run_up, -d, pytest.approx(w))
    assert [span.contact for span in segment.spans] == [Contact.HOP, Contact.STANCE, Contact.FLIGHT]
    assert [span.end for span in segment.spans] == pytest.approx([run_up, run_up + w / 2, run_up + w])
    assert all(span.ground == (0.0, 0.0) for span in segment.spans)  # across the gap, not into it


def test_leap_rises_as_high_as_a_throw_of_its_flight_time():
    w, v = 0.3, 0.7
    time_of_flight = 0.5 * w / v
    lift_off = GRAVITY * time_of_flight / 2
    highest = lift_off**2 / (2 * GRAVITY)
    assert leap(w=w, d=0.5, v=v).spans[-1].apex == pytest.approx(highest)


@pytest.mark.parametrize("h", HEIGHTS)
@pytest.mark.parametrize("r", HEADINGS)
def test_flip_turns_the_head_towards_where_it_moves(r, h):
    for span in flip(r=r, h=h).spans:
        np.testing.assert_array_equal(np.sign(span.velocity), HEADINGS[r])
        roll_rate, pitch_rate = span.rates[1]
        head = Rotation.from_rotvec([0.1 * roll_rate, 0.1 * pitch_rate, 0.0]).apply([0.0, 0.0, 1.0])
        assert head[:2] @ np.array(HEADINGS[r]) > 0.1
        assert head[:2] @ np.array(HEADINGS[r][::-1]) == pytest.approx(0.0, abs=1e-12)


def test_front_flip_pitches_forwards_and_right_flip_rolls_to_the_right():
    signs = {r: tuple(np.sign(flip(r=r, h=1.0).spans[-1].rates[1])) for r in HEADINGS}
    assert signs == {"front": (0, 1), "back": (0, -1), "right": (1, 0), "left": (-1, 0)}


@pytest.mark.parametrize("h", HEIGHTS)
@pytest.mark.parametrize("r", HEADINGS)
def test_flip_is_one_full_turn(r, h):
    segment = flip(r=r, h=h)
    assert segment.timed
    starts = [0.0] + [span.end for span in segment.spans[:-1]]
    turned = sum(
        0.5 * (np.array(span.rates[0]) + np.array(span.rates[1])) * (span.end - start)
        for span, start in zip(segment.spans, starts, strict=True)
    )
    assert np.abs(turned).max() == pytest.approx(2 * np.pi)
    assert np.abs(turned).min() == 0.0
    assert segment.spans[0].rates[1] == segment.spans[1].rates[0]  # no jump at lift-off


@pytest.mark.parametrize("h", HEIGHTS)
def test_flip_flies_as_long_as_a_fall_from_its_block_unless_that_is_too_short(h):
    push, fly = flip(r="front", h=h).spans
    flight_time, fall_time = fly.end - push.end, np.sqrt(2 * h / GRAVITY)
    assert push.end == FLIP_STANCE
    assert flight_time == pytest.approx(max(fall_time, 2 * np.pi / 8.95 - 0.25))
    assert (push.contact, fly.contact) == (Contact.STANCE, Contact.FLIGHT)


def test_flip_starts_on_its_block_and_comes_down_to_the_ground():
    segment = flip(r="left", h=1.5)
    ground, block = segment.plateaus
    assert segment.start_height == block.top == 1.5 and ground.top == 0.0
    assert block.start < 0.0 < block.end < ground.end
    assert block.half_width == pytest.approx((block.end - block.start) / 2)  # a square
    push, fly = segment.spans
    assert (push.ground, fly.ground) == ((1.5, 1.5), (1.5, 0.0))


def test_settle_stands_still():
    segment = settle()
    (span,) = segment.spans
    assert segment.timed and segment.plateaus == ()
    assert (span.contact, span.velocity, span.ground, span.apex) == (Contact.STANCE, (0.0, 0.0), (0.0, 0.0), 0.0)
    assert span.rates == ((0.0, 0.0), (0.0, 0.0)) and span.end > 0
