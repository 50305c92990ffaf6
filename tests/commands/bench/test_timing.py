"""How long things take, with clocks that only move when they are told to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ogmp_sb3.commands.bench import timing


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """CPU time and the clock, s; a test moves them on."""
    now = np.zeros(2)
    monkeypatch.setattr(timing, "_clocks", now.copy)
    return now


def test_what_is_done_in_pauses_does_not_count_for_the_whole(clocks: np.ndarray) -> None:
    def spend(cpu: float, clock: float) -> None:
        clocks[:] += cpu, clock

    def whole(pause: Callable[[], None]) -> None:
        for _ in range(6):
            spend(3.0, 4.0)
            pause()
        spend(2.0, 2.0)

    # Six times 3 s and 2 s are 20 s of CPU time, 26 s by the clock; a bare run takes 2 s by both.
    np.testing.assert_allclose(timing.times_bare(whole, lambda: spend(2.0, 2.0)), [10.0, 13.0])


def test_a_part_within_another_counts_in_both(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now[0])
    clock = timing.PartClock()

    def inner(seconds: float) -> float:
        now[0] += seconds
        return seconds

    part = clock.timed("part", inner)
    whole = clock.timed("whole", lambda: part(2.0) + inner(1.0))
    assert whole() == 3.0 and part(4.0) == 4.0
    assert clock.seconds == {"part": 6.0, "whole": 3.0}


def test_a_part_that_raises_has_taken_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now[0])
    clock = timing.PartClock()

    def fails() -> None:
        now[0] += 2.0
        raise RuntimeError

    with pytest.raises(RuntimeError):
        clock.timed("part", fails)()
    assert clock.seconds == {"part": 2.0}
