"""How long things take: by the clock, by CPU time, in turns with something else, and part by part."""

from __future__ import annotations

import gc
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

Numbers = dict[str, float]


def median(values: list[float]) -> float:
    """The middle of several measurements."""
    return float(np.median(values))


def seconds_of(body: Callable[[], Any]) -> float:
    """How long something takes, s."""
    gc.collect()
    begin = time.perf_counter()
    body()
    return time.perf_counter() - begin


def cpu_seconds_of(body: Callable[[], Any]) -> float:
    """How long the CPUs work for something, all threads together, s; hardly longer where other work shares them."""
    gc.collect()
    begin = time.process_time()
    body()
    return time.process_time() - begin


def times_bare(whole: Callable[[Callable[[], None]], Any], bare: Callable[[], Any]) -> np.ndarray:
    """How many runs of ``bare`` something takes as long as, by CPU time and by the clock.

    A CPU that other work shares is slower by half for a second and then as fast as ever. So both are done in turns of
    milliseconds, under the same conditions.

    :param whole: handed a function that it calls at its pauses, at least once; in each ``bare`` runs
    :return: shape (2,)
    """
    pauses: list[np.ndarray] = []

    def pause() -> None:
        begin = _clocks()
        bare()
        pauses.append(_clocks() - begin)

    gc.collect()
    begin = _clocks()
    whole(pause)
    total, paused = _clocks() - begin, np.sum(pauses, axis=0)
    ratio: np.ndarray = (total - paused) / (paused / len(pauses))
    return ratio


def _clocks() -> np.ndarray:
    return np.array([time.process_time(), time.perf_counter()])


class PartClock:
    """How long the parts of a program take together, by wrapping its functions."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        """by part, s; a part within another is counted in both"""

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, its time added to a part's."""

        def wrapped(*args: Any, **kwargs: Any) -> Any:
            begin = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.seconds[part] += time.perf_counter() - begin

        return wrapped
