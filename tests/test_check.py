"""What ogmp-check says about a task."""

from __future__ import annotations

import pytest

from ogmp_sb3.check import standing_still
from ogmp_sb3.config import load_task


@pytest.mark.parametrize(
    ("rho", "verdict"),
    [
        (0.5, "leaves the bound"),
        (0.54, "stays inside the bound in the slowest modes"),
        (0.8, "stays inside the bound in the slowest modes"),
        (1.62, "stays inside the bound"),
        (None, "stays inside the bound"),
    ],
)
def test_standing_still_is_judged_by_the_slowest_and_the_fastest_mode(rho: float | None, verdict: str) -> None:
    sentence = standing_still(load_task("parkour", {"rho": rho}))
    assert sentence == f"v * horizon * control_dt = 0.54 to 1.62 m, {verdict}"


def test_standing_still_is_not_judged_where_x_is_free() -> None:
    assert standing_still(load_task("dive")) is None
