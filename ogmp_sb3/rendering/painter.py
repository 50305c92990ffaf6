"""Pictures of environments, drawn in a process of its own."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import weakref
from types import TracebackType

import mujoco
import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.rendering.frame import Drawable, drawable_of
from ogmp_sb3.rendering.opengl import gl_library
from ogmp_sb3.rendering.renderer import send

CAMERA_TARGET = np.array([0.15, 0.0, -0.12])  # m from the base: the middle of a picture
WIDTH, HEIGHT = 480, 320  # pixels


class Painter:
    """Draws scenes with OpenGL, in a process of its own.

    MuJoCo chooses its OpenGL library when it is imported, and a software one does not go well with a PyTorch built
    for CUDA (each brings an LLVM); :mod:`ogmp_sb3.rendering.renderer`, which that process runs, imports no PyTorch.

    :param task: whose robot is drawn
    :param width: of a picture, pixels
    :param height: of a picture, pixels
    :raises ValueError: if there is no OpenGL
    """

    def __init__(self, task: TaskConfig, width: int = WIDTH, height: int = HEIGHT) -> None:
        self.shape, self.library = (height, width, 3), gl_library()
        model = build_model(task.robot_config, task.physics_dt, 0, visual=True)
        binary = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, binary)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "ogmp_sb3.rendering.renderer"],
            env={**os.environ, "MUJOCO_GL": self.library},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self.close = weakref.finalize(self, _end, self._process)
        self._ask(0, model=binary, width=width, height=height)

    def draw(self, drawable: Drawable, lookat: np.ndarray) -> np.ndarray:
        """One picture, shape (height, width, 3), uint8.

        :param lookat: the point in the middle of it, shape (3,), m
        :raises ValueError: if the process that draws has failed
        """
        parts = {name: getattr(drawable, name) for name in ("robot", "ghost", "trail", "terrain")}
        picture = self._ask(math.prod(self.shape), lookat=lookat, **parts)
        return np.frombuffer(picture, np.uint8).reshape(self.shape).copy()

    def _ask(self, size: int, **message: np.ndarray | int) -> bytes:
        """Send a message and read so many bytes."""
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        try:
            send(process.stdin, **message)
        except BrokenPipeError:
            pass  # nothing will come back
        answer = process.stdout.read(size)
        if len(answer) < size:
            raise ValueError(f"drawing with MUJOCO_GL={self.library} failed (exit code {process.wait()}).")
        return answer

    def __enter__(self) -> Painter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def _end(process: subprocess.Popen[bytes]) -> None:
    process.communicate()  # closes its input, which ends it


class Pictures:
    """The environments of a batch as pictures. The process that draws begins with the first one.

    :param env: the environments
    """

    def __init__(self, env: BatchEnv) -> None:
        self.env = env
        self._painter: Painter | None = None
        self._drawn: dict[int, Drawable] = {}

    def draw(self, row: int) -> np.ndarray:
        """A picture of one environment as it is now, shape (height, width, 3), uint8.

        :raises ValueError: if there is no OpenGL
        """
        if self._painter is None:
            self._painter = Painter(self.env.task)
        drawable = self._drawn[row] = drawable_of(self.env, row, self.env.view(), self._drawn.get(row))
        return self._painter.draw(drawable, drawable.base + CAMERA_TARGET)

    def forget(self, rows: np.ndarray | None = None) -> None:
        """Forget the ground of episodes that are over.

        :param rows: which environments, shape (n,), int; None for all
        """
        for row in range(self.env.num_envs) if rows is None else rows.tolist():
            self._drawn.pop(row, None)

    def close(self) -> None:
        """End the process that draws."""
        if self._painter is not None:
            self._painter.close()
            self._painter = None
