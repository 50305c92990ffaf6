"""Termination terms on views made by hand."""

import numpy as np
import pytest

from helpers.views import make_view
from ogmp_sb3.env.terminations import fall, off_track
from ogmp_sb3.guidance.terrain import NOTHING


def heights(*above_zero: float) -> np.ndarray:
    return np.array([[0.0, 0.0, z] for z in above_zero])


def test_a_base_below_the_least_height_has_fallen() -> None:
    view = make_view(3, base_pos_w=heights(0.31, 0.29, -1.0))
    np.testing.assert_array_equal(fall(view, min_height=0.3), [False, True, True])


def test_a_fall_is_measured_from_the_ground_under_the_base() -> None:
    view = make_view(3, base_pos_w=heights(0.6, 0.5, 0.31), ground_height=np.array([0.25, 0.25, 0.0]))
    np.testing.assert_array_equal(fall(view, min_height=0.3), [False, True, False])


def test_over_a_gap_a_fall_is_measured_from_the_track_unless_told_otherwise() -> None:
    """0.25 m over the track's surface is too low although it is 0.75 m over the gap's bottom."""
    view = make_view(2, base_pos_w=heights(0.25, 0.35), ground_height=np.array([-0.5, -0.5]))
    np.testing.assert_array_equal(fall(view, min_height=0.3), [True, False])
    np.testing.assert_array_equal(fall(view, min_height=0.3, fill_gaps=False), [False, False])


def test_a_robot_beside_the_track_has_left_it_and_one_over_a_gap_has_not() -> None:
    view = make_view(3, ground_height=np.array([NOTHING, -12.0, 0.3]))
    np.testing.assert_array_equal(off_track(view), [True, False, False])


@pytest.mark.parametrize("term", [lambda v: fall(v, 0.3), off_track])
def test_a_termination_is_one_truth_for_each_row(term: object) -> None:
    found = term(make_view(5))  # type: ignore[operator]
    assert found.shape == (5,)
    assert found.dtype == bool
