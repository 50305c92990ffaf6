"""Draws recorded frames with OpenGL, in a process of its own: ``python -m ogmp_sb3.render <folder> <file>``.

``<folder>`` holds what :func:`ogmp_sb3.video.write_video` puts there.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ogmp_sb3.frame import GHOST_COLOUR, MARK_COLOUR, ground_colours, ground_marks
from ogmp_sb3.terrain import geom_boxes

GHOST_ALPHA = 0.25
CAMERA_AZIMUTH, CAMERA_ELEVATION, CAMERA_DISTANCE = 106.0, -18.0, 2.1  # degrees, degrees, m
CAMERA_TARGET = np.array([0.15, 0.0, -0.12])  # m from the base
CAMERA_LAG = 0.9  # share of the way that the camera leaves for later in 0.03 s, so that hops do not shake it
AMBIENT = 0.5  # light from everywhere, of 1
SHADOW_SIZE, SAMPLES = 2048, 4
TRAIL_RADIUS, MARK_RADIUS = 0.008, 0.004  # m
STRIP_TILES, STRIP_COLUMNS = 12, 4
TEXT_SIZE = 0.04  # of the picture's height
GIF_COLOURS = 128


@dataclass(frozen=True)
class Format:
    """A kind of file."""

    width: int
    """of one picture, pixels"""
    height: int
    """of one picture, pixels"""
    stride: int
    """control steps from picture to picture; 0: as few pictures as fill a strip"""


FORMATS = {".mp4": Format(960, 544, 1), ".gif": Format(400, 240, 2), ".png": Format(480, 320, 0)}


class Artist:
    """Draws frames one after another.

    :param model: robot and terrain boxes
    :param frames: the arrays of all frames
    :param kind: size of the pictures
    """

    def __init__(self, model: mujoco.MjModel, frames: dict[str, np.ndarray], kind: Format) -> None:
        model.vis.quality.shadowsize, model.vis.quality.offsamples = SHADOW_SIZE, SAMPLES
        model.vis.headlight.ambient[:] = AMBIENT
        self.model, self.frames = model, frames
        self.data = mujoco.MjData(model)
        self.renderer = mujoco.Renderer(model, kind.height, kind.width, max_geom=2000)
        self.camera, self.options = mujoco.MjvCamera(), mujoco.MjvOption()
        self.camera.azimuth, self.camera.elevation = CAMERA_AZIMUTH, CAMERA_ELEVATION
        self.camera.distance = CAMERA_DISTANCE
        self.lag = CAMERA_LAG ** (float(frames["period"]) / 0.03)

    def draw(self, i: int) -> np.ndarray:
        """One picture, shape (height, width, 3), uint8."""
        frames = self.frames
        self._place_terrain(frames["terrain"][i])
        target = frames["base"][i] + CAMERA_TARGET
        lag = 0.0 if frames["begins"][i] else self.lag
        self.camera.lookat[:] = lag * self.camera.lookat + (1.0 - lag) * target
        self.camera.lookat[0] = target[0]

        scene, robot = self.renderer.scene, frames["robot"][i]
        self._pose(robot if len(robot) else frames["ghost"][i])
        self.renderer.update_scene(self.data, self.camera, self.options)
        first_ghost = scene.ngeom if len(robot) else 0
        if len(robot):
            self._pose(frames["ghost"][i])
            category = mujoco.mjtCatBit.mjCAT_DYNAMIC
            mujoco.mjv_addGeoms(self.model, self.data, self.options, mujoco.MjvPerturb(), category, scene)
        for geom in scene.geoms[first_ghost : scene.ngeom]:
            if geom.category == mujoco.mjtCatBit.mjCAT_DYNAMIC:
                geom.matid, geom.rgba[:] = -1, (*_unit(GHOST_COLOUR), GHOST_ALPHA)
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # casts no shadow
        start = frames["trail_end"][i - 1] if i else 0
        trail = frames["trail"][start : frames["trail_end"][i]]
        self._lines(np.stack([trail[:-1], trail[1:]], axis=1), TRAIL_RADIUS, GHOST_COLOUR)
        self._lines(ground_marks(frames["terrain"][i], target[0]), MARK_RADIUS, MARK_COLOUR)
        return self.renderer.render()  # type: ignore[no-any-return]

    def _pose(self, qpos: np.ndarray) -> None:
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def _place_terrain(self, terrain: np.ndarray) -> None:
        first = int(self.frames["first_box"])
        boxes = slice(first, first + len(terrain))
        self.model.geom_pos[boxes], self.model.geom_size[boxes] = geom_boxes(terrain)
        self.model.geom_rgba[boxes, :3] = ground_colours(terrain) / 255

    def _lines(self, lines: np.ndarray, radius: float, colour: tuple[int, int, int]) -> None:
        """Add lines to the scene, shape (n, 2, 3)."""
        scene, capsule = self.renderer.scene, mujoco.mjtGeom.mjGEOM_CAPSULE
        for start, end in lines[: scene.maxgeom - scene.ngeom]:
            geom = scene.geoms[scene.ngeom]
            rgba = np.array([*_unit(colour), 1.0], dtype=np.float32)
            mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
            mujoco.mjv_connector(geom, capsule, radius, start, end)
            geom.category = mujoco.mjtCatBit.mjCAT_DECOR
            scene.ngeom += 1


def _unit(colour: tuple[int, int, int]) -> list[float]:
    return [c / 255 for c in colour]


def write(pictures: Iterator[np.ndarray], path: Path, kind: Format, period: float) -> None:
    """Write pictures to a file of a kind that its ending says.

    :param pictures: each of shape (height, width, 3), uint8
    :param period: from picture to picture, s
    """
    from PIL import Image

    if path.suffix == ".mp4":
        import imageio_ffmpeg

        writer = imageio_ffmpeg.write_frames(str(path), (kind.width, kind.height), fps=1.0 / period, quality=7)
        writer.send(None)
        for picture in pictures:
            writer.send(np.ascontiguousarray(picture))
        writer.close()
        return
    images = [Image.fromarray(picture) for picture in pictures]
    if path.suffix == ".gif":
        # One palette for all, or colours flicker; one that covers rare colours, or the robot's accents go.
        some = [np.asarray(image) for image in images[:: math.ceil(len(images) / 8)]]
        palette = Image.fromarray(np.vstack(some)).quantize(GIF_COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=3)
        images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
        images[0].save(path, save_all=True, append_images=images[1:], duration=round(1000 * period), loop=0)
        return
    columns = min(STRIP_COLUMNS, len(images))
    strip = Image.new("RGB", (columns * kind.width, -(-len(images) // columns) * kind.height))
    for i, image in enumerate(images):
        strip.paste(image, (i % columns * kind.width, i // columns * kind.height))
    strip.save(path)


def _with_text(picture: np.ndarray, text: str) -> np.ndarray:
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(picture)
    size = max(10, round(TEXT_SIZE * image.height))
    font: Any = ImageFont.load_default(size)
    ImageDraw.Draw(image).text((size, size), text, fill=(20, 24, 32), font=font)
    return np.asarray(image)


def main(folder: Path, path: Path) -> None:
    """Draw the frames of a folder into a file."""
    with np.load(folder / "frames.npz") as loaded:
        frames = dict(loaded)
    kind = FORMATS[path.suffix]
    artist = Artist(mujoco.MjModel.from_binary_path(str(folder / "model.mjb")), frames, kind)

    def pictures() -> Iterator[np.ndarray]:
        for i in range(len(frames["text"])):
            yield _with_text(artist.draw(i), str(frames["text"][i]))
            sys.stdout.write("\n")  # the caller counts lines
            sys.stdout.flush()

    write(pictures(), path, kind, float(frames["period"]))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
