"""Videos, animated GIFs and motion strips of what was played, without a screen."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.rendering.frame import Frame, join_terrain
from ogmp_sb3.rendering.painter import CAMERA_TARGET, Painter

CAMERA_LAG = 0.9  # share of the way that the camera leaves for later in 0.03 s, so that hops do not shake it
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


def check_suffix(path: Path) -> None:
    """:raises ValueError: for a kind of file that cannot be written"""
    if path.suffix not in FORMATS:
        raise ValueError(f"'video' must end in {', '.join(FORMATS)}; found '{path}'.")


def picture_count(frames: int, path: Path) -> int:
    """How many pictures :func:`write_video` draws of so many frames."""
    return math.ceil(frames / _stride(frames, path))


def _stride(frames: int, path: Path) -> int:
    """Frames from picture to picture."""
    return FORMATS[path.suffix].stride or math.ceil(frames / STRIP_TILES)


def write_video(
    frames: list[Frame],
    task: TaskConfig,
    path: str | Path,
    progress: Callable[[int], object] | None = None,
    kind: Format | None = None,
) -> None:
    """Draw frames and write them to a file.

    :param frames: one for each control step
    :param task: their task
    :param path: ``.mp4``, ``.gif``, or ``.png`` for a strip of pictures
    :param progress: called with the number of pictures that have just been drawn
    :param kind: size and stride; None: those of the ending
    :raises ValueError: for another ending, or if there is no OpenGL
    """
    path = Path(path)
    check_suffix(path)
    kind, stride = kind or FORMATS[path.suffix], kind.stride if kind else _stride(len(frames), path)
    terrain, frames = whole_terrain(frames)[::stride], frames[::stride]
    period = stride * task.control_dt
    path.parent.mkdir(parents=True, exist_ok=True)
    with Painter(task, kind.width, kind.height) as painter:

        def pictures() -> Iterator[np.ndarray]:
            for frame, ground, lookat in zip(frames, terrain, camera_path(frames, period), strict=True):
                picture = painter.draw(replace(frame, terrain=ground), lookat)
                yield _with_text(picture, f"{frame.mode}      {frame.time:.2f} s      {frame.speed:.2f} m/s")
                if progress is not None:
                    progress(1)

        write(pictures(), path, kind, period)


def camera_path(frames: list[Frame], period: float) -> Iterator[np.ndarray]:
    """The point in the middle of each picture: with the robot along the track, smoothly behind it otherwise.

    :param frames: those that are drawn
    :param period: from one to the next, s
    """
    lag = CAMERA_LAG ** (period / 0.03)
    lookat = np.zeros(3)
    for frame, new in zip(frames, begins(frames), strict=True):
        target = frame.base + CAMERA_TARGET
        lookat = target if new else lag * lookat + (1.0 - lag) * target
        lookat[0] = target[0]
        yield lookat


def begins(frames: list[Frame]) -> np.ndarray:
    """Which frames begin an episode, shape (frames,), bool."""
    time = np.array([f.time for f in frames])
    return np.concatenate([[True], time[1:] <= time[:-1]])


def whole_terrain(frames: list[Frame]) -> list[np.ndarray]:
    """For each frame all the ground of its episode, shape (boxes, 5), so that none appears while one looks."""
    starts = [*np.flatnonzero(begins(frames)), len(frames)]
    terrain = []
    for first, end in itertools.pairwise(starts):
        terrain += [join_terrain(frame.terrain for frame in frames[first:end])] * (end - first)
    return terrain


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
