"""Surfaces as triangles."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.guidance.srb import POS, STATE_SIZE, deviation
from ogmp_sb3.rendering import shapes

ALL_KINDS = """
<mujoco>
  <asset><mesh name="wedge" vertex="0 0 0  0.3 0 0  0 0.2 0  0 0 0.1"/></asset>
  <worldbody>
    <body>
      <geom type="box" size="0.1 0.2 0.3" mass="1"/>
      <geom type="cylinder" size="0.1 0.2" mass="1"/>
      <geom type="capsule" size="0.1 0.2" mass="1"/>
      <geom type="sphere" size="0.1" mass="1"/>
      <geom type="ellipsoid" size="0.1 0.2 0.3" mass="1"/>
      <geom type="mesh" mesh="wedge" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""


def volume(mesh: shapes.Mesh) -> float:
    """Of a closed surface; below 0 if it is inside out."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize("geom", range(6))
def test_a_geom_is_drawn_as_large_as_mujoco_says_it_is(geom: int) -> None:
    model = mujoco.MjModel.from_xml_string(ALL_KINDS)
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    mesh = shapes.geom_mesh(model, geom)
    used = mesh.vertices[np.unique(mesh.faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    np.testing.assert_allclose(low, centre - half, atol=2e-3)
    np.testing.assert_allclose(high, centre + half, atol=2e-3)


@pytest.mark.parametrize(
    ("geom", "true"),
    [
        (0, 8 * 0.1 * 0.2 * 0.3),
        (1, np.pi * 0.1**2 * 0.4),
        (2, np.pi * 0.1**2 * 0.4 + 4 / 3 * np.pi * 0.1**3),
        (3, 4 / 3 * np.pi * 0.1**3),
        (4, 4 / 3 * np.pi * 0.1 * 0.2 * 0.3),
        (5, 0.3 * 0.2 * 0.1 / 6),
    ],
)
def test_a_geom_is_closed_and_faces_outwards(geom: int, true: float) -> None:
    mesh = shapes.geom_mesh(mujoco.MjModel.from_xml_string(ALL_KINDS), geom)
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    assert {tuple(e) for e in edges.tolist()} == {tuple(e) for e in edges[:, ::-1].tolist()}
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert volume(mesh) == pytest.approx(true, rel=0.02)


def test_what_only_collides_is_not_drawn_and_a_material_gives_the_colour() -> None:
    robot = load_task("parkour").robot_config
    model = build_model(robot, 0.002, 2, visual=True)
    geoms = shapes.visible_geoms(model)
    assert geoms and all(model.geom_group[i] == 1 for i in geoms)
    accent = np.array([0.93, 0.45, 0.10])  # a material of the robot's file
    assert any(np.allclose(shapes.geom_colour(model, i), accent) for i in geoms)


def test_a_plane_is_no_part_of_a_robot() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom type='plane' size='1 1 1'/></worldbody></mujoco>")
    with pytest.raises(ValueError, match="mjGEOM_PLANE cannot be drawn"):
        shapes.geom_mesh(model, 0)


@pytest.mark.parametrize(
    "bound",
    [
        {"x": 1.0},
        {"z": 2.0},
        {"x": 1.0, "z": 2.0},
        {"y": 1.0, "z": 0.5},
        {"x": 1.0, "y": 2.0},
        {"x": 1.0, "y": 2.0, "z": 3.0},
        {"x": 2.0, "vx": 1.0},
    ],
    ids=str,
)
def test_the_drawn_bound_is_where_the_deviation_is_rho(bound: dict[str, float]) -> None:
    task = replace(load_task("parkour"), bound=bound, rho=0.4)
    shape = shapes.bound_mesh(task)
    corners = shape.vertices[shape.faces]
    surface = np.concatenate([corners.reshape(-1, 3), corners.mean(axis=1)])
    state = np.zeros((len(surface), STATE_SIZE))
    state[:, POS] = surface
    found = deviation(state, np.zeros_like(state), np.array(task.bound_weights))
    np.testing.assert_allclose(found, 0.4, rtol=0.02)
    free = [i for i, name in enumerate("xyz") if name not in bound]
    np.testing.assert_allclose(shape.vertices.max(axis=0)[free], shapes.BOUND_EXTENT)


@pytest.mark.parametrize("change", [{"rho": None}, {"bound": {"vx": 1.0, "roll": 1.0}}], ids=str)
def test_what_is_not_bounded_is_not_drawn(change: dict) -> None:
    assert shapes.bound_mesh(replace(load_task("parkour"), **change)) is None
