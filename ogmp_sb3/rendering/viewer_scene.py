"""The scene of the browser viewer: robots, ghosts, ground, plans, bounds and contacts as nodes of viser."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.guidance.terrain import geom_boxes
from ogmp_sb3.rendering.frame import GHOST_COLOUR, MARK_COLOUR, Colour, Frame, ground_colours, ground_marks
from ogmp_sb3.rendering.shapes import bound_mesh, collision_geoms, geom_colour, geom_mesh, visible_geoms
from ogmp_sb3.rendering.viewer_settings import Settings

if TYPE_CHECKING:
    import viser

GHOST_OPACITY, BOUND_OPACITY = 0.25, 0.2
COLLISION_COLOUR, FORCE_COLOUR = (230, 120, 40), (220, 50, 40)
FORCE_LENGTH = 0.3  # m: an arrow as long as this is the robot's weight
LANE_SPACING = 1.2  # widths of a track between two robots
LABEL_RISE = 0.45  # m over the base
CAMERA_RISE = 0.1  # share of the way to the robot's height that the camera goes with each update
INSIDE_COLOUR, OUTSIDE_COLOUR = (50, 170, 90), (220, 50, 40)
CAMERA_FROM, CAMERA_AT = np.array([0.6, -2.0, 0.6]), np.array([0.2, 0.0, -0.1])  # m, from the robot
UPRIGHT_FROM, UPRIGHT_AT = np.array([0.6, -3.4, 0.6]), np.array([0.3, 0.0, -0.8])  # the same on a screen upright
SKY_TOP, SKY_BOTTOM = (150, 178, 208), (236, 240, 244)
SUN, SUN_LIGHT, SKY_LIGHT = (-1.5, -2.0, 4.0), 2.0, 1.7
LINE_WIDTH, LINE_RISE = 0.012, 0.008  # m, m above the ground


class Stage:
    """Shows frames. The world moves under a robot that stays, so that every visitor can turn a camera of his own.

    :param server: the viser server
    :param tasks: of each robot, as in training, with its name, which stands over it where there are several
    :param frame: the first frame of the first robot, for the camera
    :param settings: what visitors have set
    """

    def __init__(
        self, server: viser.ViserServer, tasks: Sequence[tuple[TaskConfig, str]], frame: Frame, settings: Settings
    ) -> None:
        self.server, self.settings = server, settings
        scene = server.scene
        scene.set_background_image(_sky())
        scene.configure_default_lights(False)
        scene.configure_environment_map(None)
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(190, 180, 165), intensity=SKY_LIGHT)
        scene.add_light_directional("/sun", position=SUN, intensity=SUN_LIGHT, cast_shadow=True)
        self._height = self._start = float(frame.base[2])
        place = np.array([0.0, 0.0, self._start])
        server.initial_camera.position, server.initial_camera.look_at = place + CAMERA_FROM, place + CAMERA_AT
        for client in server.get_clients().values():
            self.welcome(client)
        self.world = scene.add_frame("/world", show_axes=False)
        alone, offset = len(tasks) == 1, 0.0
        self.lanes: list[Lane] = []
        for number, (task, name) in enumerate(tasks):
            self.lanes.append(Lane(server, f"/world/{number}", task, "" if alone else name, offset))
            offset += LANE_SPACING * task.track.width
        self.apply()

    def welcome(self, client: viser.ClientHandle) -> None:
        """Point the camera of a visitor; on a screen upright, as of a phone, at the robot above the controls."""
        client.camera.fov = self.server.initial_camera.fov
        if client.camera.aspect < 1.0:
            place = np.array([0.0, 0.0, self._start])
            client.camera.position, client.camera.look_at = place + UPRIGHT_FROM, place + UPRIGHT_AT

    def apply(self) -> None:
        """Show what is set to be shown."""
        settings = self.settings
        for lane in self.lanes:
            lane.ghost.node.visible, lane.trail.visible = settings.ghost, settings.plan
            if lane.bound is not None:
                lane.bound.visible = settings.bound
            lane.contacts.visible = settings.contacts
            lane.show_collision(settings.collision)
        fov = math.radians(settings.field_of_view)
        self.server.initial_camera.fov = fov
        for client in self.server.get_clients().values():
            client.camera.fov = fov

    def show(self, moments: Sequence[Moment]) -> None:
        """Bring the scene to a moment of each robot."""
        with self.server.atomic():
            bases = [lane.show(moment) for lane, moment in zip(self.lanes, moments, strict=True)]
            if self.settings.follow:
                x, y, z = bases[0]
                self._height += CAMERA_RISE * (z - self._height)  # hops do not shake it, falls from a block are seen
                self.world.position = (-x, -y, self._start - self._height)


@dataclass(frozen=True)
class Moment:
    """A robot at a frame, or between two."""

    frame: Frame
    """the frame"""
    robot: np.ndarray
    """generalised position of the robot, the frame's or one on the way to it, shape (nq,); empty: none"""
    ghost: np.ndarray
    """the same of the ghost, shape (nq,)"""
    contacts: tuple[np.ndarray, np.ndarray] | None = None
    """where it touches the ground, shape (n, 3), m, and the forces there, shape (n, 3), N; None: as before"""


