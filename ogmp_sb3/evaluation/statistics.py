"""Statistics over episodes: the mean of a number with its confidence interval."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import stdtrit


@dataclass(frozen=True)
class Estimate:
    """The mean of a number over episodes, with its 95 % confidence interval."""

    mean: float
    """mean over the episodes"""
    std: float | None
    """standard deviation; None for a single number"""
    n: int
    """how many numbers"""
    low: float | None
    """lower end of the interval; None where there is none, see :func:`estimate`"""
    high: float | None
    """upper end of the interval; None where there is none"""

    def as_data(self) -> dict[str, Any]:
        """Plain data, as in JSON files."""
        return {"mean": self.mean, "std": self.std, "n": self.n, "ci95": [self.low, self.high]}

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> Estimate:
        """The estimate that :meth:`as_data` gave.

        :raises KeyError: if something is missing
        """
        low, high = data["ci95"]
        return cls(data["mean"], data["std"], data["n"], low, high)


Estimates = dict[str, Estimate]  # by name of the metric


Limits = tuple[float | None, float | None]
"""what a number is never below and never above; None: nothing"""


def estimate(values: Iterable[float], limits: Limits = (None, None)) -> Estimate:
    """The mean of numbers: with Wilson's interval if all of them are ``bool``, else with Student's.

    Student's interval is cut off at the limits of the numbers, which their mean cannot be beyond. Of numbers that are
    all the same it would have no length, although they show nothing of how much such numbers vary: there is none then.
    But if they are all at one of two limits, it is Wilson's, as if all other numbers were at the other limit.

    :param values: at least one
    :param limits: of the numbers
    """
    numbers = list(values)
    x = np.array(numbers, dtype=float)
    n, mean = len(x), float(x.mean())
    std = float(x.std(ddof=1)) if n > 1 else None
    if all(isinstance(number, bool | np.bool_) for number in numbers):
        return Estimate(mean, std, n, *_wilson_interval(int(x.sum()), n))
    least, most = limits
    if std is None or (x == x[0]).all():
        if least is None or most is None or x[0] not in limits:
            return Estimate(mean, std, n, None, None)
        low, high = _wilson_interval(n if x[0] == most else 0, n)
        return Estimate(mean, std, n, least + (most - least) * low, least + (most - least) * high)
    half = float(stdtrit(n - 1, 0.975)) * std / math.sqrt(n)
    low = mean - half if least is None else min(max(mean - half, least), mean)
    high = mean + half if most is None else max(min(mean + half, most), mean)
    return Estimate(mean, std, n, low, high)


def _wilson_interval(successes: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a probability, which holds near 0 and 1."""
    from scipy.stats import binomtest  # imported here: it takes a second

    interval = binomtest(successes, n).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)


def estimates_as_data(estimates: Estimates) -> dict[str, Any]:
    """Plain data of estimates by name."""
    return {name: each.as_data() for name, each in estimates.items()}


def estimates_from_data(data: dict[str, Any]) -> Estimates:
    """The estimates that :func:`estimates_as_data` gave."""
    return {name: Estimate.from_data(each) for name, each in data.items()}


def as_text(numbers: Sequence[float | None], digits: int = 3, between: str = "") -> str:
    """Numbers of an estimate for a table, a dash where there are none.

    :param between: what stands between two
    """
    return between.join(f"{x:.{digits}f}" for x in numbers if x is not None) or "-"
