"""Rungs of a search, and which candidates go on from them."""

from __future__ import annotations

import collections

import pytest

from ogmp_sb3.commands.train.rungs import bracket, budgets, goes_on

NAMES = [f"c{i}" for i in range(9)]
AT_FIRST = {name: [float(i)] for i, name in enumerate(NAMES)}  # the last is the best


def going(rule: str | None, scores: dict[str, list[float]], reduction: int = 3, at_least_one: bool = False) -> set[str]:
    """Who goes on from the rung it is at."""
    return {name for name in scores if goes_on(rule, scores, name, 3, reduction, at_least_one)}  # type: ignore[arg-type]


def test_each_rung_has_so_many_times_the_samples_of_the_one_before() -> None:
    assert budgets(900, 3, 3) == [100, 300, 900]
    assert budgets(800, 1, 2) == [800]
    with pytest.raises(ValueError, match="'total_timesteps' is 8: too few for 3 rungs"):
        budgets(8, 3, 3)


def test_of_halving_the_best_third_goes_on() -> None:
    assert going("halving", AT_FIRST) == {"c6", "c7", "c8"}
    assert going("halving", AT_FIRST, reduction=2) == {"c5", "c6", "c7", "c8"}


def test_while_there_are_too_few_none_goes_on_unless_one_must() -> None:
    two = {"c0": [0.0], "c1": [1.0]}
    assert going("halving", two) == set()
    assert going("halving", two, at_least_one=True) == {"c1"}


def test_who_went_on_still_counts_at_the_rungs_below() -> None:
    scores = {**AT_FIRST, "c8": [8.0, 1.0], "c7": [7.0, 2.0], "c6": [6.0, 3.0]}
    assert {name for name in going("halving", scores) if len(scores[name]) == 1} == set()
    assert {name for name in going("halving", scores) if len(scores[name]) == 2} == {"c6"}


def test_who_stopped_goes_on_when_worse_ones_came() -> None:
    scores = {"c0": [1.0], "c1": [2.0], "c2": [3.0]}
    assert "c1" not in going("halving", scores)
    scores |= {f"worse{i}": [0.0] for i in range(3)}
    assert "c1" in going("halving", scores)


def test_of_those_with_the_same_score_the_first_goes_on() -> None:
    assert going("halving", {"a": [1.0], "b": [1.0], "c": [1.0]}) == {"a"}


def test_the_median_stops_the_worse_half_but_none_of_the_first_five() -> None:
    assert going("median", AT_FIRST) == {"c4", "c5", "c6", "c7", "c8"}
    assert going("median", dict(list(AT_FIRST.items())[:5])) == set(NAMES[:5])


def test_without_a_rule_all_go_on() -> None:
    assert going(None, AT_FIRST) == set(NAMES)


def test_brackets_of_hyperband_stop_candidates_from_their_rung_on_and_among_themselves() -> None:
    names = [f"rho={i}" for i in range(600)]
    counts = collections.Counter(bracket(name, 3, 3) for name in names)
    shares = {0: 9, 1: 5, 2: 3}  # ceil(3 * 9 / 3), ceil(3 * 3 / 2), ceil(3 * 1 / 1)
    for number, share in shares.items():
        assert counts[number] / len(names) == pytest.approx(share / 17, abs=0.05)
    scores = {name: [float(i)] for i, name in enumerate(names)}
    on = going("hyperband", scores)
    own = [name for name in names if bracket(name, 3, 3) == 0]
    assert {name for name in on if bracket(name, 3, 3) == 0} == set(own[-(len(own) // 3) :])
    assert {name for name in names if bracket(name, 3, 3) > 0} <= on
