"""Means over many episodes with their intervals."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

from helpers.records import record
from ogmp_sb3.config import registry
from ogmp_sb3.evaluation.metrics import flip_and_land
from ogmp_sb3.evaluation.statistics import Estimate, as_text, estimate, estimates_as_data, estimates_from_data


@pytest.mark.parametrize("n", [2, 5, 200])
def test_numbers_have_student_s_interval(n: int) -> None:
    values = np.random.default_rng(n).exponential(3.0, n)
    found = estimate(values)
    expected = stats.t.interval(0.95, n - 1, values.mean(), values.std(ddof=1) / np.sqrt(n))
    np.testing.assert_allclose([found.low, found.high], expected)
    assert (found.mean, found.std, found.n) == (values.mean(), values.std(ddof=1), n)


@pytest.mark.parametrize(("yes", "n"), [(0, 20), (20, 20), (1, 1), (7, 9), (482, 500)])
def test_yes_or_no_has_wilson_s_interval(yes: int, n: int) -> None:
    found = estimate(i < yes for i in range(n))
    z, share = stats.norm.ppf(0.975), yes / n
    half = np.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2) * z
    expected = [(share + z * z / (2 * n) + sign * half) / (1 + z * z / n) for sign in (-1, 1)]  # Wilson, 1927
    np.testing.assert_allclose([found.low, found.high], expected, atol=1e-7)
    assert 0.0 <= found.low <= found.mean <= found.high <= 1.0


def test_numbers_that_happen_to_be_0_or_1_are_no_yes_or_no() -> None:
    assert estimate([0.0, 1.0]).high > 1.0
    records = [record(), record(termination="fall")]
    assert estimate(registry.metrics.get("no_fall_fraction")(r) for r in records).high < 1.0
    assert estimate(flip_and_land(r) for r in records).high < 1.0


def test_an_interval_is_cut_off_at_the_limits_of_the_numbers() -> None:
    values = [1.0, 1.0, 0.9, 0.4]
    free, cut = estimate(values), estimate(values, (0.0, 1.0))
    assert free.high is not None and free.high > 1.0
    assert (cut.low, cut.high) == (free.low, 1.0)
    assert estimate([0.1, 0.0, 0.5], (0.0, None)).low == 0.0
    beyond = estimate([9.0, 11.0], (None, 10.0 - 1.0))  # limits that do not hold
    assert beyond.low is not None and beyond.high is not None
    assert beyond.low <= beyond.mean <= beyond.high


@pytest.mark.parametrize("n", [1, 3, 50])
def test_numbers_that_are_all_the_same_do_not_make_their_mean_certain(n: int) -> None:
    assert (estimate([2.5] * n).low, estimate([2.5] * n).high) == (None, None)
    assert estimate([0.5] * n, (0.0, 1.0)).low is None
    for end, yes in ((4.0, True), (2.0, False)):
        found, share = estimate([end] * n, (2.0, 4.0)), estimate([yes] * n)
        assert share.low is not None and share.high is not None
        np.testing.assert_allclose([found.low, found.high], [2.0 + 2.0 * share.low, 2.0 + 2.0 * share.high])


def test_one_number_has_no_interval_and_tables_show_a_dash() -> None:
    found = estimate([3.0])
    assert found.as_data() == {"mean": 3.0, "std": None, "n": 1, "ci95": [None, None]}
    assert [as_text([found.std]), as_text([found.low, found.high], 3, " .. ")] == ["-", "-"]
    assert as_text([1.0, 2.25], 1, " .. ") == "1.0 .. 2.2"


def test_an_estimate_comes_back_from_a_file_as_it_was() -> None:
    estimates = {"a": estimate([1.0, 2.5]), "b": estimate([3.0]), "c": estimate([True, False])}
    data = json.loads(json.dumps(estimates_as_data(estimates)))
    assert list(data["a"]) == ["mean", "std", "n", "ci95"]
    assert estimates_from_data(data) == estimates


def test_what_is_no_estimate_is_refused() -> None:
    with pytest.raises(KeyError):
        Estimate.from_data({"mean": 1.0})
