"""Controls of the viewer for the numbers of modes and disturbances."""

from __future__ import annotations

from typing import Any

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.ranges import Range


def add_size(gui: Any, term: str, key: str, range_: Range, now: float | None) -> Any:
    """A slider of a disturbance's parameter, from where nothing is disturbed to half beyond its range.

    :param now: where it is; None: at no disturbance, or in the middle where that is the robot's own
    """
    default = registry.randomisations.parameters(term)[key].default
    none = float(default) if isinstance(default, int | float) else 0.5 * (range_.low + range_.high)
    least, most = registry.randomisations.limits(term).get(key, (-np.inf, np.inf))
    low, high = min(none, range_.low), max(none, range_.high)
    margin = 0.5 * (high - low) or 1.0
    low, high = max(low - margin if range_.low < none else low, least), min(high + margin, most)
    start = min(max(none if now is None else now, low), high)
    marks = tuple((end, f"{end:g}") for end in sorted({range_.low, range_.high}))
    return gui.add_slider(key, low, high, (high - low) / 100, start, marks=marks)


def add_parameter(gui: Any, key: str, range_: Range) -> Any:
    """A control of one parameter of a mode; the ends of its trained range are marked."""
    if range_.words:
        return gui.add_dropdown(key, range_.words)
    low, high = range_.beyond()
    low, high, middle = (round(value, 2) for value in (min(low, range_.low), high, 0.5 * (range_.low + range_.high)))
    marks = tuple((round(end, 2), f"{end:.2f}") for end in sorted({range_.low, range_.high}))
    return gui.add_slider(key, low, high, 0.01, middle, marks=marks)
