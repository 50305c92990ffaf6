"""Terrain boxes against a plain loop over boxes, and far from where the track began."""

import numpy as np
import pytest

from ogmp_sb3.guidance.terrain import (
    BOX_DEPTH,
    NOTHING,
    TOP,
    X0,
    X1,
    Y0,
    Y1,
    Plateau,
    empty_terrain,
    geom_boxes,
    height_at,
    place,
    scan_points,
)


def boxes_of(terrain: np.ndarray, row: int = 0) -> list[tuple[float, ...]]:
    return [tuple(map(float, b)) for b in terrain[row] if b[TOP] > NOTHING]


def test_a_plateau_becomes_a_box_where_its_mode_starts():
    assert Plateau(0.5, 0.75, 0.3).box(8.0, 1.0) == (8.5, 8.75, -1.0, 1.0, 0.3)
    assert Plateau(-0.25, 0.25, 2.0, half_width=0.125).box(0.0, 1.0) == (-0.25, 0.25, -0.125, 0.125, 2.0)


def test_an_empty_terrain_has_no_ground_anywhere():
    terrain = empty_terrain(2, 3)
    assert terrain.shape == (2, 3, 5)
    assert (height_at(terrain, np.zeros((2, 4, 2))) == NOTHING).all()


def test_heights_equal_a_loop_over_boxes():
    rng = np.random.default_rng(0)
    terrain = empty_terrain(3, 6)
    for row in range(3):
        for box in range(row + 3):  # the rest stays unused
            x, y = np.sort(rng.uniform(-2, 2, 2)), np.sort(rng.uniform(-1, 1, 2))
            terrain[row, box] = (*x, *y, rng.uniform(-0.5, 0.5))
    points = rng.uniform(-2, 2, size=(3, 200, 2))
    heights = height_at(terrain, points)
    assert heights.shape == (3, 200)
    for row in range(3):
        for point, height in zip(points[row], heights[row], strict=True):
            over = [
                box[TOP]
                for box in terrain[row]
                if box[X0] <= point[0] < box[X1] and box[Y0] <= point[1] < box[Y1] and box[TOP] > NOTHING
            ]
            assert height == max(over, default=NOTHING)
    assert len(np.unique(heights)) > 6  # boxes, overlaps and nothing were all met


def test_touching_boxes_leave_no_gap_and_the_later_one_starts_at_the_seam():
    terrain = empty_terrain(1, 2)
    place(terrain, 0, [(0.0, 1.0, -1.0, 1.0, 0.0), (1.0, 2.0, -1.0, 1.0, 0.3)], -np.inf)
    below, seam = np.nextafter(1.0, 0.0), 1.0
    np.testing.assert_array_equal(height_at(terrain, np.array([[[below, 0.0], [seam, 0.0]]])), [[0.0, 0.3]])


def test_scan_points_lie_ahead_of_the_base_and_begin_under_it():
    position = np.array([[1.0, 2.0, 9.0], [-3.0, 4.0, 9.0]])
    points = scan_points(position, 4, 0.25)
    np.testing.assert_array_equal(points[0], [[1.0, 2.0], [1.25, 2.0], [1.5, 2.0], [1.75, 2.0]])
    np.testing.assert_array_equal(points[1], [[-3.0, 4.0], [-2.75, 4.0], [-2.5, 4.0], [-2.25, 4.0]])
    np.testing.assert_array_equal(position, [[1.0, 2.0, 9.0], [-3.0, 4.0, 9.0]])


def test_placing_extends_flat_ground_without_a_seam():
    terrain = empty_terrain(1, 3)
    flat = [(float(i), float(i + 1), -1.0, 1.0, 0.0) for i in range(10)]
    assert place(terrain, 0, flat[:4], -np.inf)
    assert place(terrain, 0, flat[4:], -np.inf)  # across two calls as well
    assert boxes_of(terrain) == [(0.0, 10.0, -1.0, 1.0, 0.0)]


@pytest.mark.parametrize(
    "second", [(1.0, 2.0, -1.0, 1.0, 0.1), (1.5, 2.0, -1.0, 1.0, 0.0), (1.0, 2.0, -0.5, 0.5, 0.0)],
    ids=["other height", "a hole between", "other width"],
)  # fmt: skip
def test_placing_keeps_boxes_apart_that_are_not_one_surface(second):
    terrain = empty_terrain(1, 3)
    first = (0.0, 1.0, -1.0, 1.0, 0.0)
    assert place(terrain, 0, [first, second], -np.inf)
    assert boxes_of(terrain) == [first, second]


