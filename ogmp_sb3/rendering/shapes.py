"""Surfaces as triangles: the geoms of a robot, and the permissible states around a reference."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.ground_contacts import touching
from ogmp_sb3.env.robot_model import VISIBLE_GROUPS
from ogmp_sb3.guidance.srb import POS

SEGMENTS = 32  # around a body of revolution; a multiple of 4, so that it reaches as far as the round one
BOUND_EXTENT = 0.6  # m: half the size of the drawn bound along directions that are not bounded


class Mesh(NamedTuple):
    """Triangles, counter-clockwise seen from outside."""

    vertices: np.ndarray
    """shape (vertices, 3), m"""
    faces: np.ndarray
    """indices of corners, shape (faces, 3), int"""

    def scaled(self, factors: np.ndarray | float) -> Mesh:
        """This mesh, larger along each axis by a factor."""
        return Mesh(self.vertices * factors, self.faces)


def clustered(mesh: Mesh, cell: float) -> Mesh:
    """A coarser mesh: the vertices in a cell of a grid become one, their mean; triangles within a cell go.

    :param cell: width of a cell, m
    """
    cells, place = np.unique(np.round(mesh.vertices / cell).astype(int), axis=0, return_inverse=True)
    place = place.reshape(-1)
    count = np.bincount(place)
    sums = [np.bincount(place, axis, len(cells)) for axis in mesh.vertices.T]
    faces = place[mesh.faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return Mesh(np.stack(sums, axis=1) / count[:, None], faces[whole])


def visible_geoms(model: mujoco.MjModel) -> list[int]:
    """The geoms of a robot that are drawn."""
    drawn = np.isin(model.geom_group, VISIBLE_GROUPS) & (model.geom_bodyid > 0)
    return np.flatnonzero(drawn).tolist()


def collision_geoms(model: mujoco.MjModel) -> list[int]:
    """The geoms of a robot that can touch something, of those that :func:`geom_mesh` can draw."""
    drawable = (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_type != mujoco.mjtGeom.mjGEOM_HFIELD)
    return np.flatnonzero(touching(model) & drawable & (model.geom_bodyid > 0)).tolist()


def geom_colour(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Red, green and blue of a geom, shape (3,), 0 to 1."""
    material = model.geom_matid[geom]
    rgba: np.ndarray = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    return rgba[:3]


def geom_mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    """The surface of a geom, in its own frame.

    :raises ValueError: for a kind of geom that cannot be drawn (planes and height fields are no part of a robot)
    """
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return box().scaled(size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return revolved(np.array([(0.0, -1.0), (1.0, -1.0), (1.0, 1.0), (0.0, 1.0)])).scaled(size[[0, 0, 1]])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        arc = size[0] * _half_circle()
        lower, upper = arc[: len(arc) // 2 + 1], arc[len(arc) // 2 :]
        middle = np.array([0.0, size[1]])
        return revolved(np.concatenate([lower - middle, upper + middle]))
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return sphere().scaled(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return sphere().scaled(size)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        number = model.geom_dataid[geom]
        vertices = slice(model.mesh_vertadr[number], model.mesh_vertadr[number] + model.mesh_vertnum[number])
        faces = slice(model.mesh_faceadr[number], model.mesh_faceadr[number] + model.mesh_facenum[number])
        return Mesh(model.mesh_vert[vertices], model.mesh_face[faces])
    raise ValueError(f"a geom of kind {kind.name} cannot be drawn.")


def bound_mesh(task: TaskConfig) -> Mesh | None:
    """Where the base may be, around its reference: ``||W (x - x_ref)|| <= rho`` with nothing but the position off.

    One bounded component gives two planes, two an elliptic tube, three an ellipsoid.

    :return: None if there is no bound, or none on the position
    """
    weights = np.array(task.bound_weights)[POS]
    bounded = weights > 0
    if task.rho is None or not bounded.any():
        return None
    half = np.where(bounded, task.rho / np.where(bounded, weights, 1.0), BOUND_EXTENT)
    if bounded.all():
        return sphere().scaled(half)
    if bounded.sum() == 2:
        tube = revolved(np.array([(1.0, -1.0), (1.0, 1.0)]))
        free = int(np.argmin(bounded))
        turned = np.roll(tube.vertices, free - 2, axis=1)  # its axis, z, becomes the direction that is not bounded
        return Mesh(turned, tube.faces).scaled(half)
    whole = box()
    sides = whole.vertices[whole.faces][..., int(np.argmax(bounded))]  # of the corners of each triangle
    return Mesh(whole.vertices, whole.faces[np.ptp(sides, axis=1) == 0.0]).scaled(half)


def box() -> Mesh:
    """A cube from -1 to 1."""
    vertices = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return Mesh(vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def sphere() -> Mesh:
    """A sphere of radius 1."""
    return revolved(_half_circle())


def revolved(profile: np.ndarray) -> Mesh:
    """A body of revolution around z.

    :param profile: distance from the axis and height, from bottom to top, shape (points, 2), m
    """
    angles = 2.0 * np.pi / SEGMENTS * np.arange(SEGMENTS)
    radius, height = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), SEGMENTS))
    rings = np.stack([radius * np.cos(angles), radius * np.sin(angles), height], axis=2)
    here = np.arange(len(profile) * SEGMENTS).reshape(len(profile), SEGMENTS)
    low, low_next = here[:-1].ravel(), np.roll(here, -1, axis=1)[:-1].ravel()
    high, high_next = here[1:].ravel(), np.roll(here, -1, axis=1)[1:].ravel()
    faces = np.concatenate([np.stack([low, low_next, high_next], 1), np.stack([low, high_next, high], 1)])
    # A ring on the axis is one vertex, and has no triangles of its own.
    vertices, place = np.unique(rings.reshape(-1, 3).round(12) + 0.0, axis=0, return_inverse=True)
    faces = place.reshape(-1)[faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return Mesh(vertices, faces[whole])


def _half_circle() -> np.ndarray:
    """The profile of a sphere of radius 1, shape (points, 2); the middle one is on the equator."""
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SEGMENTS // 2 + 1)
    return np.stack([np.cos(angles).round(12), np.sin(angles)], axis=1)
