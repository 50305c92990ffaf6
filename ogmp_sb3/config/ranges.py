"""A parameter that a YAML file gives as one value, a range or a choice of words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ogmp_sb3.config.messages import Where, describe
from ogmp_sb3.config.strict import read


@dataclass(frozen=True)
class Range:
    """One mode parameter: a fixed value, a uniform range, or a set of words."""

    low: float = 0.0
    """least value"""
    high: float = 0.0
    """greatest value; equal to ``low`` for a fixed parameter"""
    words: tuple[str, ...] = ()
    """the choices of a parameter that is a word, e.g. a direction"""

    @classmethod
    def from_data(cls, data: Any, where: Where) -> Range:
        """Read ``0.8``, ``[0.2, 0.35]``, ``front`` or ``[front, back]``."""
        expected = "a number, [low, high], a word or a list of words"
        if data is None or isinstance(data, Mapping | bool):
            raise TypeError(f"{where} must be {expected}, found {describe(data)}.")
        if isinstance(data, str):
            data = [data]
        if isinstance(data, list | tuple) and data and all(isinstance(d, str) and d.isprintable() for d in data):
            if len(set(data)) < len(data):
                raise ValueError(f"{where} has a word twice: {', '.join(data)}.")
            return cls(words=tuple(data))
        if isinstance(data, list | tuple):
            if len(data) != 2:
                raise ValueError(f"{where} must be {expected}, found {describe(data)}.")
            low, high = read(tuple[float, float], data, where)
            if low > high:
                raise ValueError(f"{where} is a reversed range: {low} > {high} (write it as [low, high]).")
            return cls(low, high)
        value = read(float, data, where)
        return cls(value, value)

    def beyond(self) -> tuple[float, float]:
        """Where to try values: half a range beyond both ends, half the value of a fixed parameter, 0.5 beyond 0.

        Not below half the least value, nor below 0.02 unless it is: modes of next to no length would be too many
        around a robot.
        """
        margin = 0.5 * (self.high - self.low) or 0.5 * self.high or 0.5
        least = min(0.02, self.low or 0.5 * self.high or 0.02)
        return max(self.low - margin, 0.5 * self.low, least), self.high + margin

    def corners(self) -> tuple[float | str, ...]:
        """The extreme values."""
        return self.words or (self.low, self.high)


ModeRanges = dict[str, dict[str, Range]]
"""mode -> parameter -> range"""
