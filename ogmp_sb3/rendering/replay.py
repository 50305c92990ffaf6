"""Recorded episodes as plain arrays: the shapes of a robot, and where its bodies are in every control step.

A page that shows them needs no MuJoCo: bodies are placed already, and a ghost is a rigid copy of the nominal pose.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.endings import RUNNING, TIME_LIMIT
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.guidance.rotations import quat_conjugate, quat_multiply, quat_rotate
from ogmp_sb3.guidance.terrain import NOTHING, geom_boxes
from ogmp_sb3.rendering.frame import GHOST_COLOUR, Colour, Frame, ground_colours, join_terrain
from ogmp_sb3.rendering.shapes import Mesh, bound_mesh, box, clustered, geom_colour, geom_mesh, sphere, visible_geoms

FORMAT = 1
MOST_FACES = 50_000  # of a robot's shapes together: a phone draws them, and their bytes are a few megabytes
DOT_CELL = 0.4  # of the radius: a dot needs few faces
FINEST = 0.001  # m: width of the cells in which the vertices of a robot with more faces become one, at first
ROBOT, REFERENCE, GROUND, LIMIT = "robot", "reference", "ground", "limit"  # how a line of a chart is drawn


class Line(NamedTuple):
    """A line of a chart."""

    name: str
    """what it is"""
    style: str
    """:data:`ROBOT` or one of those beside it"""
    value: Callable[[Frame], float]
    """its value in a frame; nan where there is none"""


class Chart(NamedTuple):
    """A chart over time."""

    title: str
    """what it shows, with its unit"""
    lines: tuple[Line, ...]
    """what is drawn, the most important last"""


@dataclass(frozen=True, kw_only=True)
class RecordedEpisode:
    """An episode to look at."""

    name: str
    """what is special about it"""
    detail: str
    """which one it is"""
    frames: list[Frame]
    """one for each control step, the start included"""


@dataclass
class Arrays:
    """Arrays one behind another in one string of bytes, with a table of what is where."""

    table: list[dict[str, Any]] = field(default_factory=list)
    """``start`` in bytes, ``type`` and ``shape`` of each"""
    data: bytearray = field(default_factory=bytearray)
    """all of them, each beginning at a multiple of four bytes"""

    def add(self, values: np.ndarray, kind: str = "float32") -> int:
        """Append an array, and return its number."""
        stored = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
        self.data += bytes(-len(self.data) % 4)
        self.table.append({"start": len(self.data), "type": kind, "shape": list(stored.shape)})
        self.data += stored.tobytes()
        return len(self.table) - 1


class Bodies:
    """The bodies of a robot that are drawn, and where they are.

    :param task: whose robot it is
    """

    def __init__(self, task: TaskConfig) -> None:
        self.model = build_model(task.robot_config, task.physics_dt, 0, visual=True)
        self.geoms = visible_geoms(self.model)
        self.base = self.model.body(task.robot_config.base).id
        self.ids = np.unique(self.model.geom_bodyid[self.geoms])
        self.height = task.robot_config.nominal_height
        self._data = mujoco.MjData(self.model)

    def poses(self, qpos: np.ndarray) -> np.ndarray:
        """Positions in m and quaternions wxyz of the bodies in the world, shape (bodies, 7).

        :param qpos: generalised position, shape (nq,)
        """
        placed: np.ndarray = self._placed(qpos)[self.ids]
        return placed

    def around_base(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pose of the base, shape (7,), and in its frame those of the bodies, shape (bodies, 7)."""
        placed = self._placed(qpos)
        base, bodies = placed[self.base], placed[self.ids]
        back = np.broadcast_to(quat_conjugate(base[3:]), (len(bodies), 4))
        offset = quat_rotate(back, bodies[:, :3] - base[:3])
        return base, np.concatenate([offset, quat_multiply(back, bodies[:, 3:])], axis=1)

    def _placed(self, qpos: np.ndarray) -> np.ndarray:
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)
        return np.concatenate([self._data.xpos, self._data.xquat], axis=1)


def replay_data(task: TaskConfig, episodes: Sequence[RecordedEpisode]) -> tuple[dict[str, Any], bytes]:
    """What a page needs to show episodes.

    :param task: the task as in training; its bound is shown
    :param episodes: at least one
    :return: plain data, which names arrays by their number in its ``arrays``, and their bytes
    """
    arrays, bodies = Arrays(), Bodies(task)
    charts = charts_of(task, with_robot=any(len(episode.frames[0].robot) for episode in episodes))
    bound = bound_mesh(task)
    data: dict[str, Any] = {
        "format": FORMAT,
        "control_dt": task.control_dt,
        "robot": _robot(arrays, bodies),
        "ghost": arrays.add(bodies.around_base(episodes[0].frames[0].ghost)[1]),
        "ghost_colour": _unit(GHOST_COLOUR),
        "box": _mesh(arrays, box()),
        "dot": _mesh(arrays, clustered(sphere(), DOT_CELL)),
        "bound": None if bound is None else _mesh(arrays, bound),
        "rho": task.rho,
        "charts": [{"title": c.title, "lines": [{"name": i.name, "style": i.style} for i in c.lines]} for c in charts],
        "episodes": [
            {"name": episode.name, "detail": episode.detail, **_episode(arrays, bodies, charts, episode.frames)}
            for episode in episodes
        ],
    }
    return {**data, "arrays": arrays.table}, bytes(arrays.data)


