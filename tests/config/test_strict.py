"""Tests of strict reading: plain data to typed values."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import null_leaves_out, read

HERE = Where("t.yaml", "a.b")


@dataclass(frozen=True, kw_only=True)
class Inner:
    size: float
    words: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Outer:
    inner: Inner
    order: Literal["random", "sequence"] = "random"
    weights: dict[str, float] = field(default_factory=dict)
    limit: int | None = None
    secret: int = field(default=7, metadata={"internal": True})

    def __post_init__(self) -> None:
        if self.limit == 13:
            raise ValueError("'limit' must not be 13.")


@pytest.mark.parametrize(
    ("kind", "data", "value"),
    [
        (float, 1, 1.0),
        (float, 0.5, 0.5),
        (int, 3, 3),
        (bool, False, False),
        (str, "x", "x"),
        (float | None, None, None),
        (float | None, 2, 2.0),
        (int | str, "auto", "auto"),
        (int | str, 2, 2),
        (Literal["a", "b"], "b", "b"),
        (tuple[float, ...], [1, 2.5], (1.0, 2.5)),
        (tuple[float, ...], (), ()),
        (tuple[float, float], [1, 2], (1.0, 2.0)),
        (dict[str, float], {"x": 1}, {"x": 1.0}),
        (dict[str, dict[str, Any] | None], {"x": None, "y": {"z": 1}}, {"x": None, "y": {"z": 1}}),
        (Inner, {"size": 2}, Inner(size=2.0)),
        (Outer, {"inner": {"size": 2, "words": ["a"]}}, Outer(inner=Inner(size=2.0, words=("a",)))),
    ],
)
def test_plain_data_becomes_a_value_of_the_type(kind: Any, data: Any, value: Any) -> None:
    found = read(kind, data, HERE)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("kind", "data", "message"),
    [
        (float, "0.5", "must be a number, found the text '0.5'"),
        (float, True, "must be a number, found the value True"),
        (float, None, r"must be a number, found nothing \(null\)"),
        (float, [1], r"must be a number, found the list \[1\]"),
        (float, (1,), r"must be a number, found the list \(1,\)"),
        (float, {"a": 1}, "must be a number, found a mapping"),
        (float, Path("x"), r"must be a number, found the value PosixPath\('x'\)"),
        (int, 1.0, "must be a whole number, found the number 1.0"),
        (int, True, "must be a whole number, found the value True"),
        (int | None, "3", "must be a whole number, found the text '3'"),
        (bool, 1, "must be true or false, found the number 1"),
        (str, 3, "must be text, found the number 3"),
        (tuple[str, ...], "x", "must be a list, found the text 'x'"),
        (tuple[str, ...], ["x", 1], r"\.1' must be text, found the number 1"),
        (dict[str, float], [], r"must be a mapping, found the list \[\]"),
        (dict[str, float], {"x": "1"}, r"\.x' must be a number"),
        (Inner, 3, "must be a mapping, found the number 3"),
        (Outer, {"inner": {"size": "2"}}, r"\.inner\.size' must be a number"),
        (Outer, {"inner": None}, r"\.inner' must be a mapping, found nothing"),
    ],
)
def test_a_wrong_type_says_what_was_found_and_expected(kind: Any, data: Any, message: str) -> None:
    with pytest.raises(TypeError, match=rf"^t\.yaml: 'a\.b.*{message}.*\.$"):
        read(kind, data, HERE)


@pytest.mark.parametrize(
    ("kind", "data", "message"),
    [
        (float, math.nan, "must be finite, found nan"),
        (float, -math.inf, "must be finite, found -inf"),
        (float, 10**400, "is too large"),
        (int, 2**63, "is too large"),
        (Literal["random", "sequence"], "randm", r"the text 'randm' \(allowed: .*\)\. Did you mean 'random'\?"),
        (Literal["random"], None, r"is nothing \(null\) \(allowed: random\)"),
        (Literal["random"], ["random"], r"is the list \['random'\] \(allowed: random\)"),
        (tuple[float, float], [1], "must have 2 entries, found 1"),
        (Outer, {"inner": {"size": 1}, "limit": 13}, "'limit' must not be 13"),
    ],
)
def test_a_wrong_value_says_what_was_found_and_allowed(kind: Any, data: Any, message: str) -> None:
    with pytest.raises(ValueError, match=rf"^t\.yaml: 'a\.b.*{message}"):
        read(kind, data, HERE)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"iner": {}}, r"a\.b\.iner' is not a known key \(allowed: .*\)\. Did you mean 'inner'\?"),
        ({"inner": {"size": 1, "sizes": 1}}, r"a\.b\.inner\.sizes' is not a known key .*Did you mean 'size'\?"),
        ({"inner": {"size": 1}, "secret": 1}, r"a\.b\.secret' is not a known key"),
        ({"inner": {"size": 1}, 3: 1}, r"a\.b\.3' is not a known key"),
        ({"inner": {}}, r"a\.b\.inner\.size' is missing"),
        ({}, r"a\.b\.inner' is missing"),
    ],
)
def test_an_unknown_or_missing_key_is_named(data: Any, message: str) -> None:
    with pytest.raises(KeyError, match=message):
        read(Outer, data, HERE)


def test_reading_keeps_nothing_of_the_data_given() -> None:
    data = {"inner": {"size": 1, "words": ["a"]}, "weights": {"x": 1.0}}
    outer = read(Outer, data, HERE)
    data["weights"]["x"] = 2.0
    data["inner"]["words"].append("b")
    assert outer == Outer(inner=Inner(size=1.0, words=("a",)), weights={"x": 1.0})


@dataclass(frozen=True, kw_only=True)
class Nested:
    outer: Outer | None = None
    whole: Outer
    entries: tuple[Inner, ...] = ()
    anything: Any = None
    named: dict[str, Inner | None] = field(default_factory=dict)


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("outer", False),  # null is a value
        ("whole", False),  # required
        ("entries", True),
        ("anything", False),  # who knows
        ("unknown", False),
        ("named", True),
        ("named.a", False),
        ("named.a.size", False),
        ("named.a.words", True),
        ("outer.inner", False),
        ("outer.order", True),
        ("outer.limit", False),
        ("outer.weights", True),
        ("outer.weights.a", True),
        ("outer.weights.a.b", False),
        ("whole.inner.words", True),
        ("entries.0", False),
        ("anything.below", False),
        ("unknown.below", False),
    ],
)
def test_null_leaves_out_what_need_not_be_there_and_is_never_null(key: str, expected: bool) -> None:
    assert null_leaves_out(Nested, key.split(".")) is expected
