"""Terrain as it is drawn."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.guidance.terrain import NOTHING
from ogmp_sb3.rendering.frame import HIGH_COLOUR, LEVEL_COLOUR, LOW_COLOUR, ground_colours, ground_marks, join_terrain

GROUND, GROWN = (0.0, 1.0, -1.0, 1.0, 0.0), (0.0, 2.5, -1.0, 1.0, 0.0)
BLOCK = (2.5, 3.0, -1.0, 1.0, 0.3)
UNUSED = (0.0, 0.0, 0.0, 0.0, NOTHING)


def test_joined_terrain_has_every_box_once_and_at_its_longest() -> None:
    joined = join_terrain([np.array([GROUND, UNUSED]), np.array([GROWN, BLOCK]), np.array([GROUND, BLOCK])])
    np.testing.assert_array_equal(joined, [GROWN, BLOCK])


def test_no_terrain_is_no_box() -> None:
    assert join_terrain([np.array([UNUSED])]).shape == (0, 5)
    assert ground_marks(np.zeros((0, 5)), 0.0).shape == (0, 2, 3)


def test_marks_stay_where_they_are_while_the_robot_moves_and_lie_on_top_of_the_ground() -> None:
    terrain = np.array([(-50.0, 50.0, -50.0, 50.0, 0.0), BLOCK])
    here, there = (ground_marks(terrain, x) for x in (0.0, 1.3))
    assert {round(x % 0.5, 6) for x in here[:, :, 0].flatten()} == {0.0}
    shared = {tuple(line.flatten()) for line in here} & {tuple(line.flatten()) for line in there}
    assert len(shared) > 20
    assert set(here[:, :, 2].flatten()) == {0.0, 0.3}
    on_block = here[here[:, 0, 2] == 0.3]
    np.testing.assert_array_equal(on_block[:, 0, 0], [2.5, 3.0])
    np.testing.assert_array_equal(on_block[0, :, 1], [-1.0, 1.0])


def test_colours_tell_pits_ground_and_blocks_apart() -> None:
    boxes = np.zeros((4, 5))
    boxes[:, 4] = -0.5, 0.0, 0.2, 1.7
    low, level, between, high = ground_colours(boxes)
    np.testing.assert_array_equal([low, level, high], [LOW_COLOUR, LEVEL_COLOUR, HIGH_COLOUR])
    np.testing.assert_allclose(between, (np.array(LEVEL_COLOUR) + HIGH_COLOUR) / 2)
