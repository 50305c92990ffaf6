"""What pictures of trainings show: the numbers on their axes, and those behind them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from helpers.figures import bars, drawn_figures
from ogmp_sb3.report.plots import trainings
from ogmp_sb3.report.plots.trainings import _between, _places, line_colours, smoothed


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    return drawn_figures(monkeypatch, trainings)


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


def objective(value: str, mean: float, low: float | None, high: float | None) -> dict[str, Any]:
    return {"objective": "return", "line": "", "value": value, "mean": mean, "low": low, "high": high}


def test_objectives_are_drawn_in_the_order_of_the_values_with_the_bound(figures: list[Figure]) -> None:
    rows = [objective("null", 5.0, 4.0, 6.0), objective("0.5", 3.0, 2.0, 4.0), objective("0.3", 2.0, 1.0, 4.0)]
    trainings.plot_objectives(rows, "rho", {"return": 10.0}, (0.3, 0.5), Path("unused"))
    axes = figures[0].axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0.3", "0.5", "off"]
    np.testing.assert_allclose(sorted(axes.lines[0].get_xydata().tolist()), [[0, 2.0], [1, 3.0], [2, 5.0]])
    np.testing.assert_allclose(sorted(bars(axes).tolist()), [[0, 1.0, 4.0], [1, 2.0, 4.0], [2, 4.0, 6.0]])
    (bound,) = (line for line in axes.lines if line.get_label() == "upper bound")
    assert set(bound.get_ydata()) == {10.0}
    assert [line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == ":"] == [0.0, 1.0]


def test_seeds_that_came_to_the_same_have_a_bar_of_no_length(figures: list[Figure]) -> None:
    mean = float(np.mean([0.05] * 3))
    assert mean != 0.05  # but a little more, by rounding
    trainings.plot_objectives([objective("0.3", mean, 0.05, 0.05)], "rho", {"return": 1.0}, None, Path("x"))
    np.testing.assert_allclose(bars(figures[0].axes[0]), [[0, 0.05, 0.05]])


def test_what_is_not_known_has_no_bar(figures: list[Figure]) -> None:
    trainings.plot_objectives([objective("lqr", 1.0, None, None)], "oracle", {"return": 1.0}, None, Path("x"))
    (lines,) = (child for child in figures[0].axes[0].get_children() if isinstance(child, LineCollection))
    assert [len(segment) for segment in lines.get_segments()] == [0]
    np.testing.assert_allclose(figures[0].axes[0].lines[0].get_xydata(), [[0, 1.0]])


def test_a_band_is_drawn_from_three_seeds_on_and_single_trainings_are_thin(figures: list[Figure]) -> None:
    rows = [
        {"panel": "", "line": line, "samples": samples, "seeds": seeds, "mean": 5.0 + samples / 1e6, "low": -90.0,
         "high": 90.0}
        for line, seeds in (("0.3", 3), ("0.5", 2))
        for samples in (1e6, 2e6)
    ]  # fmt: skip
    seeds = [{"panel": "", "line": "0.3", "seed": seed, "samples": 1e6, "return": 4.0 + seed} for seed in range(3)]
    trainings.plot_sweep_curves(rows, "rho", Path("unused"), seeds)
    (axes,) = figures[0].axes
    assert [line.get_linewidth() for line in axes.lines] == [1.6, 0.5, 0.5, 0.5, 1.6]
    three, two = (band.get_paths() for band in axes.collections)
    assert {*three[0].vertices[:, 1]} == {-90.0, 90.0} and not any(len(path.vertices) for path in two)
    assert 3.0 < axes.get_ylim()[0] and axes.get_ylim()[1] < 8.0  # the lines, not the band


def test_curves_have_a_panel_and_a_line_for_each_job_that_has_begun(figures: list[Figure]) -> None:
    begun = [("oracle = lqr", "0.3"), ("oracle = preview", "0.3"), ("oracle = preview", "null")]
    rows = [
        {"panel": panel, "line": line, "samples": samples, "mean": i + samples / 1e6, "low": 0.5, "high": 1.5}
        for i, (panel, line) in enumerate(begun)
        for samples in (1_000_000, 2_000_000)
    ]
    trainings.plot_sweep_curves(rows, "rho", Path("unused"))
    lqr, preview = figures[0].axes
    assert (lqr.get_title(), preview.get_title()) == ("oracle = lqr", "oracle = preview")
    assert [line.get_label() for line in lqr.lines] == ["rho = 0.3"]
    assert [(line.get_label(), line.get_linestyle()) for line in preview.lines] == [
        ("rho = 0.3", "-"),
        ("rho = null", "--"),
    ]
    np.testing.assert_allclose(preview.lines[0].get_xdata(), [1e6, 2e6])
    assert preview.xaxis.get_major_formatter()(1_500_000) == "1.5M"
    np.testing.assert_allclose(preview.lines[0].get_ydata(), trainings.smoothed(np.array([2.0, 3.0])))
