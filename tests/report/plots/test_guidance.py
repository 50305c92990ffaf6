"""What pictures of the guidance show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from helpers.figures import drawn_figures
from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.report.plots import guidance


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    return drawn_figures(monkeypatch, guidance)


def states(**columns: list[float]) -> np.ndarray:
    """States of which some components differ from 0."""
    rows = len(next(iter(columns.values())))
    return np.stack([np.array(columns.get(name, [0.0] * rows)) for name in STATE_NAMES], axis=1)


def test_references_are_heights_over_time_with_the_set_points(figures: list[Figure]) -> None:
    references = {"lqr": states(z=[0.5, 0.6, 0.7]), "mine": states(z=[0.5, 0.4, 0.3])}
    panel = ("jump", np.array([True, False]), states(z=[0.5, 0.5, 0.8]), references)
    guidance.plot_references([panel], 0.03, Path("unused"))
    (axes,) = figures[0].axes
    lines = {line.get_label(): line for line in axes.lines}
    assert list(lines) == ["set-points", "lqr", "mine"]
    np.testing.assert_allclose(lines["lqr"].get_xydata(), [[0.0, 0.5], [0.03, 0.6], [0.06, 0.7]])
    assert len(axes.patches) == 1  # one step in stance


def test_a_mode_that_turns_the_base_is_shown_with_angle_and_rate(figures: list[Figure]) -> None:
    turning, standing = states(z=[1.0, 0.5], pitch=[0.0, 3.0], wy=[9.0, 8.0]), states(z=[0.5, 0.5])
    panels = [(name, np.array([True]), each, {"lqr": each}) for name, each in (("flip", turning), ("settle", standing))]
    guidance.plot_references(panels, 0.03, Path("unused"))
    shown = [(axes.get_title(), axes.get_ylabel()) for axes in figures[0].axes if axes.get_title()]
    height = "base height (m)"
    assert shown == [("flip", height), ("flip", "pitch (rad)"), ("flip", "pitch rate (rad/s)"), ("settle", height)]
    low, high = next(axes for axes in figures[0].axes if axes.get_title() == "settle").get_ylim()
    assert (low, high) == pytest.approx((0.45, 0.55), abs=0.03)  # at rest, and looks it
    drawn = [figures[0].axes[place].lines[1].get_ydata().tolist() for place in (1, 2)]
    assert drawn == [[0.0, 3.0], [9.0, 8.0]]


def test_all_that_moves_is_shown_and_rounding_noise_is_not(figures: list[Figure]) -> None:
    noise = [0.0, 1e-15, 0.0]
    moving = states(
        z=[0.5, 0.5, 0.5], y=[0.0, 0.1, 0.2], roll=[0.0, -3.0, -6.0], vy=[0.0, 1.0, 1.0], wx=[0.0, -8.0, -8.0]
    )
    still = states(z=[0.5, 0.5 + 1e-12, 0.5], x=noise, yaw=noise, vx=noise)
    panels = [("left", np.array([True, False]), still, {"lqr": moving}), ("stand", np.array([True, True]), still, {})]
    guidance.plot_references(panels, 0.03, Path("unused"))
    shown = [(axes.get_title(), axes.get_ylabel()) for axes in figures[0].axes if axes.get_title()]
    labels = ["base height (m)", "y, sideways (m)", "roll (rad)", "vy (m/s)", "roll rate (rad/s)"]
    assert shown == [*(("left", label) for label in labels), ("stand", "base height (m)")]
    low, high = figures[0].axes[5].get_ylim()
    assert high - low >= 0.1 and high - 0.5 == pytest.approx(0.5 - low)  # a flat line in the middle


def test_what_moves_in_the_set_points_alone_is_shown(figures: list[Figure]) -> None:
    panel = ("turn", np.array([True]), states(z=[0.5, 0.5], wz=[0.0, 1.0]), {"lqr": states(z=[0.5, 0.5])})
    guidance.plot_references([panel], 0.03, Path("unused"))
    assert [axes.get_ylabel() for axes in figures[0].axes] == ["base height (m)", "yaw rate (rad/s)"]


def test_latents_have_a_panel_for_all_modes_and_one_for_each_parameter_that_varies(figures: list[Figure]) -> None:
    calls = [ModeCall("jump", {"w": 0.3, "h": h}) for h in (0.1, 0.2)]
    calls += [ModeCall("flip", {"r": word}) for word in ("left", "front", "left")]
    latents = np.arange(10.0).reshape(5, 2)
    guidance.plot_latents(latents, calls, Path("unused"))
    panels = [axes for axes in figures[0].axes if axes.get_title()]  # the others are bars of colours
    assert [axes.get_title() for axes in panels] == ["all modes", "jump: h", "flip: r (front, left)"]
    both, jump, flip = panels
    np.testing.assert_allclose([marks.get_offsets().tolist() for marks in both.collections[:1]], [latents[:2].tolist()])
    np.testing.assert_allclose(both.collections[1].get_offsets(), latents[2:])
    np.testing.assert_allclose(jump.collections[0].get_array(), [0.1, 0.2])
    np.testing.assert_allclose(flip.collections[0].get_array(), [1, 0, 1])


def test_a_latent_of_more_numbers_is_drawn_by_its_two_principal_components(figures: list[Figure]) -> None:
    rng = np.random.default_rng(0)
    spread = rng.normal(size=(40, 2)) * [3.0, 1.0]
    turned = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    latents = np.pad(spread, ((0, 0), (0, 2))) @ turned + 5.0
    guidance.plot_latents(latents, [ModeCall("pace", {"v": 1.0})] * 40, Path("unused"))
    points = np.asarray(figures[0].axes[0].collections[0].get_offsets())
    distance = [np.linalg.norm(each[:, None] - each[None], axis=-1) for each in (points, spread)]
    np.testing.assert_allclose(*distance, atol=1e-9)
    assert points[:, 0].std() > points[:, 1].std()
    assert figures[0].axes[0].get_xlabel() == "first principal component"