def test_placing_drops_boxes_behind_and_touches_no_other_row():
    terrain = empty_terrain(2, 3)
    steps = [(float(i), float(i + 1), -1.0, 1.0, 0.1 * i) for i in range(4)]
    place(terrain, 1, steps[:2], -np.inf)
    place(terrain, 0, steps[:3], -np.inf)
    assert place(terrain, 0, steps[3:], keep_from=1.5)  # the box from 1 to 2 is still under something
    assert boxes_of(terrain, 0) == steps[1:]
    assert boxes_of(terrain, 1) == steps[:2]


def test_placing_skips_plateaus_without_length():
    terrain = empty_terrain(1, 2)
    assert place(terrain, 0, [(0.0, 0.0, -1.0, 1.0, 0.2), (0.0, 1.0, -1.0, 1.0, 0.0)], -np.inf)
    assert boxes_of(terrain) == [(0.0, 1.0, -1.0, 1.0, 0.0)]


def test_placing_says_when_there_is_no_room_and_changes_nothing():
    terrain = empty_terrain(1, 2)
    steps = [(float(i), float(i + 1), -1.0, 1.0, 0.1 * i) for i in range(3)]
    assert place(terrain, 0, steps[:2], -np.inf)
    before = terrain.copy()
    assert not place(terrain, 0, steps[2:], keep_from=0.5)
    np.testing.assert_array_equal(terrain, before)
    assert place(terrain, 0, steps[2:], keep_from=1.0)


def test_geoms_have_the_centre_and_half_size_of_their_box():
    terrain = np.array([[[1.0, 3.0, -0.5, 1.5, 0.25]]])
    centre, half = geom_boxes(terrain)
    np.testing.assert_array_equal(centre, [[[2.0, 0.5, 0.25 - BOX_DEPTH / 2]]])
    np.testing.assert_array_equal(half, [[[1.0, 1.0, BOX_DEPTH / 2]]])
    assert (centre + half)[..., 2] == 0.25  # its top is the ground


def test_a_high_block_stands_on_the_ground_of_the_others():
    centre, half = geom_boxes(np.array([[0.0, 1.0, -1.0, 1.0, 3.5]]))
    assert (centre[0, 2] - half[0, 2], centre[0, 2] + half[0, 2]) == pytest.approx((0.0, 3.5))


def test_geoms_of_unused_boxes_wait_out_of_reach_and_have_a_size():
    centre, half = geom_boxes(empty_terrain(2, 3))
    assert (half > 0).all()  # MuJoCo refuses boxes without size
    assert (centre[..., 2] + half[..., 2] <= NOTHING).all()


def test_an_endless_track_is_as_exact_far_out_as_at_its_start():
    terrain, pitch, x = empty_terrain(1, 8), 0.7, 0.0
    while x < 1e4:
        block = [Plateau(0.0, 0.45, 0.0), Plateau(0.45, pitch, 0.3)]
        assert place(terrain, 0, [plateau.box(x, 1.0) for plateau in block], keep_from=x - 1.5)
        last, x = x, x + pitch
    edges = np.array([last, last + 0.45, x])
    below = np.nextafter(edges, 0.0)
    on_edges = height_at(terrain, np.stack([edges, np.zeros(3)], axis=-1)[None])
    before_edges = height_at(terrain, np.stack([below, np.zeros(3)], axis=-1)[None])
    np.testing.assert_array_equal(on_edges, [[0.0, 0.3, NOTHING]])
    np.testing.assert_array_equal(before_edges, [[0.3, 0.0, 0.3]])
    used = terrain[0, terrain[0, :, TOP] > NOTHING]
    np.testing.assert_array_equal(used[1:, X0], used[:-1, X1])  # no slits
    centre, half = geom_boxes(used)
    np.testing.assert_allclose((centre - half)[:, 0], used[:, X0], rtol=0, atol=1e-11)
    np.testing.assert_allclose((centre + half)[:, 0], used[:, X1], rtol=0, atol=1e-11)
