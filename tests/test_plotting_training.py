"""The numbers behind pictures of trainings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from ogmp_sb3.plotting_training import (
    _between,
    _places,
    line_colours,
    plot_objectives,
    plot_sweep_curves,
    smoothed,
)


def test_smoothing_is_a_mean_over_the_rows_around_that_are_known() -> None:
    values = np.array([1.0, 2.0, np.nan, 4.0, 9.0])
    np.testing.assert_allclose(smoothed(values, 3), [1.5, 1.5, 3.0, 6.5, 6.5])
    np.testing.assert_array_equal(smoothed(np.full(3, np.nan)), [np.nan] * 3)
    np.testing.assert_array_equal(smoothed(np.array([7.0])), [7.0])


def test_no_bound_is_black_and_all_other_lines_differ() -> None:
    colours = line_colours(["0.3", "0.5", "null", "0.3", "0.8"])
    assert colours["null"] == "black"
    assert len({str(colour) for colour in colours.values()}) == 4


def test_curves_are_drawn_of_the_jobs_that_have_begun(tmp_path: Path) -> None:
    begun = [("oracle = lqr", "0.3"), ("oracle = preview", "0.3"), ("oracle = preview", "0.5")]
    rows = [
        {"panel": panel, "line": line, "samples": samples, "mean": 1.0, "low": 0.5, "high": 1.5}
        for panel, line in begun
        for samples in (100, 200)
    ]
    plot_sweep_curves(rows, "rho", tmp_path / "curves")
    with Image.open(tmp_path / "curves.png") as image:
        assert image.width > 300


def test_objectives_are_drawn_for_numbers_words_and_no_value(tmp_path: Path) -> None:
    low = float(np.mean([0.05] * 3))  # a little more than 0.05
    ends: list[dict[str, float | None]] = [{"low": 2.0, "high": 4.0}, {"low": low, "high": 0.05}]
    ends.append({"low": None, "high": None})
    for i, values in enumerate((["0.3", "0.5", "null"], ["lqr", "linear"], ["null"])):
        rows = [{"objective": "return", "line": "", "value": v, "mean": 3.0, **ends[i]} for v in values]
        plot_objectives(rows, "rho", {"return": 10.0}, (0.5, 1.0) if i == 0 else None, tmp_path / f"picture{i}")
        with Image.open(tmp_path / f"picture{i}.png") as image:
            assert image.width > 300
        assert (tmp_path / f"picture{i}.svg").read_text().rstrip().endswith("</svg>")


def test_values_stand_side_by_side_numbers_by_size_and_no_value_last() -> None:
    assert list(_places(["0.5", "null", "0.05", "0.1"]).items()) == [("0.05", 0), ("0.1", 1), ("0.5", 2), ("null", 3)]
    assert list(_places(["no height_scan", "no clock", "unchanged"])) == ["no height_scan", "no clock", "unchanged"]


def test_a_mark_stands_between_the_values_around_it() -> None:
    places = _places(["0.1", "0.5", "null"])
    np.testing.assert_allclose(_between(places, (0.3, 1.6)), [0.5, 1.5])
    np.testing.assert_allclose(_between(places, (0.05, 0.5)), [-0.25, 1.0])
