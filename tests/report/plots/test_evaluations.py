"""What pictures of evaluations show: the numbers on their axes, read off the figure before it is written."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from helpers.figures import bars, drawn_figures
from ogmp_sb3.evaluation.speed import SpeedRow
from ogmp_sb3.evaluation.statistics import Estimate
from ogmp_sb3.report.plots import evaluations


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    return drawn_figures(monkeypatch, evaluations)


def estimate(mean: float, low: float, high: float) -> dict[str, Any]:
    return {"mean": mean, "ci95": [low, high], "n": 3}


def test_a_heat_map_has_the_first_parameter_to_the_right_and_the_second_upwards(figures: list[Figure]) -> None:
    cells = [
        {"w": list(w), "h": list(h), "metrics": {"return": estimate(10 * w[0] + h[0], 0, 0)}}
        for w in itertools.pairwise([0.1, 0.2, 0.3, 0.4])
        for h in itertools.pairwise([0.0, 1.0, 2.0])
    ]
    grid = {"mode": "jump", "axes": ["w", "h"], "trained": {"w": [0.15, 0.25], "h": [0.5, 0.75]}, "cells": cells}
    evaluations.plot_grids([grid], "return", Path("unused"))
    axes = figures[0].axes[0]
    (mesh,) = (child for child in axes.get_children() if isinstance(child, QuadMesh))
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title()) == ("w", "h", "jump")
    np.testing.assert_allclose(mesh.get_array(), [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]])  # one row for each h
    np.testing.assert_allclose(mesh.get_coordinates()[0, :, 0], [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(mesh.get_coordinates()[:, 0, 1], [0.0, 1.0, 2.0])
    (outline,) = (patch for patch in axes.patches if isinstance(patch, Rectangle))
    np.testing.assert_allclose([*outline.get_xy(), outline.get_width(), outline.get_height()], [0.15, 0.5, 0.1, 0.25])


def test_robustness_is_drawn_over_the_size_with_its_interval(figures: list[Figure]) -> None:
    points = [{"value": value, "no_fall_fraction": estimate(0.5, 0.25, 0.625)} for value in (0.8, 1.0, 1.2)]
    points[1]["no_fall_fraction"] = estimate(1.0, 0.9, 1.0)
    result = {"disturbance": "mass", "label": "factor on mass", "declared": [0.9, 1.1], "points": points}
    evaluations.plot_robustness([result], Path("unused"))
    axes = figures[0].axes[0]
    np.testing.assert_allclose(axes.lines[0].get_xydata(), [[0.8, 0.5], [1.0, 1.0], [1.2, 0.5]])
    np.testing.assert_allclose(bars(axes), [[0.8, 0.25, 0.625], [1.0, 0.9, 1.0], [1.2, 0.25, 0.625]])
    assert axes.get_xlabel() == "factor on mass"


def test_speeds_are_drawn_over_the_command_in_bands_with_their_intervals(figures: list[Figure]) -> None:
    def row(mode: str, band: tuple[float, float] | None, commanded: float, measured: float, half: float) -> SpeedRow:
        command = Estimate(commanded, 0.0, 9, None, None)
        return SpeedRow(mode, band, command, Estimate(measured, 0.1, 9, measured - half, measured + half), command)

    speeds = [row("jump", None, 1.2, 1.25, 0.125), row("pace", None, 1.0, 9.0, 0.0)]
    speeds += [row("pace", (0.6, 0.8), 0.7, 0.9, 0.25), row("pace", (1.6, 1.8), 1.7, 1.2, 0.5)]
    evaluations.plot_speeds(speeds, Path("unused"))
    (axes,) = figures[0].axes
    assert [[0.7, 0.9], [1.7, 1.2]] in [line.get_xydata().tolist() for line in axes.lines]
    np.testing.assert_allclose(bars(axes), [[1.2, 1.125, 1.375], [0.7, 0.65, 1.15], [1.7, 0.7, 1.7]])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("commanded (m/s)", "measured (m/s)")


def test_shares_of_whole_episodes_are_drawn_over_the_bound_for_each_oracle(figures: list[Figure]) -> None:
    within = [{"rho": rho, **estimate(share, share - 0.125, share)} for rho, share in ((0.1, 0.25), (0.2, 1.0))]
    maxima = {"lqr": {"all": {"within": within}, "pace": {"within": []}}}
    trained = {"oracle": "lqr", "rho": 0.15}
    evaluations.plot_epsilon({"maxima": maxima, "episodes": 8, "trained_with": trained}, Path("unused"))
    (axes,) = figures[0].axes
    np.testing.assert_allclose(bars(axes), [[0.1, 0.125, 0.25], [0.2, 0.875, 1.0]])
    assert axes.get_title() == "n = 8"
    assert axes.get_legend().get_texts()[0].get_text() == "trained with ρ = 0.15"
