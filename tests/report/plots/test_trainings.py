"""The numbers behind pictures of trainings."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.report.plots.trainings import _between, _places, line_colours, smoothed


def test_smoothing_is_a_mean_over_the_rows_around_that_are_known() -> None:
    values = np.array([1.0, 2.0, np.nan, 4.0, 9.0])
    np.testing.assert_allclose(smoothed(values, 3), [1.5, 1.5, 3.0, 6.5, 6.5])
    np.testing.assert_array_equal(smoothed(np.full(3, np.nan)), [np.nan] * 3)
    np.testing.assert_array_equal(smoothed(np.array([7.0])), [7.0])


def test_no_bound_is_black_and_all_other_lines_differ() -> None:
    colours = line_colours(["0.3", "0.5", "null", "0.3", "0.8"])
    assert colours["null"] == "black"
    assert len({str(colour) for colour in colours.values()}) == 4


def test_values_stand_side_by_side_numbers_by_size_and_no_value_last() -> None:
    assert list(_places(["0.5", "null", "0.05", "0.1"]).items()) == [("0.05", 0), ("0.1", 1), ("0.5", 2), ("null", 3)]
    assert list(_places(["no height_scan", "no clock", "unchanged"])) == ["no height_scan", "no clock", "unchanged"]


def test_a_mark_stands_between_the_values_around_it() -> None:
    places = _places(["0.1", "0.5", "null"])
    np.testing.assert_allclose(_between(places, (0.3, 1.6)), [0.5, 1.5])
    np.testing.assert_allclose(_between(places, (0.05, 0.5)), [-0.25, 1.0])
