"""What pictures of motion traces show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from helpers.figures import drawn_figures
from ogmp_sb3.evaluation.traces import Ground, Trace
from ogmp_sb3.report.plots import traces

STEPS = 6
WAY = np.stack([np.linspace(0.0, 4.0, STEPS + 1), np.full(STEPS + 1, 0.5)], axis=1)
TRACE = Trace(
    title="seed 0",
    axis=0,
    base=WAY,
    up=np.tile([0.0, 1.0], (STEPS + 1, 1)),
    references=[WAY[1:4] + 0.1, WAY[4:] + 0.2],
    deviation=np.linspace(0.0, 0.3, STEPS + 1),
    ground=[Ground("pace", 0.0, 2.0, 0.0), Ground("jump", 2.0, 5.0, 0.2)],
    ended="fall",
    rho=0.25,
    half_band=None,
)


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    return drawn_figures(monkeypatch, traces)


def test_a_trace_shows_base_references_ground_and_below_the_deviation_with_its_bound(figures: list[Figure]) -> None:
    traces.plot_traces([TRACE], Path("unused"))
    above, below = figures[0].axes
    lines = {}
    for line in above.lines:
        lines.setdefault(line.get_label(), []).append(line.get_xydata())
    np.testing.assert_allclose(lines["base"], [WAY])
    for drawn, reference in zip(lines["reference"], TRACE.references, strict=True):
        np.testing.assert_allclose(drawn, reference)
    np.testing.assert_allclose(np.concatenate(lines["query"]), [WAY[0], WAY[3]])
    np.testing.assert_allclose(lines["jump"], [[[2.0, 0.2], [5.0, 0.2]]])
    assert [text.get_text() for text in above.texts] == ["fall"]
    np.testing.assert_allclose(below.lines[0].get_ydata(), TRACE.deviation)
    assert set(below.lines[1].get_ydata()) == {0.25}


def test_long_traces_stand_below_each_other_and_short_ones_side_by_side(figures: list[Figure]) -> None:
    short = replace(TRACE, base=0.1 * WAY, references=[0.1 * part for part in TRACE.references])
    traces.plot_traces([TRACE] * 2, Path("unused"))
    traces.plot_traces([short] * 2, Path("unused"))
    columns = [figure.axes[0].get_subplotspec().get_gridspec().ncols for figure in figures]
    assert columns == [1, 2]


def test_along_a_track_motion_and_deviation_have_one_axis(figures: list[Figure]) -> None:
    traces.plot_traces([TRACE], Path("unused"))
    above, below = figures[0].axes
    np.testing.assert_allclose(below.lines[0].get_xdata(), WAY[:, 0])
    assert below.get_xlim() == above.get_xlim()
    assert (above.get_xlabel(), below.get_xlabel()) == ("", "x (m)")


def test_below_a_short_motion_is_its_deviation_over_time(figures: list[Figure]) -> None:
    traces.plot_traces([replace(TRACE, base=0.1 * WAY, references=[])], Path("unused"))
    above, below = figures[0].axes
    np.testing.assert_allclose(below.lines[0].get_xdata(), np.arange(STEPS + 1))
    assert (above.get_xlabel(), below.get_xlabel()) == ("x (m)", "control step")


def test_the_band_of_the_bound_is_drawn_where_it_bounds_the_height(figures: list[Figure]) -> None:
    traces.plot_traces([replace(TRACE, half_band=0.1)], Path("unused"))
    assert "within ρ" in [area.get_label() for area in figures[0].axes[0].collections]
