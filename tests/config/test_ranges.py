"""Parameters as a YAML file gives them: a value, a range or words."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.ranges import Range

HERE = Where("t.yaml", "h")


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (0.8, Range(0.8, 0.8)),
        (1, Range(1.0, 1.0)),
        ([0.2, 0.35], Range(0.2, 0.35)),
        ((0.2, 0.2), Range(0.2, 0.2)),
        ("front", Range(words=("front",))),
        (["front", "back"], Range(words=("front", "back"))),
    ],
)
def test_a_range_is_a_number_a_pair_or_words(data: Any, expected: Range) -> None:
    assert Range.from_data(data, HERE) == expected


@pytest.mark.parametrize(
    ("data", "kind", "message"),
    [
        ([0.3, 0.2], ValueError, r"'h' is a reversed range: 0\.3 > 0\.2 \(write it as \[low, high\]\)\."),
        ([], ValueError, r"must be a number, \[low, high\], a word or a list of words, found the list \[\]"),
        ([1], ValueError, r"must be a number, .*found the list \[1\]"),
        ([1, 2, 3], ValueError, r"must be a number, .*found the list \[1, 2, 3\]"),
        (["front", "front"], ValueError, "has a word twice"),
        ([math.nan, 1], ValueError, r"'h\.0' must be finite, found nan"),
        (math.inf, ValueError, "must be finite, found inf"),
        (["front", 1], TypeError, r"'h\.0' must be a number, found the text 'front'"),
        (None, TypeError, r"must be a number, .*found nothing \(null\)"),
        (True, TypeError, "must be a number, .*found the value True"),
        ({"low": 1}, TypeError, "must be a number, .*found a mapping"),
    ],
)
def test_anything_else_is_no_range(data: Any, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=rf"^t\.yaml: .*{message}"):
        Range.from_data(data, HERE)


def test_beyond_a_range_lies_half_of_it_at_both_ends_but_nothing_below_half_its_least_value() -> None:
    assert Range(1.0, 2.0).beyond() == (0.5, 2.5)
    assert Range(0.8, 0.8).beyond() == pytest.approx((0.4, 1.2))
    assert Range(0.1, 0.5).beyond() == pytest.approx((0.05, 0.7))
    assert Range(0.005, 0.012).beyond() == pytest.approx((0.005, 0.0155))
    assert Range(0.0, 0.5).beyond() == pytest.approx((0.02, 0.75))
    assert Range(0.0, 0.0).beyond() == pytest.approx((0.02, 0.5))


def test_corners_are_the_extremes_or_the_words() -> None:
    assert Range(1.0, 2.0).corners() == (1.0, 2.0)
    assert Range(words=("a", "b", "c")).corners() == ("a", "b", "c")
