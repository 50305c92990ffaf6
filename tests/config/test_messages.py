"""How a message names a place, a value and the closest match."""

from ogmp_sb3.config.messages import LONGEST, Where, describe, did_you_mean, first_line

# ---- Where ----


def test_a_place_shows_the_file_and_the_dotted_key() -> None:
    assert str(Where("t.yaml")) == "t.yaml"
    assert str(Where("t.yaml") / "modes" / "jump" / 0) == "t.yaml: 'modes.jump.0'"


def test_a_place_shows_an_empty_key_and_stays_on_one_line() -> None:
    assert str(Where("t.yaml") / "") == "t.yaml: ''"
    assert str(Where("t.yaml") / "a\nb") == r"t.yaml: 'a\nb'"


# ---- describe ----


def test_a_long_or_many_lined_value_is_shown_short_on_one_line() -> None:
    class Lines:
        def __repr__(self) -> str:
            return "one\ntwo"

    assert describe(Lines()) == "the value one two"
    assert len(describe("x" * 10_000)) < 150
    assert "\n" not in describe("a\nb")


# ---- first_line ----


def test_what_a_library_says_is_one_short_line() -> None:
    assert first_line(ValueError("\n  no route to host.\nCaused by many things.")) == "no route to host"
    assert first_line(ConnectionError()) == "ConnectionError"
    assert len(first_line(ValueError("x" * 10_000))) == LONGEST + 3


# ---- did_you_mean ----


def test_the_hint_lists_sorted_names_and_the_closest_match() -> None:
    assert did_you_mean("lenght", ["start", "length"]) == " (allowed: length, start). Did you mean 'length'?"


def test_the_hint_suggests_nothing_for_a_name_unlike_all() -> None:
    assert did_you_mean("qqq", ["start", "length"]) == " (allowed: length, start)."


def test_the_hint_says_that_nothing_is_allowed() -> None:
    assert did_you_mean("x", []) == " (allowed: none)."
