"""Episodes that are copies of others: they say nothing that one of them does not, and count once.

A scene, or a dive in one direction off one height, leaves nothing to chance: every episode is the first again, bit for
bit, and an interval over copies would be as narrow as one likes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np

from ogmp_sb3.evaluation.record import EpisodeRecord


def digest(record: EpisodeRecord) -> bytes:
    """What tells an episode from every other: a hash of all that the record holds, bit for bit."""
    content = hashlib.sha256()
    for field in fields(record):
        _add(content, getattr(record, field.name))
    return content.digest()


def _add(content: hashlib._Hash, value: Any) -> None:
    """Go on with a value, and with what it holds."""
    if isinstance(value, np.ndarray):
        content.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, tuple):
        for part in value:
            _add(content, part)
    else:
        content.update(repr(value).encode())


def first_of_each(records: Iterable[EpisodeRecord]) -> list[int]:
    """The indices of episodes that are not copies of earlier ones, ascending."""
    first: dict[bytes, int] = {}
    for i, record in enumerate(records):
        first.setdefault(digest(record), i)
    return list(first.values())


def distinct(records: list[EpisodeRecord]) -> list[EpisodeRecord]:
    """The episodes without copies of earlier ones: those that estimates are made of."""
    return [records[i] for i in first_of_each(records)]


def copies_text(copies: int, episodes: int) -> str:
    """A sentence on episodes that are copies of others; empty if there are none.

    :param episodes: with the copies
    """
    if not copies:
        return ""
    verb = "is a copy of another and counts" if copies == 1 else "are copies of others and count"
    return f"{copies} of {episodes} episodes {verb} once."


def copies_in_sets_text(counted: Iterable[int], episodes: int, sets: str) -> str:
    """A sentence on sets of episodes of which some are copies of others; empty if there are none.

    :param counted: how many episodes of each set count
    :param episodes: of each set, with the copies
    :param sets: what a set is, in the plural
    """
    counted = list(counted)
    fewer = [n for n in counted if n < episodes]
    if not fewer:
        return ""
    rest = f"{min(fewer)} to {max(fewer)}" if min(fewer) < max(fewer) else str(fewer[0])
    return (
        f"In {len(fewer)} of {len(counted)} {sets}, episodes are copies of others and count once: {rest} of {episodes} "
        "are left."
    )
