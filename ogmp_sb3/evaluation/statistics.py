"""What many episodes say together: means with their intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.special import stdtrit

Summary = dict[str, Any]  # of :func:`summarise`


def summarise(values: Iterable[float]) -> Summary:
    """Mean, standard deviation, n and a 95 % confidence interval of the mean.

    The interval is Wilson's if all values are ``bool``, else Student's. One number alone has no standard deviation
    and no interval: None.
    """
    found = list(values)
    x = np.array(found, dtype=float)
    n, mean = len(x), float(x.mean())
    std = float(x.std(ddof=1)) if n > 1 else None
    interval: list[float] | list[None] = [None, None]
    if all(isinstance(value, bool | np.bool_) for value in found):
        interval = _wilson(mean, n)
    elif std is not None:
        half = float(stdtrit(n - 1, 0.975)) * std / math.sqrt(n)
        interval = [mean - half, mean + half]
    return {"mean": mean, "std": std, "n": n, "ci95": interval}


def _wilson(share: float, n: int) -> list[float]:
    """Wilson's 95 % interval of a probability, which holds near 0 and 1.

    :param share: of yes among ``n`` values
    """
    z = 1.959964
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    # It holds the share and lies within 0 and 1 but for rounding.
    return [max(min(centre - half, share), 0.0), min(max(centre + half, share), 1.0)]


def as_text(numbers: Sequence[float | None], digits: int = 3, between: str = "") -> str:
    """Numbers of a summary for a table, a dash where there are none.

    :param between: what stands between two
    """
    return between.join(f"{x:.{digits}f}" for x in numbers if x is not None) or "-"
