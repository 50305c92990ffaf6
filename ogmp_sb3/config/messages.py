"""How a message names a place, a value and the closest match."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

LONGEST = 120  # characters of a value that a message shows


@dataclass(frozen=True)
class Where:
    """A place in a file, for messages."""

    file: str
    key: str | None = None

    def __truediv__(self, key: object) -> Where:
        return Where(self.file, str(key) if self.key is None else f"{self.key}.{key}")

    def __str__(self) -> str:
        return self.file if self.key is None else f"{self.file}: {self.key!r}"


@contextmanager
def located(where: Where) -> Iterator[None]:
    """Put the place in front of an error's message."""
    try:
        yield
    except (KeyError, ValueError, TypeError) as error:
        raise type(error)(f"{where}: {error.args[0]}") from None


def describe(data: Any) -> str:
    """What was found, for a message: ``"the text 'abc'"``."""
    if data is None:
        return "nothing (null)"
    if isinstance(data, dict):
        return "a mapping"
    names = {list: "the list", tuple: "the list", str: "the text", int: "the number", float: "the number"}
    text = " ".join(repr(data).split())
    return f"{names.get(type(data), 'the value')} {text if len(text) <= LONGEST else text[:LONGEST] + '...'}"


def first_line(error: Exception) -> str:
    """The first line of what a library says went wrong, without the full stop; its class if it says nothing."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    text = lines[0].rstrip(".") if lines else type(error).__name__
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """The end of an error sentence: what is allowed, and the closest match if there is one.

    :param name: what was found
    :param allowed: the names that would have been right
    :return: e.g. ``" (allowed: jump, leap, pace). Did you mean 'leap'?"``
    """
    names = sorted(str(a) for a in allowed)
    text = f" (allowed: {', '.join(names) if names else 'none'})."
    close = difflib.get_close_matches(str(name), names, n=1)
    return f"{text} Did you mean '{close[0]}'?" if close else text
