"""Draw scenes with OpenGL, in the process behind :class:`ogmp_sb3.rendering.painter.Painter`.

It is sent named arrays. The first message holds ``model`` (MuJoCo's binary form), ``width`` and ``height``; every
other one holds the arguments of :meth:`Artist.draw`, and is answered with the bytes of the picture.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from typing import IO

import mujoco
import numpy as np

from ogmp_sb3.guidance.terrain import geom_boxes
from ogmp_sb3.rendering.frame import GHOST_COLOUR, MARK_COLOUR, ground_colours, ground_marks

GHOST_ALPHA = 0.25
CAMERA_AZIMUTH, CAMERA_ELEVATION, CAMERA_DISTANCE = 106.0, -18.0, 2.1  # degrees, degrees, m
AMBIENT = 0.5  # light from everywhere, of 1
SHADOW_SIZE, SAMPLES = 2048, 4
TRAIL_RADIUS, MARK_RADIUS = 0.008, 0.004  # m
LENGTH_BYTES = 8  # before every message


class Artist:
    """Draws scenes one after another.

    :param model: the robot alone
    :param width: of a picture, pixels
    :param height: of a picture, pixels
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        model.vis.quality.shadowsize, model.vis.quality.offsamples = SHADOW_SIZE, SAMPLES
        model.vis.headlight.ambient[:] = AMBIENT
        self.model = model
        self.data = mujoco.MjData(model)
        self.renderer = mujoco.Renderer(model, height, width, max_geom=2000)
        self.camera, self.options = mujoco.MjvCamera(), mujoco.MjvOption()
        self.camera.azimuth, self.camera.elevation = CAMERA_AZIMUTH, CAMERA_ELEVATION
        self.camera.distance = CAMERA_DISTANCE

    def draw(
        self, robot: np.ndarray, ghost: np.ndarray, trail: np.ndarray, terrain: np.ndarray, lookat: np.ndarray
    ) -> np.ndarray:
        """One picture, shape (height, width, 3), uint8.

        :param robot: as in :class:`~ogmp_sb3.rendering.frame.Drawable`, like what follows
        :param lookat: the point in the middle of the picture, shape (3,), m
        """
        self.camera.lookat[:] = lookat
        scene = self.renderer.scene
        self._pose(robot if len(robot) else ghost)
        self.renderer.update_scene(self.data, self.camera, self.options)
        first_ghost = scene.ngeom if len(robot) else 0
        if len(robot):
            self._pose(ghost)
            category = mujoco.mjtCatBit.mjCAT_DYNAMIC
            mujoco.mjv_addGeoms(self.model, self.data, self.options, mujoco.MjvPerturb(), category, scene)
        for geom in scene.geoms[first_ghost : scene.ngeom]:
            if geom.category == mujoco.mjtCatBit.mjCAT_DYNAMIC:
                geom.matid, geom.rgba[:] = -1, (*_unit(GHOST_COLOUR), GHOST_ALPHA)
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # casts no shadow
        self._boxes(terrain)
        self._lines(np.stack([trail[:-1], trail[1:]], axis=1), TRAIL_RADIUS, GHOST_COLOUR)
        self._lines(ground_marks(terrain, float(lookat[0])), MARK_RADIUS, MARK_COLOUR)
        return self.renderer.render()  # type: ignore[no-any-return]

    def _pose(self, qpos: np.ndarray) -> None:
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def _boxes(self, terrain: np.ndarray) -> None:
        """Add the ground to the scene."""
        for centre, half, colour in zip(*geom_boxes(terrain), ground_colours(terrain) / 255, strict=True):
            geom = self._add(mujoco.mjtGeom.mjGEOM_BOX, half, centre, colour)
            geom.category = mujoco.mjtCatBit.mjCAT_STATIC

    def _lines(self, lines: np.ndarray, radius: float, colour: tuple[int, int, int]) -> None:
        """Add lines to the scene, shape (n, 2, 3)."""
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        room = self.renderer.scene.maxgeom - self.renderer.scene.ngeom
        for start, end in lines[:room]:
            geom = self._add(capsule, np.zeros(3), np.zeros(3), _unit(colour))
            mujoco.mjv_connector(geom, capsule, radius, start, end)
            geom.category = mujoco.mjtCatBit.mjCAT_DECOR

    def _add(
        self, kind: mujoco.mjtGeom, size: np.ndarray, position: np.ndarray, colour: np.ndarray | list[float]
    ) -> mujoco.MjvGeom:
        """One more geom in the scene."""
        scene = self.renderer.scene
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, kind, size, position, np.eye(3).ravel(), np.array([*colour, 1.0], np.float32))
        scene.ngeom += 1
        return geom


def _unit(colour: tuple[int, int, int]) -> list[float]:
    return [c / 255 for c in colour]


def send(pipe: IO[bytes], **arrays: np.ndarray | int) -> None:
    """Write a message.

    :raises BrokenPipeError: if nobody reads any more
    """
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    message = buffer.getvalue()
    pipe.write(len(message).to_bytes(LENGTH_BYTES, "little") + message)
    pipe.flush()


def receive(pipe: IO[bytes]) -> dict[str, np.ndarray] | None:
    """Read a message; None if there are no more."""
    length = pipe.read(LENGTH_BYTES)
    if not length:
        return None
    with np.load(io.BytesIO(pipe.read(int.from_bytes(length, "little")))) as arrays:
        return dict(arrays)


def main() -> None:
    """Draw what comes in until there is no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that wants the pictures
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what libraries print is no picture
    first = receive(sys.stdin.buffer)
    if first is None:
        return
    model = mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": first["model"].tobytes()})
    artist = Artist(model, int(first["width"]), int(first["height"]))
    while scene := receive(sys.stdin.buffer):
        answers.write(artist.draw(**scene).tobytes())
        answers.flush()


if __name__ == "__main__":
    main()
