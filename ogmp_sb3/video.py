"""Videos, animated GIFs and motion strips of what was played, without a screen."""

from __future__ import annotations

import itertools
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.frame import Frame, join_terrain
from ogmp_sb3.logs import progress_bar
from ogmp_sb3.render import FORMATS, STRIP_TILES
from ogmp_sb3.sim import build_model
from ogmp_sb3.terrain import NOTHING, TOP

GL_LIBRARIES = ("egl", "osmesa", "glfw")  # in the order they are tried; glfw needs a screen
GL_PROBE = """
import mujoco
context = mujoco.GLContext(16, 16)
context.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100.value)
"""


def check_suffix(path: Path) -> None:
    """:raises ValueError: for a kind of file that cannot be written"""
    if path.suffix not in FORMATS:
        raise ValueError(f"'video' must end in {', '.join(FORMATS)}; found '{path}'.")


def gl_library() -> str:
    """The OpenGL library that works here: that of ``MUJOCO_GL`` if set, else the first of EGL, OSMesa and GLFW.

    :raises ValueError: if none does
    """
    wanted = os.environ.get("MUJOCO_GL")
    for name in (wanted,) if wanted else GL_LIBRARIES:
        environment = {**os.environ, "MUJOCO_GL": name}
        probe = [sys.executable, "-c", GL_PROBE]
        if subprocess.run(probe, env=environment, capture_output=True, check=False).returncode == 0:
            return name
    tried = f"with MUJOCO_GL={wanted}" if wanted else f"by {', '.join(GL_LIBRARIES)}"
    raise ValueError(
        f"no OpenGL found {tried}: install a software one (Debian: apt install libosmesa6, then MUJOCO_GL=osmesa) or "
        "a GPU driver (MUJOCO_GL=egl)."
    )


def write_video(frames: list[Frame], task: TaskConfig, path: Path) -> None:
    """Draw frames and write them to a file, in a process of its own.

    MuJoCo chooses its OpenGL library when it is imported, and a software one does not go well with a PyTorch built
    for CUDA (each brings an LLVM); :mod:`ogmp_sb3.render` imports no PyTorch.

    :param frames: one for each control step
    :param task: their task
    :param path: ``.mp4``, ``.gif``, or ``.png`` for a strip of pictures
    :raises ValueError: for another ending, or if there is no OpenGL
    """
    check_suffix(path)
    library = gl_library()
    stride = FORMATS[path.suffix].stride or math.ceil(len(frames) / STRIP_TILES)
    terrain, frames = whole_terrain(frames)[::stride], frames[::stride]
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = build_model(task.robot_config, task.physics_dt, terrain.shape[1], visual=True)
        mujoco.mj_saveModel(model, str(folder / "model.mjb"))
        np.savez(
            folder / "frames.npz",
            robot=[f.robot for f in frames],
            ghost=[f.ghost for f in frames],
            base=[f.base for f in frames],
            begins=begins(frames),
            trail=np.concatenate([f.trail for f in frames]),
            trail_end=np.cumsum([len(f.trail) for f in frames]),
            terrain=terrain,
            first_box=model.geom("terrain_0").id,
            text=[f"{f.mode}      {f.time:.2f} s      {f.speed:.2f} m/s" for f in frames],
            period=stride * task.control_dt,
        )
        command = [sys.executable, "-m", "ogmp_sb3.render", str(folder), str(path.resolve())]
        environment = {**os.environ, "MUJOCO_GL": library}
        with (
            subprocess.Popen(command, env=environment, stdout=subprocess.PIPE) as drawing,
            progress_bar(len(frames), "picture") as bar,
        ):
            assert drawing.stdout is not None
            for _ in drawing.stdout:
                bar.update()
    if drawing.returncode:
        raise ValueError(f"drawing with MUJOCO_GL={library} failed (exit code {drawing.returncode}).")


def begins(frames: list[Frame]) -> np.ndarray:
    """Which frames begin an episode, shape (frames,), bool."""
    time = np.array([f.time for f in frames])
    return np.concatenate([[True], time[1:] <= time[:-1]])


def whole_terrain(frames: list[Frame]) -> np.ndarray:
    """For each frame all the ground of its episode, so that none appears while one looks.

    :return: shape (frames, boxes, 5)
    """
    starts = [*np.flatnonzero(begins(frames)), len(frames)]
    episodes = [slice(a, b) for a, b in itertools.pairwise(starts)]
    grounds = [join_terrain(f.terrain for f in frames[episode]) for episode in episodes]
    terrain = np.zeros((len(frames), max(len(ground) for ground in grounds), 5))
    terrain[..., TOP] = NOTHING
    for episode, ground in zip(episodes, grounds, strict=True):
        terrain[episode, : len(ground)] = ground
    return terrain