class Lane:
    """What belongs to one robot: figure, ghost, plan, bound, contacts, and the ground it runs on.

    :param server: the viser server
    :param path: name of its node
    :param task: the task as in training; its bound is drawn
    :param name: stands over the robot; empty: nothing
    :param offset: to the left of the first, m
    """

    def __init__(self, server: viser.ViserServer, path: str, task: TaskConfig, name: str, offset: float) -> None:
        scene, model = server.scene, build_model(task.robot_config, task.physics_dt, 0, visual=True)
        self.server, self.path, self.rho, self._model = server, path, task.rho, model
        self.node = scene.add_frame(path, show_axes=False, position=(0.0, offset, 0.0))
        self._base = model.body(task.robot_config.base).id
        self._weight = float(model.body_mass.sum() * np.linalg.norm(model.opt.gravity))
        self.robot = Figure(scene, f"{path}/robot", model, self._base)
        self.ghost = Figure(scene, f"{path}/ghost", model, self._base, GHOST_COLOUR, GHOST_OPACITY)
        self.collision: Figure | None = None
        self.label = scene.add_label(f"{path}/name", name) if name else None
        self.trail = _add_lines(scene, f"{path}/trail", GHOST_COLOUR)
        self.contacts = scene.add_arrows(
            f"{path}/contacts", np.zeros((1, 2, 3), np.float32), FORCE_COLOUR,
            shaft_radius=0.008, head_radius=0.02, head_length=0.04,
        )  # fmt: skip
        self._marks = _add_lines(scene, f"{path}/marks", MARK_COLOUR)
        self._boxes: list[Any] = []
        self._ground, self._lines = np.zeros((0, 5)), np.zeros((0, 2, 3))
        self.bound: Any = None
        shape = bound_mesh(task)
        if shape is not None:
            self.bound = scene.add_mesh_simple(
                f"{path}/bound",
                shape.vertices,
                shape.faces,
                opacity=BOUND_OPACITY,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )

    def show_collision(self, visible: bool) -> None:
        """Show or hide what of the robot can touch something."""
        if self.collision is None and visible:
            geoms = collision_geoms(self._model)
            self.collision = Figure(
                self.server.scene, f"{self.path}/collision", self._model, self._base, COLLISION_COLOUR, 0.6, geoms
            )
        if self.collision is not None:
            self.collision.node.visible = visible

    def show(self, moment: Moment) -> np.ndarray:
        """Bring the robot and what is around it to a moment, and return where its base is, shape (3,), m."""
        frame = moment.frame
        reference = self.ghost.pose(moment.ghost)
        base = self.robot.pose(moment.robot) if len(moment.robot) else reference
        self.robot.node.visible = bool(len(moment.robot))
        if self.collision is not None and self.collision.node.visible and len(moment.robot):
            self.collision.pose(moment.robot)
        if self.bound is not None and self.rho is not None:
            self.bound.position = reference
            self.bound.color = INSIDE_COLOUR if frame.deviation <= self.rho else OUTSIDE_COLOUR
        if self.label is not None:
            self.label.position = base + np.array([0.0, 0.0, LABEL_RISE])
        if moment.contacts is not None:
            points, forces = moment.contacts
            arrows = np.stack([points, points + forces * FORCE_LENGTH / self._weight], axis=1)
            self.contacts.points = (arrows if len(arrows) else np.zeros((1, 2, 3))).astype(np.float32)
        self.trail.points = _segments(frame.trail)
        self._show_ground(frame.terrain, base[0])
        return base

    def _show_ground(self, terrain: np.ndarray, x: float) -> None:
        lines = ground_marks(terrain, x)
        if not np.array_equal(lines, self._lines):
            self._marks.points, self._lines = (lines + np.array([0.0, 0.0, LINE_RISE])).astype(np.float32), lines
        if np.array_equal(terrain, self._ground):
            return
        self._ground = terrain
        while len(self._boxes) < len(terrain):
            path = f"{self.path}/ground/{len(self._boxes)}"
            self._boxes.append(self.server.scene.add_box(path, cast_shadow=False))
        for box, centre, half, colour in zip(
            self._boxes, *geom_boxes(terrain), ground_colours(terrain).astype(int).tolist(), strict=False
        ):
            box.position, box.dimensions, box.color = centre, tuple(2.0 * half), tuple(colour)
        for i, box in enumerate(self._boxes):
            box.visible = i < len(terrain)


