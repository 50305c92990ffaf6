"""Terrain as boxes: what modes ask for, where the ground is, and which boxes each simulation gets.

A terrain is an array of boxes, shape (num_envs, boxes, 5), with the columns ``x0, x1, y0, y1, top`` (m, world).
Unused boxes have ``top = NOTHING``. Boxes may overlap; the highest one counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ogmp_sb3.machine import compiled

X0, X1, Y0, Y1, TOP = range(5)
NOTHING = -50.0  # m: height where there is no ground, and where unused boxes wait
BOX_DEPTH = 2.0  # m: vertical extent of a terrain box that is not higher


@dataclass(frozen=True)
class Plateau:
    """A flat piece of ground that a mode asks for, relative to where the mode starts."""

    start: float
    """m along the track"""
    end: float
    """m along the track"""
    top: float
    """m above the track's zero level"""
    half_width: float | None = None
    """m; None: as wide as the track"""

    def box(self, offset: float, track_half_width: float) -> tuple[float, float, float, float, float]:
        """The box of this plateau for a mode that starts at ``offset`` (m)."""
        half_width = track_half_width if self.half_width is None else self.half_width
        return (offset + self.start, offset + self.end, -half_width, half_width, self.top)


def empty_terrain(num_envs: int, boxes: int) -> np.ndarray:
    """A terrain without ground, shape (num_envs, boxes, 5)."""
    terrain = np.zeros((num_envs, boxes, 5))
    terrain[..., TOP] = NOTHING
    return terrain


def height_at(terrain: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Height of the ground at points.

    :param terrain: shape (num_envs, boxes, 5)
    :param xy: world positions, shape (num_envs, points, 2), m
    :return: shape (num_envs, points), m; ``NOTHING`` beside the track
    """
    heights = np.full(xy.shape[:2], NOTHING)
    _raise_heights(terrain, xy, heights)
    return heights


@compiled
def _raise_heights(terrain, xy, heights):  # type: ignore[no-untyped-def]
    for row in range(xy.shape[0]):
        for box in terrain[row]:
            for point in range(xy.shape[1]):
                x, y = xy[row, point]
                if box[0] <= x < box[1] and box[2] <= y < box[3] and box[4] > heights[row, point]:
                    heights[row, point] = box[4]


def scan_points(position: np.ndarray, points: int, spacing: float) -> np.ndarray:
    """The points of a terrain scan: along +x of the world from the base, starting under it.

    :param position: base position, shape (num_envs, 3), m
    :return: shape (num_envs, points, 2), m
    """
    xy = np.repeat(position[:, None, :2], points, axis=1)
    xy[..., 0] += spacing * np.arange(points)
    return xy


def place(terrain: np.ndarray, row: int, boxes: Sequence[tuple[float, ...]], keep_from: float) -> bool:
    """Add boxes to one environment, in place; boxes that end behind ``keep_from`` make room.

    A box that continues the last one at the same height extends it, so that flat ground has no seams.

    :param terrain: shape (num_envs, boxes, 5)
    :param row: the environment
    :param boxes: new boxes in order along the track
    :param keep_from: m along the track
    :return: False if there is no room
    """
    return bool(_place(terrain[row], np.array(boxes), keep_from))


@compiled
def _place(terrain, boxes, keep_from):  # type: ignore[no-untyped-def]
    count = 0
    for box in terrain:
        if box[TOP] > NOTHING and box[X1] > keep_from:
            terrain[count] = box
            count += 1
    for box in boxes:
        last = terrain[count - 1] if count > 0 else box
        if count > 0 and last[X1] == box[X0] and (last[Y0:] == box[Y0:]).all():
            last[X1] = box[X1]
        elif box[X1] > box[X0]:
            if count == len(terrain):
                return False
            terrain[count] = box
            count += 1
    terrain[count:] = 0.0
    terrain[count:, TOP] = NOTHING
    return True


def geom_boxes(terrain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """MuJoCo's box geoms of a terrain.

    :param terrain: shape (..., 5)
    :return: centres and half sizes, each of shape (..., 3), m
    """
    lower, upper = terrain[..., [X0, Y0]], terrain[..., [X1, Y1]]
    centre, half = np.empty((*terrain.shape[:-1], 3)), np.empty((*terrain.shape[:-1], 3))
    centre[..., :2], half[..., :2] = 0.5 * (lower + upper), np.maximum(0.5 * (upper - lower), 1e-3)
    depth = np.maximum(BOX_DEPTH, terrain[..., TOP])  # no block floats
    centre[..., 2], half[..., 2] = terrain[..., TOP] - 0.5 * depth, 0.5 * depth
    return centre, half
