"""The scene of the browser viewer: robot, ghost, ground, plan and bound as nodes of viser."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.guidance.terrain import geom_boxes
from ogmp_sb3.rendering.frame import GHOST_COLOUR, MARK_COLOUR, Colour, Frame, ground_colours, ground_marks
from ogmp_sb3.rendering.shapes import bound_mesh, geom_colour, geom_mesh, visible_geoms

if TYPE_CHECKING:
    import viser

GHOST_OPACITY, BOUND_OPACITY = 0.3, 0.2
INSIDE_COLOUR, OUTSIDE_COLOUR = (50, 170, 90), (220, 50, 40)
CAMERA_FROM, CAMERA_AT = np.array([0.6, -2.0, 0.6]), np.array([0.2, 0.0, -0.1])  # m, from the robot
SKY_TOP, SKY_BOTTOM = (150, 178, 208), (236, 240, 244)
SUN, SUN_LIGHT, SKY_LIGHT = (-1.5, -2.0, 4.0), 2.0, 1.7
LINE_WIDTH, LINE_RISE = 0.012, 0.008  # m, m above the ground


class Stage:
    """Shows frames. The world moves under a robot that stays, so that every visitor can turn a camera of his own.

    :param server: the viser server
    :param task: the task as in training; its bound is drawn
    :param frame: the first frame, for the camera
    """

    def __init__(self, server: viser.ViserServer, task: TaskConfig, frame: Frame) -> None:
        self.server, self.rho, self.follow = server, task.rho, True
        scene, model = server.scene, build_model(task.robot_config, task.physics_dt, 0, visual=True)
        scene.set_background_image(_sky())
        scene.configure_default_lights(False)
        scene.configure_environment_map(None)
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(190, 180, 165), intensity=SKY_LIGHT)
        scene.add_light_directional("/sun", position=SUN, intensity=SUN_LIGHT, cast_shadow=True)
        place = np.array([0.0, 0.0, frame.base[2]])
        server.initial_camera.position, server.initial_camera.look_at = place + CAMERA_FROM, place + CAMERA_AT
        self.world = scene.add_frame("/world", show_axes=False)
        base = model.body(task.robot_config.base).id
        self.robot = Figure(scene, "/world/robot", model, base)
        self.ghost = Figure(scene, "/world/ghost", model, base, GHOST_COLOUR, GHOST_OPACITY)
        self.trail = _add_lines(scene, "/world/trail", GHOST_COLOUR)
        self._marks = _add_lines(scene, "/world/marks", MARK_COLOUR)
        self._boxes: list[Any] = []
        self._ground, self._lines = np.zeros((0, 5)), np.zeros((0, 2, 3))
        self.bound: Any = None
        shape = bound_mesh(task)
        if shape is not None:
            self.bound = scene.add_mesh_simple(
                "/world/bound",
                shape.vertices,
                shape.faces,
                opacity=BOUND_OPACITY,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )

    def show(self, frame: Frame, robot: np.ndarray, ghost: np.ndarray) -> None:
        """Bring the scene to a frame.

        :param frame: the frame
        :param robot: generalised position of the robot, the frame's or one on the way to it; empty: none
        :param ghost: the same of the ghost
        """
        with self.server.atomic():
            reference = self.ghost.pose(ghost)
            base = self.robot.pose(robot) if len(robot) else reference
            self.robot.node.visible = bool(len(robot))
            if self.bound is not None and self.rho is not None:
                self.bound.position = reference
                self.bound.color = INSIDE_COLOUR if frame.deviation <= self.rho else OUTSIDE_COLOUR
            if self.follow:
                self.world.position = (-base[0], -base[1], 0.0)
            self.trail.points = _segments(frame.trail)
            self._show_ground(frame.terrain, base[0])

    def _show_ground(self, terrain: np.ndarray, x: float) -> None:
        lines = ground_marks(terrain, x)
        if not np.array_equal(lines, self._lines):
            self._marks.points, self._lines = (lines + np.array([0.0, 0.0, LINE_RISE])).astype(np.float32), lines
        if np.array_equal(terrain, self._ground):
            return
        self._ground = terrain
        while len(self._boxes) < len(terrain):
            self._boxes.append(self.server.scene.add_box(f"/world/ground/{len(self._boxes)}", cast_shadow=False))
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
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        path: str,
        model: mujoco.MjModel,
        base: int,
        colour: Colour | None = None,
        opacity: float | None = None,
    ) -> None:
        self.model, self.data, self.base = model, mujoco.MjData(model), base
        self.node = scene.add_frame(path, show_axes=False)
        self.bodies: dict[int, viser.FrameHandle] = {}
        for i in visible_geoms(model):
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
