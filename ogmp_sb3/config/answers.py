"""What registered functions return: checked by type and shape, and their own exceptions told in their name."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ogmp_sb3.config.messages import describe

Answer = TypeVar("Answer")


class FunctionFailed(ValueError):
    """A registered function has raised an exception."""


def call(title: str, function: Callable[..., Answer], /, *arguments: Any, **parameters: Any) -> Answer:
    """Call a registered function.

    :param title: the function, e.g. ``"reward 'calm'"``
    :raises FunctionFailed: if it raises an exception, as :func:`told_in_name` has it
    """
    try:
        return function(*arguments, **parameters)
    except Exception as error:
        raise told_in_name(title, error) from error


def told_in_name(title: str, error: Exception) -> Exception:
    """An exception of a registered function as a sentence that names the function and its line.

    :param title: the function, e.g. ``"reward 'calm'"``
    :param error: as caught where the function was called
    :return: what to raise; the exception itself, if it is a sentence that names the function already
    """
    if isinstance(error, MemoryError) or title in str(error):
        return error
    below = traceback.extract_tb(error.__traceback__)[1:]  # the first is of the caller
    place = f" in line {below[0].lineno} of {'/'.join(Path(below[0].filename).parts[-2:])}" if below else ""
    text = str(error).rstrip(".")
    return FunctionFailed(f"{title} failed{place}: {type(error).__name__}{': ' if text else ''}{text}.")


def check_array(what: str, answer: Any, kinds: str, shape: tuple[int, ...], expected: str) -> None:
    """Check what a function returned.

    :param what: its name, for messages
    :param answer: what was returned
    :param kinds: allowed kinds of number (``numpy.dtype.kind``)
    :param shape: allowed shape
    :param expected: what is allowed, in words
    :raises TypeError: unless it is an array of one of the kinds
    :raises ValueError: if it has another shape
    """
    if not isinstance(answer, np.ndarray) or answer.dtype.kind not in kinds:
        raise TypeError(f"{what} must be {expected}; it is {answer_text(answer)}.")
    if answer.shape != shape:
        raise ValueError(f"{what} must be {expected}; it is {answer_text(answer)}.")


def check_finite(what: str, answer: np.ndarray, sound: np.ndarray) -> None:
    """Check that numbers are finite, where what they were made from is.

    :param what: name of the numbers, for messages
    :param answer: the numbers, shape (rows, ...)
    :param sound: rows to look at, shape (rows,), bool
    :raises ValueError: if they are not
    """
    wrong = answer[sound][~np.isfinite(answer[sound])]
    if wrong.size:
        raise ValueError(f"{what} must be finite; it holds {wrong[0]:g}.")


def answer_text(answer: Any) -> str:
    """What was returned, for a message."""
    if isinstance(answer, np.ndarray):
        return f"an array of shape {answer.shape} of {answer.dtype}"
    return describe(answer)
