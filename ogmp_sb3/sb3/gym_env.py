"""One environment of a task, for Gymnasium."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.observations import CLIP
from ogmp_sb3.rendering.painter import Pictures

RENDER_MODES = ("rgb_array",)


def spaces_of(env: BatchEnv) -> tuple[spaces.Box, spaces.Box]:
    """The observation space and the action space of a task's environments."""
    bound = (CLIP * env.observation_scale).astype(np.float32)
    return spaces.Box(-bound, bound, dtype=np.float32), spaces.Box(-1.0, 1.0, (env.action_size,), np.float32)


def loaded_task(task: str | Path | TaskConfig, overrides: dict[str, Any]) -> TaskConfig:
    """A task by name or file, with overrides; one that is loaded already takes none."""
    if not isinstance(task, TaskConfig):
        return load_task(task, overrides)
    if overrides:
        raise TypeError(f"a loaded task takes no overrides (found {', '.join(overrides)}); give them to load_task.")
    return task


def check_render_mode(render_mode: str | None) -> None:
    """:raises ValueError: for a render mode that there is not"""
    if render_mode is not None and render_mode not in RENDER_MODES:
        raise ValueError(f"unknown render mode '{render_mode}'{did_you_mean(render_mode, [*RENDER_MODES, 'None'])}")


def render_metadata(task: TaskConfig) -> dict[str, Any]:
    """Gymnasium's ``metadata``: render modes, and pictures per second."""
    return {"render_modes": list(RENDER_MODES), "render_fps": round(1 / task.control_dt)}


class Copied:
    """Environments whose copies (``copy.deepcopy``, ``pickle``) go on where they are; each draws its own pictures."""

    batch: BatchEnv
    _pictures: Pictures

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_pictures"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._pictures = Pictures(self.batch)


class OgmpEnv(Copied, gymnasium.Env[np.ndarray, np.ndarray]):
    """One environment of a task, for Gymnasium.

    A copy (``copy.deepcopy``, ``pickle``) goes on exactly where the original is, without its commands.

    :param task: a task, the name of a shipped one or of one in a plug-in, or the path of a YAML file
    :param render_mode: ``"rgb_array"``, to draw pictures, or None
    :param overrides: replace values of the task, e.g. ``rho=0.3`` or ``**{"modes.jump.h": 0.2}``
    :raises ValueError: for another render mode
    """

    metadata = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012  (Gymnasium's own form)

    def __init__(
        self, task: TaskConfig | str | Path = "parkour", render_mode: str | None = None, **overrides: Any
    ) -> None:
        check_render_mode(render_mode)
        self.render_mode = render_mode
        task = loaded_task(task, overrides)
        self.batch = BatchEnv(task, num_envs=1, threads=1)
        self.observation_space, self.action_space = spaces_of(self.batch)
        self._seeded = False
        self.metadata = render_metadata(task)
        self._pictures = Pictures(self.batch)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            self.batch.seed_row(0, int(self.np_random.integers(2**31)) if seed is None else seed)
            self._seeded = True
        self._pictures.forget()
        return self.batch.reset()[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        result = self.batch.step(np.asarray(action)[None])
        info = {"deviation": float(result.view.deviation[0]), "termination": str(result.termination[0])}
        return (
            result.observation[0],
            float(result.reward[0]),
            bool(result.terminated[0]),
            bool(result.truncated[0]),
            info,
        )

    def render(self) -> np.ndarray | None:
        """A picture of the robot, the oracle's plan and the ground that is laid, shape (height, width, 3), uint8.

        :return: None without a render mode
        :raises ValueError: if there is no OpenGL
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() draws nothing: make the environment with render_mode='rgb_array'.")
            return None
        return self._pictures.draw(0)

    def close(self) -> None:
        self._pictures.close()
