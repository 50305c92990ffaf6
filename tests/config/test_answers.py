"""What registered functions return, and what they raise."""

from __future__ import annotations

import numpy as np
import pytest

from ogmp_sb3.config.answers import FunctionFailed, answer_text, call, check_array, check_finite, told_in_name


def caught(error: Exception) -> Exception:
    """The exception as it is where it was caught, raised in a function below."""

    def below() -> None:
        raise error

    try:
        below()
    except Exception as found:
        return found
    raise AssertionError


def test_an_exception_is_told_with_the_function_and_its_line() -> None:
    told = told_in_name("mode 'hop'", caught(KeyError("h")))
    assert isinstance(told, FunctionFailed)
    assert str(told).startswith("mode 'hop' failed in line ") and str(told).endswith("test_answers.py: KeyError: 'h'.")


def test_an_exception_without_a_text_has_its_name() -> None:
    assert str(told_in_name("mode 'hop'", caught(AssertionError()))).endswith("test_answers.py: AssertionError.")


@pytest.mark.parametrize("error", [MemoryError("too large"), ValueError("mode 'hop' is too high.")])
def test_what_says_enough_stays_as_it_is(error: Exception) -> None:
    assert told_in_name("mode 'hop'", caught(error)) is error


def test_arrays_are_checked_by_kind_and_shape() -> None:
    check_array("it", np.zeros(3), "f", (3,), "three numbers")
    with pytest.raises(TypeError, match=r"^it must be three numbers; it is an array of shape \(3,\) of int64\.$"):
        check_array("it", np.zeros(3, np.int64), "f", (3,), "three numbers")
    with pytest.raises(ValueError, match=r"^it must be three numbers; it is an array of shape \(4,\) of float64\.$"):
        check_array("it", np.zeros(4), "f", (3,), "three numbers")
    assert answer_text(2) == "the number 2"


def test_only_sound_rows_must_be_finite() -> None:
    values = np.array([[0.0, 1.0], [np.nan, 0.0]])
    check_finite("it", values, np.array([True, False]))
    with pytest.raises(ValueError, match=r"^it must be finite; it holds nan"):
        check_finite("it", values, np.array([False, True]))


def test_a_function_is_called_with_parameters_of_any_name() -> None:
    assert call("mode 'hop'", lambda title, function: title + function, title=1.0, function=2.0) == 3.0
