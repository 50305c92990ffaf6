"""What stands on the stage of the browser viewer."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance.srb import POS, STATE_SIZE, deviation
from ogmp_sb3.rendering import viewer_scene as stage
from ogmp_sb3.rendering.player import Player

viser = pytest.importorskip("viser", reason="the browser viewer needs the extra 'viewer'")

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


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.mark.parametrize("geom", range(6))
def test_a_geom_is_drawn_as_large_as_mujoco_says_it_is(geom: int) -> None:
    model = mujoco.MjModel.from_xml_string(ALL_KINDS)
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    low, high = stage.geom_mesh(model, geom).bounds
    np.testing.assert_allclose(low, centre - half, atol=2e-3)
    np.testing.assert_allclose(high, centre + half, atol=2e-3)


def test_a_plane_is_no_part_of_a_robot() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom type='plane' size='1 1 1'/></worldbody></mujoco>")
    with pytest.raises(ValueError, match="mjGEOM_PLANE cannot be drawn"):
        stage.geom_mesh(model, 0)


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
    shape = stage.bound_mesh(task)
    surface = np.concatenate([shape.vertices[shape.faces].reshape(-1, 3), shape.triangles_center])
    state = np.zeros((len(surface), STATE_SIZE))
    state[:, POS] = surface
    found = deviation(state, np.zeros_like(state), np.array(task.bound_weights))
    np.testing.assert_allclose(found, 0.4, rtol=0.02)
    free = [i for i, name in enumerate("xyz") if name not in bound]
    np.testing.assert_allclose(shape.bounds[1, free], stage.BOUND_EXTENT)


@pytest.mark.parametrize("change", [{"rho": None}, {"bound": {"vx": 1.0, "roll": 1.0}}], ids=str)
def test_what_is_not_bounded_is_not_drawn(change: dict) -> None:
    assert stage.bound_mesh(replace(load_task("parkour"), **change)) is None


def test_the_bound_turns_red_outside(server: viser.ViserServer) -> None:
    player = Player(load_task("parkour"), None)
    scene = stage.Stage(server, player.task, player.frame)
    for deviation_, colour in ((0.49, stage.INSIDE_COLOUR), (0.51, stage.OUTSIDE_COLOUR)):
        frame = replace(player.frame, deviation=deviation_)
        scene.show(frame, frame.robot, frame.ghost)
        assert tuple(scene.bound.color) == colour
        np.testing.assert_allclose(scene.bound.position, frame.reference)


def test_boxes_are_where_the_terrain_is_and_no_longer_when_it_is_gone(server: viser.ViserServer) -> None:
    player = Player(load_task("parkour"), None)
    scene = stage.Stage(server, player.task, player.frame)
    boxes = np.array([(0.0, 1.0, -1.0, 1.0, 0.0), (1.0, 1.4, -1.0, 1.0, 0.3)])
    for terrain in (boxes, boxes[1:]):
        scene.show(replace(player.frame, terrain=terrain), player.frame.robot, player.frame.ghost)
        shown = [box for box in scene._boxes if box.visible]
        assert len(shown) == len(terrain)
        for box, (x0, x1, y0, y1, top) in zip(shown, terrain, strict=True):
            upper = np.array(box.position) + 0.5 * np.array(box.dimensions)
            np.testing.assert_allclose(upper, (x1, y1, top), atol=1e-9)
            np.testing.assert_allclose(box.dimensions[:2], (x1 - x0, y1 - y0))


def test_the_ghost_stands_at_the_reference_and_the_robot_where_it_is(server: viser.ViserServer) -> None:
    player = Player(load_task("dive"), None)
    for _ in range(30):
        frame = player.step()
    scene = stage.Stage(server, player.task, frame)
    robot = frame.ghost.copy()
    robot[:3] += (0.1, 0.2, 0.3)
    scene.show(frame, robot, frame.ghost)
    ghost, figure = scene.ghost.bodies[1], scene.robot.bodies[1]
    np.testing.assert_allclose(ghost.position, frame.reference)
    np.testing.assert_allclose(np.array(figure.position) - ghost.position, (0.1, 0.2, 0.3))
    np.testing.assert_allclose(ghost.wxyz, frame.ghost[3:7])
