"""What pictures of falls and of survival show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from helpers.figures import bars, drawn_figures
from ogmp_sb3.evaluation.falls import BEFORE, FallRow
from ogmp_sb3.evaluation.statistics import Estimate
from ogmp_sb3.evaluation.survival import survival_curve
from ogmp_sb3.report.plots import falls


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    return drawn_figures(monkeypatch, falls)


def test_rates_have_a_panel_for_the_modes_and_for_each_way_to_tell_instances_apart(figures: list[Figure]) -> None:
    half = Estimate(0.5, 0.5, 8, 0.25, 0.75)
    rows = [
        FallRow("jump", "", None, 4, 2, half),
        FallRow("jump", "h", (0.2, 0.3), 0, 1, Estimate(0.0, 0.0, 4, 0.0, 0.5)),
        FallRow("jump", "h", (0.3, 0.4), 4, 0, Estimate(1.0, 0.0, 4, 0.5, 1.0)),
        FallRow("jump", BEFORE, "pace", 4, 2, half),
        FallRow("leap", "", None, 0, 0, Estimate(0.0, 0.0, 8, 0.0, 0.3)),
    ]
    falls.plot_falls(rows, Path("unused"))
    panels = [axes for axes in figures[0].axes if axes.get_title()]
    assert [axes.get_title() for axes in panels] == ["by mode", "jump, by h", "jump, by mode before"]
    np.testing.assert_allclose(bars(panels[0]), [[0, 0.25, 0.75], [1, 0.0, 0.3]])
    np.testing.assert_allclose(bars(panels[1]), [[0, 0.0, 0.5], [1, 0.5, 1.0]])
    circles = [line.get_ydata()[0] for line in panels[0].lines if line.get_markersize() == 7]
    assert circles == [0.5 + 2 / 8, 0.0]
    labels = [label.get_text() for label in panels[1].get_xticklabels()]
    assert labels == ["0.20 to 0.30\n0 of 4", "0.30 to 0.40\n4 of 4"]
    assert len({axes.get_ylim() for axes in panels}) == 1  # to be compared


def test_a_survival_curve_begins_at_one_and_steps_down_at_each_fall(figures: list[Figure]) -> None:
    curve = survival_curve([10.0, 20.0, 30.0, 40.0], [True, False, True, False])
    falls.plot_survival({"distance_m": curve}, {"distance_m": "m"}, Path("unused"))
    (axes,) = figures[0].axes
    line, ticks, median = axes.lines
    np.testing.assert_allclose(line.get_xydata(), [[0, 1], [10, 0.75], [20, 0.75], [30, 0.375], [40, 0.375]])
    assert line.get_drawstyle() == "steps-post"
    np.testing.assert_allclose(ticks.get_xdata(), [20.0, 40.0])  # censored
    np.testing.assert_allclose(median.get_xdata(), [0.0, 30.0, 30.0])
    assert axes.get_xlabel() == "m"