def charts_of(task: TaskConfig, with_robot: bool) -> list[Chart]:
    """What is plotted beside the scene: height, speed against what is asked, and the deviation against the bound.

    :param with_robot: False: only the oracle plays, and there is only the reference
    """
    height = Chart(
        "Height of the base, m",
        (
            Line("ground", GROUND, lambda f: f.ground if f.ground > NOTHING else np.nan),
            Line("reference", REFERENCE, lambda f: float(f.reference[2])),
            Line("robot", ROBOT, lambda f: float(f.base[2])),
        ),
    )
    along_track = task.horizon is not None
    if along_track:
        asked = Line("asked for", REFERENCE, lambda f: f.commanded_speed)
        speed = Chart("Speed along the track, m/s", (asked, Line("robot", ROBOT, lambda f: float(f.velocity[0]))))
    else:
        asked = Line("reference", REFERENCE, lambda f: float(f.reference_velocity[2]))
        speed = Chart("Speed upwards, m/s", (asked, Line("robot", ROBOT, lambda f: float(f.velocity[2]))))
    rho = task.rho
    if rho is None:
        deviation = Chart("Deviation from the reference", (Line("robot", ROBOT, lambda f: f.deviation),))
    else:
        limit = Line("bound", LIMIT, lambda _: 1.0)
        deviation = Chart("Deviation / rho", (limit, Line("robot", ROBOT, lambda f: f.deviation / rho)))
    if with_robot:
        return [height, speed, deviation]
    return [Chart(chart.title, tuple(line for line in chart.lines if line.style != ROBOT)) for chart in (height, speed)]


def _robot(arrays: Arrays, bodies: Bodies) -> dict[str, Any]:
    """Shapes of the robot, those that several geoms have only once."""
    model = bodies.model
    meshes: dict[tuple[Any, ...], int] = {}
    geoms: list[dict[str, Any]] = []
    shapes: list[Mesh] = []
    for geom in bodies.geoms:
        kind = (int(model.geom_type[geom]), int(model.geom_dataid[geom]), *model.geom_size[geom].tolist())
        if kind not in meshes:
            meshes[kind] = len(shapes)
            shapes.append(geom_mesh(model, geom))
        geoms.append({
            "body": int(np.searchsorted(bodies.ids, model.geom_bodyid[geom])),
            "mesh": meshes[kind],
            "pose": [*model.geom_pos[geom].round(6).tolist(), *model.geom_quat[geom].round(7).tolist()],
            "colour": geom_colour(model, geom).round(4).tolist(),
        })  # fmt: skip
    stored = [_mesh(arrays, shape) for shape in coarse_enough(shapes)]
    return {"bodies": len(bodies.ids), "height": bodies.height, "meshes": stored, "geoms": geoms}


def coarse_enough(shapes: list[Mesh]) -> list[Mesh]:
    """The shapes of a robot with at most :data:`MOST_FACES` faces together, those with few as they are."""
    cell, coarser = FINEST, shapes
    while sum(len(shape.faces) for shape in coarser) > MOST_FACES:
        fair = MOST_FACES // len(shapes)
        coarser = [shape if len(shape.faces) <= fair else clustered(shape, cell) for shape in shapes]
        cell *= 1.25
    return coarser


def _mesh(arrays: Arrays, mesh: Mesh) -> dict[str, int]:
    kind = "uint16" if len(mesh.vertices) < 1 << 16 else "uint32"
    return {"vertices": arrays.add(mesh.vertices), "faces": arrays.add(mesh.faces, kind)}


def _episode(arrays: Arrays, bodies: Bodies, charts: list[Chart], frames: list[Frame]) -> dict[str, Any]:
    """What changes from step to step, and the ground of an episode."""
    has_robot = len(frames[0].robot) > 0
    terrain = join_terrain(frame.terrain for frame in frames)
    modes = [frame.mode for frame in frames]
    changes = [0, *(i for i in range(1, len(frames)) if modes[i] != modes[i - 1])]
    trails, plan = _plans(frames)
    return {
        "steps": len(frames),
        "robot": arrays.add(np.stack([bodies.poses(f.robot) for f in frames])) if has_robot else None,
        "ghost": arrays.add(np.stack([bodies.around_base(f.ghost)[0] for f in frames])),
        "base": arrays.add(np.stack([f.base for f in frames])),
        "speed": arrays.add(np.array([f.speed for f in frames])),
        "deviation": arrays.add(np.array([f.deviation for f in frames])),
        "plans": [arrays.add(trail) for trail in trails],
        "plan": arrays.add(np.array(plan), "uint16"),
        "modes": [{"start": i, "name": modes[i].partition(" ")[0], "text": modes[i]} for i in changes],
        "ground": [
            {"centre": list(centre), "half": list(half), "colour": _unit(colour)}
            for centre, half, colour in zip(*geom_boxes(terrain), ground_colours(terrain), strict=True)
        ],
        "charts": [arrays.add(np.array([[line.value(f) for f in frames] for line in chart.lines])) for chart in charts],
        "ended": frames[-1].ended.replace("_", " "),
        "fell": frames[-1].ended not in (RUNNING, TIME_LIMIT),
    }


def _plans(frames: list[Frame]) -> tuple[list[np.ndarray], list[int]]:
    """The oracle's plans of an episode, and which of them is present in each frame."""
    trails, plan = [frames[0].trail], [0]
    for before, now in itertools.pairwise(frames):
        if not np.array_equal(before.trail, now.trail):
            trails.append(now.trail)
        plan.append(len(trails) - 1)
    return trails, plan


def _unit(colour: Colour | np.ndarray) -> list[float]:
    return [round(float(c) / 255, 4) for c in colour]
