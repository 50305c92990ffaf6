"""Tests of strict reading: YAML text to plain data, plain data to typed values."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest

from ogmp_sb3.config.messages import Where, describe
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import read_value, read_yaml

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


# ---- Where ----


def test_a_place_shows_the_file_and_the_dotted_key() -> None:
    assert str(Where("t.yaml")) == "t.yaml"
    assert str(Where("t.yaml") / "modes" / "jump" / 0) == "t.yaml: 'modes.jump.0'"


def test_a_place_shows_an_empty_key_and_stays_on_one_line() -> None:
    assert str(Where("t.yaml") / "") == "t.yaml: ''"
    assert str(Where("t.yaml") / "a\nb") == r"t.yaml: 'a\nb'"


# ---- read_yaml ----


def test_a_yaml_file_is_read_as_plain_data(tmp_path: Path) -> None:
    path = tmp_path / "t.yaml"
    path.write_text("a: 1e-3\nb: &x {c: [1, null, true]}\nd: *x\ne: ${a}\n")
    data = read_yaml(path)
    assert data == {"a": 1e-3, "b": {"c": [1, None, True]}, "d": {"c": [1, None, True]}, "e": "${a}"}
    assert type(data) is dict
    assert type(data["b"]["c"]) is list
    assert data["b"] is not data["d"]  # a change of one must not change the other


def test_an_environment_variable_in_a_file_stays_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OGMP_SECRET", "42")
    path = tmp_path / "t.yaml"
    path.write_text("a: ${oc.env:OGMP_SECRET}\n")
    assert read_yaml(path) == {"a": "${oc.env:OGMP_SECRET}"}


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"a: [1", "not readable as YAML"),
        (b"a:\n\t- b", "not readable as YAML"),
        (b"a: 1\na: 2", "found duplicate key a"),
        (b"a: {b: 1, b: 2}", "found duplicate key b"),
        (b"a: 1\n---\nb: 2", "expected a single document"),
        (b"a: !!python/object/apply:os.getcwd []", "could not determine a constructor for the tag"),
        (b"a: !!bool maybe", "not readable as YAML"),
        (b"a: !!timestamp now", "not readable as YAML"),
        (b"a: !!float x", "not readable as YAML"),
        (b"a: *nothing", "found undefined alias"),
        (b"a: &x [*x]", "nested too deeply, or inside itself"),
        (b"a: " + b"[" * 3000, "nested too deeply, or inside itself"),
        (b"a: " + b"9" * 5000, "not readable as YAML"),
        (b"? [1, 2]\n: 3", "not readable as YAML"),
        (b"null: 3", "not readable as YAML"),
        (b"a: \xff\xfe", "not readable as YAML"),
        (b"a: \x00", "not readable as YAML"),
        (b"[1, 2]", "expected a mapping at the top, found the list [1, 2]"),
        (b"- a: 1", "expected a mapping at the top, found the list"),
        (b"3", "not readable as YAML"),
    ],
)
def test_a_file_that_is_no_mapping_is_one_sentence(tmp_path: Path, content: bytes, found: str) -> None:
    path = tmp_path / "t.yaml"
    path.write_bytes(content)
    with pytest.raises(ValueError) as caught:
        read_yaml(path)
    (message,) = caught.value.args
    assert message.startswith(f"{path}: ")
    assert found in message
    assert "\n" not in message


def test_a_missing_file_and_a_directory_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nothing\.yaml: no such file\."):
        read_yaml(tmp_path / "nothing.yaml")
    with pytest.raises(ValueError, match=r"not readable as YAML"):
        read_yaml(tmp_path)


# ---- read_value ----


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.3", 0.3),
        ("1e-3", 1e-3),
        ("1E3", 1000.0),
        ("30", 30),
        ("-1", -1),
        ("null", None),
        ("true", True),
        ("lqr", "lqr"),
        ("[0.1, 1e-1]", [0.1, 0.1]),
        ("{r: [front, back], h: 1}", {"r": ["front", "back"], "h": 1}),
        ("a=b", "a=b"),
        ("'1'", "1"),
        ("${rho}", "${rho}"),
    ],
)
def test_an_override_reads_as_it_would_in_a_file(tmp_path: Path, text: str, value: Any) -> None:
    path = tmp_path / "t.yaml"
    path.write_text(f"a: {text}\n")
    found = read_value(text)
    assert found == value == read_yaml(path)["a"]
    assert type(found) is type(value)


@pytest.mark.parametrize("text", ["[", "a: b: c", "!!python/name:os.system", "!!bool x", "9" * 5000, "[" * 3000])
def test_an_override_that_is_not_yaml_is_one_line(text: str) -> None:
    with pytest.raises(ValueError) as caught:
        read_value(text)
    assert "\n" not in caught.value.args[0]


# ---- read ----


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


# ---- describe ----


def test_a_long_or_many_lined_value_is_shown_short_on_one_line() -> None:
    class Lines:
        def __repr__(self) -> str:
            return "one\ntwo"

    assert describe(Lines()) == "the value one two"
    assert len(describe("x" * 10_000)) < 150
    assert "\n" not in describe("a\nb")
