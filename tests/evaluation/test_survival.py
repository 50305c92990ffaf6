"""Survival curves, against published and hand-computed values."""

from __future__ import annotations

import io
import json
import math

import numpy as np
import pytest
from rich.console import Console

from helpers.records import record
from ogmp_sb3.evaluation.survival import (
    DISTANCE,
    TIME,
    Survival,
    median_text,
    round_places,
    survival_curve,
    survival_curves,
    survival_table,
)

# Weeks of remission of leukaemia patients with 6-MP (+ is censored) and without (Freireich et al. 1963; Gehan 1965).
TREATED = "6 6 6 6+ 7 9+ 10 10+ 11+ 13 16 17+ 19+ 20+ 22 23 25+ 32+ 32+ 34+ 35+".split()
CONTROL = "1 1 2 2 3 4 4 5 5 8 8 8 8 11 11 12 12 15 17 22 23".split()


def curve_of(weeks: list[str]) -> Survival:
    return survival_curve([float(week.rstrip("+")) for week in weeks], [not week.endswith("+") for week in weeks])


def test_shares_and_medians_are_those_of_the_textbook() -> None:
    """Venables and Ripley, Modern Applied Statistics with S, sec. 13.1: survfit(..., conf.type = "log-log")."""
    treated, control = curve_of(TREATED), curve_of(CONTROL)
    falls = {step.at: step for step in treated.steps if step.at in (6, 7, 10, 13, 16, 22, 23)}
    shares = [0.857, 0.807, 0.753, 0.690, 0.627, 0.538, 0.448]
    assert [step.share for step in falls.values()] == pytest.approx(shares, abs=5e-4)
    assert (falls[6].low, falls[6].high) == (pytest.approx(0.620, abs=5e-4), pytest.approx(0.952, abs=5e-4))
    assert [step.running for step in falls.values()] == [21, 17, 15, 12, 11, 7, 6]
    assert (treated.n, treated.falls, treated.median, treated.low, treated.high) == (21, 9, 23, 13, None)
    assert (control.n, control.falls, control.median, control.low, control.high) == (21, 21, 8, 4, 11)


def test_four_episodes_by_hand() -> None:
    curve = survival_curve([10.0, 20.0, 30.0, 40.0], [True, False, True, False])
    assert [step.share for step in curve.steps] == pytest.approx([3 / 4, 3 / 4, 3 / 8, 3 / 8])  # 1/4 of 4, 1/2 of 2
    spread = 1.959964 * math.sqrt(1 / (4 * 3)) / math.log(3 / 4)  # Greenwood, log(-log)
    low, high = sorted(0.75 ** math.exp(sign * spread) for sign in (-1, 1))
    assert (curve.steps[0].low, curve.steps[0].high) == (pytest.approx(low, abs=1e-6), pytest.approx(high, abs=1e-6))
    assert (curve.median, curve.falls) == (30.0, 2)


@pytest.mark.parametrize("places", [[3.0, 1.0, 2.0], [1.0, 2.0, 5.0, 9.0], [4.0, 4.0, 4.0, 4.0], [2.5]])
def test_where_all_fall_the_median_is_that_of_the_places(places: list[float]) -> None:
    assert survival_curve(places, [True] * len(places)).median == np.median(places)


def test_where_nobody_falls_there_is_neither_a_median_nor_an_interval() -> None:
    curve = survival_curve([200.1, 200.0], [False, False])
    assert [(step.share, step.low, step.high) for step in curve.steps] == [(1.0, None, None)] * 2
    assert (curve.median, curve.low, curve.high, curve.falls) == (None, None, None, 0)
    assert median_text(curve, "m") == "over 200.1 m (more than half still run where the last episode ends)"


def test_a_share_holds_up_to_the_next_fall() -> None:
    curve = survival_curve([10.0, 20.0, 30.0, 40.0], [True, False, True, False])
    found = [(curve.share_at(place).share, curve.share_at(place).running) for place in (5.0, 10.0, 29.9, 30.0, 50.0)]
    assert found == [(1.0, 4), (0.75, 4), (0.75, 2), (0.375, 2), (0.375, 0)]


def test_a_median_without_an_upper_end_says_so() -> None:
    assert median_text(curve_of(TREATED), "m") == "23.0 m (95 % interval over episodes: 13.0 .. open)"


def test_a_curve_survives_json() -> None:
    curve = curve_of(TREATED)
    assert Survival.from_data(json.loads(json.dumps(curve.as_data()))) == curve


def episode(x: list[float], termination: str, **fields: object):
    modes = ({"mode": "pace", "v": 1.0, "length": 500.0},)
    position = np.outer(x, [1.0, 0.0, 0.0])
    return record(base_pos_w=position, reward=np.zeros(len(x)), termination=termination, modes=modes, **fields)


def test_the_distance_is_the_farthest_from_the_start_and_time_is_in_seconds() -> None:
    records = [
        episode([1.0, 4.0, 3.0], "fall"),  # 3 m, then back
        episode([0.0, 2.0, 5.0, 10.0], "max_distance"),
        episode([0.0], "unstable"),  # in the first step
    ]
    curves = survival_curves(records)
    assert [(step.at, step.share) for step in curves[DISTANCE].steps] == [
        (0.0, pytest.approx(2 / 3)), (3.0, pytest.approx(1 / 3)), (10.0, pytest.approx(1 / 3)),
    ]  # fmt: skip
    assert [step.at for step in curves[TIME].steps] == pytest.approx([0.0, 0.06, 0.09])
    assert (curves[DISTANCE].falls, curves[DISTANCE].n) == (2, 3)


def test_only_tracks_without_end_have_curves() -> None:
    assert survival_curves([episode([0.0, 1.0], "fall", track_length=10.0)]) == {}
    assert survival_curves([record()]) == {}  # timed


def test_round_places_go_up_to_the_end() -> None:
    assert round_places(200.0) == [5.0, 10.0, 20.0, 50.0, 100.0, 200.0]
    assert round_places(0.3) == pytest.approx([0.01, 0.02, 0.05, 0.1, 0.2])
    assert round_places(0.0) == []


def test_the_table_has_the_share_at_round_places() -> None:
    curves = {DISTANCE: survival_curve([10.0, 20.0, 30.0, 40.0], [True, False, True, False])}
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(survival_table(curves))
    lines = [line.replace("│", " ").split() for line in console.export_text().splitlines()]
    assert ["20", "0.750", "0.128", "..", "0.961", "3"] in lines
    assert ["5", "1.000", "-", "4"] in lines
