"""What stands on the stage of the browser viewer."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.rendering import viewer_scene as stage
from ogmp_sb3.rendering.player import Player

viser = pytest.importorskip("viser", reason="the browser viewer needs the extra 'viewer'")


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


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
