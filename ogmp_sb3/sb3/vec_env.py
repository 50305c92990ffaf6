"""Many environments of a task as one ``VecEnv`` of Stable-Baselines3."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from ogmp_sb3.config.messages import Where, did_you_mean
from ogmp_sb3.config.strict import check_range, read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.endings import UNSTABLE
from ogmp_sb3.env.failed_step import capture
from ogmp_sb3.rendering.painter import Pictures
from ogmp_sb3.sb3.gym_env import Copied, check_render_mode, loaded_task, render_metadata, spaces_of

SETTABLE = ("level", "render_mode", "rho")  # by set_attr


class OgmpVecEnv(Copied, VecEnv):
    """Many environments of a task as one SB3 ``VecEnv``; episodes reset themselves, time-outs are truncations.

    ``infos[i]`` holds ``deviation`` (the weighted norm that the bound is about) and ``termination`` (the rule that
    ended the episode, empty while it runs); at the end of an episode also ``terminal_observation``,
    ``TimeLimit.truncated`` (then also ``terminal_critic_observation``, if the task has ``critic_observations``) and
    ``episode`` with return ``r``, length ``l``, ``distance`` along the track, curriculum
    ``level``, mean ``deviation`` and the mean per step of each reward term. The summary of an episode that began
    before an earlier fall is called ``restart`` instead. A simulation that fails ends its own episode as
    ``unstable``, with the :class:`~ogmp_sb3.env.failed_step.UnstableStep` in ``unstable``; the others go on.

    A copy (``copy.deepcopy``, ``pickle``) goes on exactly where the original is, without its commands.

    :param task: the task
    :param num_envs: number of environments
    :param seed: environment i is seeded with ``seed + i``
    :param threads: physics threads, 0 for one per CPU
    :param render_mode: ``"rgb_array"``, to draw pictures, or None
    :raises ValueError: for another render mode
    """

    def __init__(
        self, task: TaskConfig, num_envs: int = 64, seed: int = 0, threads: int = 0, render_mode: str | None = None
    ) -> None:
        check_render_mode(render_mode)
        self.batch = BatchEnv(task, num_envs, seed, threads)
        self.render_mode = render_mode
        super().__init__(num_envs, *spaces_of(self.batch))
        self.metadata = render_metadata(task)
        self._pictures = Pictures(self.batch)
        self._actions = np.zeros((num_envs, self.batch.action_size))
        self._began = time.perf_counter()
        self._sums: dict[str, np.ndarray] = {}
        self._start_x = np.zeros(num_envs)

    def reset(self) -> np.ndarray:
        for row, seed in enumerate(self._seeds):
            if seed is not None:
                self.batch.seed_row(row, seed)
        self._reset_seeds()
        self._reset_options()
        self._sums = {}
        self._pictures.forget()
        observation = self.batch.reset()
        self._start_x = self._x().copy()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        result = self.batch.step(self._actions)
        deviation = result.view.deviation
        self._add(r=result.reward, deviation=deviation, **result.reward_terms)
        dones = result.terminated | result.truncated
        infos: list[dict[str, Any]] = [
            {"deviation": d, "termination": t, "TimeLimit.truncated": False}
            for d, t in zip(deviation.tolist(), result.termination.tolist(), strict=True)
        ]
        observation = result.observation
        rows = np.flatnonzero(dones)
        if len(rows):
            x = self._x()
            for row in rows:
                infos[row]["terminal_observation"] = observation[row].copy()
                infos[row]["TimeLimit.truncated"] = bool(result.truncated[row])
                kind = "restart" if self.batch.restarted[row] else "episode"
                infos[row][kind] = self._summary(int(row), float(x[row]))
                if result.termination[row] == UNSTABLE:
                    infos[row]["unstable"] = capture(self.batch, int(row), self._actions[row])
            timed_out = np.flatnonzero(result.truncated)
            for row, seen in zip(timed_out, self.batch.critic_observation(timed_out), strict=True):
                if seen.size:
                    infos[row]["terminal_critic_observation"] = seen
            for sums in self._sums.values():
                sums[rows] = 0.0
            observation = observation.copy()
            observation[rows] = self.batch.reset(rows)
            self._pictures.forget(rows)
            self._start_x[rows] = self._x()[rows]
        return observation, result.reward.astype(np.float32), dones, infos

    @property
    def critic_observation(self) -> np.ndarray:
        """What only the critic sees at present, shape (num_envs, size): ``critic_observations`` of the task."""
        return self.batch.critic_observation()

    def _x(self) -> np.ndarray:
        # Finite also after an explosion.
        x: np.ndarray = np.nan_to_num(self.batch.sim.qpos[:, self.batch.sim.base_qpos])
        return x

    def _add(self, **values: np.ndarray) -> None:
        for name, value in values.items():
            self._sums.setdefault(name, np.zeros(self.num_envs))
            self._sums[name] += value

    def _summary(self, row: int, x: float) -> dict[str, Any]:
        length = int(self.batch.step_count[row])
        sums = {name: float(s[row]) for name, s in self._sums.items()}
        return {
            "r": sums.pop("r"),
            "l": length,
            "t": round(time.perf_counter() - self._began, 6),
            "distance": x - float(self._start_x[row]),
            "level": float(self.batch.level[row]),
            "modes": len(self.batch.modes[row]),
            **{name: s / length for name, s in sums.items()},
        }

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The state of the simulations, for :meth:`set_state`. See :meth:`BatchEnv.state`."""
        arrays, plain = self.batch.state()
        sums = {f"sum.{name}": values.copy() for name, values in self._sums.items()}
        return {**arrays, **sums, "start_x": self._start_x.copy()}, plain

    def set_state(self, arrays: dict[str, np.ndarray], plain: dict[str, Any]) -> None:
        """Go on exactly where :meth:`state` was taken. See :meth:`BatchEnv.set_state`."""
        self.batch.set_state(arrays, plain)
        self._sums = {k.removeprefix("sum."): v.copy() for k, v in arrays.items() if k.startswith("sum.")}
        rewards = {name for name, given in self.batch.task.rewards.items() if given is not None}
        sums = {"r", "deviation", *rewards} if self._sums else set()  # none before the first step
        shapes = {values.shape for values in (*self._sums.values(), arrays["start_x"])}
        if set(self._sums) != sums or shapes != {(self.num_envs,)}:
            raise ValueError(f"the saved state does not fit this task and {self.num_envs} environments (sums).")
        self._start_x = arrays["start_x"].copy()
        self._pictures.forget()

    def close(self) -> None:
        self._pictures.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of some environments; ``rho`` is the permissible-state bound, ``level`` the curriculum's.

        :raises AttributeError: if there is none of this name
        """
        rows = self._get_indices(indices)
        if attr_name == "level":
            return [float(self.batch.level[row]) for row in rows]
        value = self.batch.task.rho if attr_name == "rho" else getattr(self, attr_name)
        return [value for _ in rows]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Change environments while they run.

        :param attr_name: ``rho``, the permissible-state bound, from the next step on; ``level``, the curriculum's,
            which the modes that are drawn next follow, until it moves on; or ``render_mode``
        :param value: one for all of ``indices``; a level lies from 0 to 1
        :param indices: which environments, None for all; only levels may differ
        :raises AttributeError: for any other attribute
        :raises TypeError: for a value of the wrong type
        :raises ValueError: for a value out of range, or ``indices`` that leave environments out
        """
        if attr_name not in SETTABLE:
            raise AttributeError(f"environments have no '{attr_name}' to set{did_you_mean(attr_name, SETTABLE)}")
        rows, where = sorted(set(self._get_indices(indices))), Where("set_attr", attr_name)
        if attr_name == "level":
            if self.batch.task.curriculum is None:
                raise ValueError("'level' changes nothing: the task has no curriculum.")
            level = read(float, value, where)
            check_range("level", level, 0.0, 1.0)
            self.batch.level[rows] = level
        elif rows != list(range(self.num_envs)):
            raise ValueError(
                f"'{attr_name}' is one for all {self.num_envs} environments, found 'indices' of {len(rows)}."
            )
        elif attr_name == "rho":
            self.batch.task = replace(self.batch.task, rho=read(float | None, value, where))  # type: ignore[arg-type]
        else:
            check_render_mode(value)
            self.render_mode = value

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        return [getattr(self, method_name)(*args, **kwargs) for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """A picture of every environment, each of shape (height, width, 3), uint8; None without a render mode.

        :raises ValueError: if there is no OpenGL
        """
        return [None if self.render_mode is None else self._pictures.draw(row) for row in range(self.num_envs)]

    def _get_indices(self, indices: int | Iterable[int] | None) -> Iterable[int]:
        if indices is None:
            return range(self.num_envs)
        return [indices] if isinstance(indices, int) else indices


def make_env(
    task: str | Path | TaskConfig, num_envs: int = 1, seed: int = 0, render_mode: str | None = None, **overrides: Any
) -> OgmpVecEnv:
    """Environments of a task for SB3, from its name or file.

    :param task: a shipped task, the path of a YAML file, or a loaded task
    :param num_envs: number of environments
    :param seed: environment i is seeded with ``seed + i``
    :param render_mode: ``"rgb_array"``, to draw pictures, or None
    :param overrides: replace values of the task, e.g. ``rho=0.3, oracle="lqr"``
    """
    return OgmpVecEnv(loaded_task(task, overrides), num_envs, seed, render_mode=render_mode)
