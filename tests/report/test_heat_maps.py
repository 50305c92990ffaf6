"""The section with heat maps over mode parameters."""

from __future__ import annotations

import pytest

from ogmp_sb3.evaluation.statistics import estimate
from ogmp_sb3.report.heat_maps import grid_rows, heat_maps_to_come


@pytest.mark.parametrize(("cell", "trained"), [([0.0, 0.25], False), ([0.25, 0.75], True), ([0.0, 9.0], True)])
def test_a_cell_was_trained_on_by_its_middle_or_if_it_holds_the_whole_range(cell: list[float], trained: bool) -> None:
    metrics = {"return": estimate([1.0, 2.0]).as_data()}
    grid = {"mode": "jump", "axes": ["w", "h"], "trained": {"w": [0.3, 0.5], "h": [0.0, 1.0]}}
    (row,) = grid_rows([{**grid, "cells": [{"w": cell, "h": [0.0, 1.0], "metrics": metrics}]}])
    assert (row["trained"], row["return"], row["n"]) == (trained, 1.5, 2)


def test_what_stands_in_their_place_says_how_they_will_come() -> None:
    section = heat_maps_to_come()
    assert (section.title, section.parts) == ("Mode parameters", [])
    assert "are being measured" in section.text and "the same command goes on where it stopped" in section.text
