"""Pictures in tests: figures are looked at before they are written."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure


def drawn_figures(monkeypatch: pytest.MonkeyPatch, module: ModuleType) -> list[Figure]:
    """The figures that a module draws from now on, in place of files."""
    drawn: list[Figure] = []
    monkeypatch.setattr(module, "save", lambda figure, path, **_: drawn.append(figure))
    return drawn


def bars(axes: Any) -> np.ndarray:
    """The ends of error bars: x, low and high of each, shape (bars, 3)."""
    lines = [child for child in axes.get_children() if isinstance(child, LineCollection)]
    return np.array([[ends[0][0], ends[0][1], ends[1][1]] for each in lines for ends in each.get_segments()])
