"""What stands on the stage of the browser viewer."""

from __future__ import annotations

import contextlib
import io
import itertools
from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.rendering import viewer_scene as stage
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.shapes import collision_geoms
from ogmp_sb3.rendering.viewer_settings import Settings

viser = pytest.importorskip("viser", reason="the browser viewer needs the extra 'viewer'")


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


def test_the_bound_turns_red_outside(server: viser.ViserServer) -> None:
    player = Player(load_task("parkour"), None)
    scene = stage.Stage(server, [(player.task, "")], player.frame, Settings())
    for deviation_, colour in ((0.49, stage.INSIDE_COLOUR), (0.51, stage.OUTSIDE_COLOUR)):
        frame = replace(player.frame, deviation=deviation_)
        scene.show([stage.Moment(frame, frame.robot, frame.ghost)])
        assert tuple(scene.lanes[0].bound.color) == colour
        np.testing.assert_allclose(scene.lanes[0].bound.position, frame.reference)


def test_boxes_are_where_the_terrain_is_and_no_longer_when_it_is_gone(server: viser.ViserServer) -> None:
    player = Player(load_task("parkour"), None)
    scene = stage.Stage(server, [(player.task, "")], player.frame, Settings())
    boxes = np.array([(0.0, 1.0, -1.0, 1.0, 0.0), (1.0, 1.4, -1.0, 1.0, 0.3)])
    for terrain in (boxes, boxes[1:]):
        scene.show([stage.Moment(replace(player.frame, terrain=terrain), player.frame.robot, player.frame.ghost)])
        shown = [box for box in scene.lanes[0]._boxes if box.visible]
        assert len(shown) == len(terrain)
        for box, (x0, x1, y0, y1, top) in zip(shown, terrain, strict=True):
            upper = np.array(box.position) + 0.5 * np.array(box.dimensions)
            np.testing.assert_allclose(upper, (x1, y1, top), atol=1e-9)
            np.testing.assert_allclose(box.dimensions[:2], (x1 - x0, y1 - y0))


def test_the_ghost_stands_at_the_reference_and_the_robot_where_it_is(server: viser.ViserServer) -> None:
    player = Player(load_task("dive"), None)
    for _ in range(30):
        frame = player.step()
    scene = stage.Stage(server, [(player.task, "")], frame, Settings())
    robot = frame.ghost.copy()
    robot[:3] += (0.1, 0.2, 0.3)
    scene.show([stage.Moment(frame, robot, frame.ghost)])
    ghost, figure = scene.lanes[0].ghost.bodies[1], scene.lanes[0].robot.bodies[1]
    np.testing.assert_allclose(ghost.position, frame.reference)
    np.testing.assert_allclose(np.array(figure.position) - ghost.position, (0.1, 0.2, 0.3))
    np.testing.assert_allclose(ghost.wxyz, frame.ghost[3:7])


def test_forces_are_arrows_as_long_as_their_share_of_the_weight(server: viser.ViserServer) -> None:
    player = Player(load_task("parkour"), None)
    scene = stage.Stage(server, [(player.task, "")], player.frame, Settings(contacts=True))
    (lane,) = scene.lanes
    weight = 9.81 * float(lane.robot.model.body_mass.sum())
    points, forces = np.array([[1.0, 2.0, 0.0]]), np.array([[0.0, 0.0, 0.5 * weight]])
    scene.show([stage.Moment(player.frame, player.frame.robot, player.frame.ghost, (points, forces))])
    assert lane.contacts.visible
    np.testing.assert_allclose(lane.contacts.points[0, 1] - points[0], (0.0, 0.0, 0.5 * stage.FORCE_LENGTH), atol=1e-6)
    np.testing.assert_allclose(lane.contacts.points[0, 0], points[0])
    nothing = np.zeros((0, 3)), np.zeros((0, 3))
    scene.show([stage.Moment(player.frame, player.frame.robot, player.frame.ghost, nothing)])
    np.testing.assert_array_equal(lane.contacts.points, np.zeros((1, 2, 3)))


def test_what_is_set_is_what_is_seen(server: viser.ViserServer) -> None:
    player = Player(load_task("parkour"), None)
    settings = Settings(ghost=False, plan=False, bound=False, field_of_view=90.0)
    scene = stage.Stage(server, [(player.task, "")], player.frame, settings)
    (lane,) = scene.lanes
    assert not (lane.ghost.node.visible or lane.trail.visible or lane.bound.visible or lane.contacts.visible)
    assert lane.collision is None and server.initial_camera.fov == pytest.approx(np.pi / 2)
    settings.ghost = settings.collision = True
    scene.apply()
    assert lane.ghost.node.visible and lane.collision is not None and lane.collision.node.visible
    settings.collision = False
    scene.apply()
    assert not lane.collision.node.visible


def test_the_camera_follows_a_dive_down_and_is_not_shaken_by_hops(server: viser.ViserServer) -> None:
    player = Player(load_task("dive"), None)
    scene = stage.Stage(server, [(player.task, "")], player.frame, Settings())
    start = player.frame.ghost.copy()
    hop, landed = start.copy(), start.copy()
    hop[2], landed[2] = hop[2] + 0.1, landed[2] - 1.2
    scene.show([stage.Moment(player.frame, hop, start)])
    assert abs(scene.world.position[2]) < 0.02
    for _ in range(90):  # 3 s
        scene.show([stage.Moment(player.frame, landed, start)])
    assert scene.world.position[2] == pytest.approx(1.2, abs=0.01)


def test_robots_side_by_side_have_lanes_that_do_not_overlap_and_names(server: viser.ViserServer) -> None:
    players = [Player(load_task(name), None) for name in ("parkour", "dive", "stairs")]
    named = [(player.task, player.task.name) for player in players]
    scene = stage.Stage(server, named, players[0].frame, Settings())
    scene.show([stage.Moment(p.frame, p.frame.robot, p.frame.ghost) for p in players])
    edges = [
        (lane.node.position[1] - 0.5 * p.task.track.width, lane.node.position[1] + 0.5 * p.task.track.width)
        for lane, p in zip(scene.lanes, players, strict=True)
    ]
    assert all(left[1] < right[0] for left, right in itertools.pairwise(edges))
    assert [lane.label.text for lane in scene.lanes] == ["parkour", "dive", "stairs"]


def test_what_can_touch_something_is_the_collision_geometry() -> None:
    task = load_task("parkour")
    model = build_model(task.robot_config, 0.002, 0, visual=True)
    geoms = collision_geoms(model)
    assert geoms and all(model.geom_contype[i] | model.geom_conaffinity[i] for i in geoms)
    assert {model.geom_bodyid[i] for i in geoms} >= {model.body(foot).id for foot in task.robot_config.feet}


def test_a_geom_that_touches_by_a_pair_alone_is_collision_geometry_too() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom name="floor" type="box" size="1 1 0.1"/><body><freejoint/>
        <geom name="sole" size="0.1" contype="0" conaffinity="0"/><geom size="0.2" contype="0" conaffinity="0"/>
        </body></worldbody><contact><pair geom1="floor" geom2="sole"/></contact></mujoco>"""
    )
    assert collision_geoms(model) == [model.geom("sole").id]