class Figure:
    """A robot in the scene.

    :param scene: viser's scene
    :param path: name of its node
    :param model: the robot alone
    :param base: its base, a body
    :param colour: of all of it; None: as in the model
    :param opacity: None: opaque
    :param geoms: which of its geoms; None: those that are drawn
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        path: str,
        model: mujoco.MjModel,
        base: int,
        colour: Colour | None = None,
        opacity: float | None = None,
        geoms: list[int] | None = None,
    ) -> None:
        self.model, self.data, self.base = model, mujoco.MjData(model), base
        self.node = scene.add_frame(path, show_axes=False)
        self.bodies: dict[int, viser.FrameHandle] = {}
        for i in visible_geoms(model) if geoms is None else geoms:
            body = int(model.geom_bodyid[i])
            if body not in self.bodies:
                self.bodies[body] = scene.add_frame(f"{path}/{body}", show_axes=False)
            mesh = geom_mesh(model, i)
            scene.add_mesh_simple(
                f"{path}/{body}/{i}",
                mesh.vertices,
                mesh.faces,
                color=colour or geom_colour(model, i),
                opacity=opacity,
                flat_shading=True,
                cast_shadow=opacity is None,
                receive_shadow=opacity is None,
                position=model.geom_pos[i],
                wxyz=model.geom_quat[i],
            )

    def pose(self, qpos: np.ndarray) -> np.ndarray:
        """Move it, and return where its base is, shape (3,), m.

        :param qpos: generalised position, shape (nq,)
        """
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        for body, node in self.bodies.items():
            node.position, node.wxyz = self.data.xpos[body], self.data.xquat[body]
        return self.data.xpos[self.base].copy()  # type: ignore[no-any-return]


def _segments(points: np.ndarray) -> np.ndarray:
    """A polyline as viser's line segments, shape (n - 1, 2, 3), float32."""
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


def _add_lines(scene: viser.SceneApi, path: str, colour: Colour) -> viser.LineSegmentsHandle:
    return scene.add_line_segments(path, np.zeros((1, 2, 3), np.float32), colour, thickness=LINE_WIDTH)


def _sky() -> np.ndarray:
    """A picture that fades from top to bottom, shape (height, width, 3), uint8."""
    share = np.linspace(0.0, 1.0, 256)[:, None, None]
    fade = (1.0 - share) * np.array(SKY_TOP) + share * np.array(SKY_BOTTOM)
    return np.broadcast_to(fade, (256, 16, 3)).astype(np.uint8)
