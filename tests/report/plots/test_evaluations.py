"""What pictures show: the numbers on their axes, read off the figure before it is written."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from ogmp_sb3.report.plots import evaluations as plotting
from ogmp_sb3.report.plots import trainings as plotting_training


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are drawn, in place of files."""
    drawn: list[Figure] = []
    for module in (plotting, plotting_training):
        monkeypatch.setattr(module, "save", lambda figure, path: drawn.append(figure))
    return drawn


def summary(mean: float, low: float, high: float) -> dict[str, Any]:
    return {"mean": mean, "ci95": [low, high], "n": 3}


def test_a_heat_map_has_the_first_parameter_to_the_right_and_the_second_upwards(figures: list[Figure]) -> None:
    cells = [
        {"w": list(w), "h": list(h), "metrics": {"return": summary(10 * w[0] + h[0], 0, 0)}}
        for w in itertools.pairwise([0.1, 0.2, 0.3, 0.4])
        for h in itertools.pairwise([0.0, 1.0, 2.0])
    ]
    grid = {"mode": "jump", "axes": ["w", "h"], "trained": {"w": [0.15, 0.25], "h": [0.5, 0.75]}, "cells": cells}
    plotting.plot_grids([grid], "return", Path("unused"))
    axes = figures[0].axes[0]
    (mesh,) = (child for child in axes.get_children() if isinstance(child, QuadMesh))
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title()) == ("w", "h", "jump")
    np.testing.assert_allclose(mesh.get_array(), [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]])  # one row for each h
    np.testing.assert_allclose(mesh.get_coordinates()[0, :, 0], [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(mesh.get_coordinates()[:, 0, 1], [0.0, 1.0, 2.0])
    (outline,) = (patch for patch in axes.patches if isinstance(patch, Rectangle))
    np.testing.assert_allclose([*outline.get_xy(), outline.get_width(), outline.get_height()], [0.15, 0.5, 0.1, 0.25])


def bars(axes: Any) -> np.ndarray:
    """The ends of error bars: x, low and high of each, shape (bars, 3)."""
    (lines,) = (child for child in axes.get_children() if isinstance(child, LineCollection))
    return np.array([[ends[0][0], ends[0][1], ends[1][1]] for ends in lines.get_segments()])


def test_robustness_is_drawn_over_the_size_with_its_interval(figures: list[Figure]) -> None:
    points = [{"value": value, "no_fall_fraction": summary(0.5, 0.25, 0.625)} for value in (0.8, 1.0, 1.2)]
    points[1]["no_fall_fraction"] = summary(1.0, 0.9, 1.0)
    result = {"disturbance": "mass", "label": "factor on mass", "declared": [0.9, 1.1], "points": points}
    plotting.plot_robustness([result], Path("unused"))
    axes = figures[0].axes[0]
    np.testing.assert_allclose(axes.lines[0].get_xydata(), [[0.8, 0.5], [1.0, 1.0], [1.2, 0.5]])
    np.testing.assert_allclose(bars(axes), [[0.8, 0.25, 0.625], [1.0, 0.9, 1.0], [1.2, 0.25, 0.625]])
    assert axes.get_xlabel() == "factor on mass"


def objective(value: str, mean: float, low: float | None, high: float | None) -> dict[str, Any]:
    return {"objective": "return", "line": "", "value": value, "mean": mean, "low": low, "high": high}


def test_objectives_are_drawn_in_the_order_of_the_values_with_the_bound(figures: list[Figure]) -> None:
    rows = [objective("null", 5.0, 4.0, 6.0), objective("0.5", 3.0, 2.0, 4.0), objective("0.3", 2.0, 1.0, 4.0)]
    plotting_training.plot_objectives(rows, "rho", {"return": 10.0}, (0.3, 0.5), Path("unused"))
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
    plotting_training.plot_objectives([objective("0.3", mean, 0.05, 0.05)], "rho", {"return": 1.0}, None, Path("x"))
    np.testing.assert_allclose(bars(figures[0].axes[0]), [[0, 0.05, 0.05]])


def test_what_is_not_known_has_no_bar(figures: list[Figure]) -> None:
    plotting_training.plot_objectives([objective("lqr", 1.0, None, None)], "oracle", {"return": 1.0}, None, Path("x"))
    (lines,) = (child for child in figures[0].axes[0].get_children() if isinstance(child, LineCollection))
    assert [len(segment) for segment in lines.get_segments()] == [0]
    np.testing.assert_allclose(figures[0].axes[0].lines[0].get_xydata(), [[0, 1.0]])


def test_curves_have_a_panel_and_a_line_for_each_job_that_has_begun(figures: list[Figure]) -> None:
    begun = [("oracle = lqr", "0.3"), ("oracle = preview", "0.3"), ("oracle = preview", "null")]
    rows = [
        {"panel": panel, "line": line, "samples": samples, "mean": i + samples / 1e6, "low": 0.5, "high": 1.5}
        for i, (panel, line) in enumerate(begun)
        for samples in (1_000_000, 2_000_000)
    ]
    plotting_training.plot_sweep_curves(rows, "rho", Path("unused"))
    lqr, preview = figures[0].axes
    assert (lqr.get_title(), preview.get_title()) == ("oracle = lqr", "oracle = preview")
    assert [line.get_label() for line in lqr.lines] == ["rho = 0.3"]
    assert [(line.get_label(), line.get_linestyle()) for line in preview.lines] == [
        ("rho = 0.3", "-"),
        ("rho = null", "--"),
    ]
    np.testing.assert_allclose(preview.lines[0].get_xdata(), [1.0, 2.0])
    np.testing.assert_allclose(preview.lines[0].get_ydata(), plotting_training.smoothed(np.array([2.0, 3.0])))


def test_a_picture_is_written_as_png_and_as_svg(tmp_path: Path) -> None:
    plotting_training.plot_objectives([objective("0.3", 1.0, 0.5, 1.5)], "rho", {"return": 2.0}, None, tmp_path / "a")
    with Image.open(tmp_path / "a.png") as image:
        assert image.width > image.height > 300
    assert (tmp_path / "a.svg").read_text().rstrip().endswith("</svg>")
