"""Many environments of a task as one ``VectorEnv`` of Gymnasium."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ogmp_sb3.config.messages import describe, did_you_mean
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv, StepResult
from ogmp_sb3.rendering.painter import Pictures
from ogmp_sb3.sb3.gym_env import Copied, check_render_mode, loaded_task, render_metadata, spaces_of
from ogmp_sb3.sb3.held_rows import step_others

MASK = "reset_mask"  # the one option of a reset


class OgmpVectorEnv(Copied, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many environments of a task as one ``VectorEnv`` of Gymnasium, stepped together on a pool of threads.

    It behaves as Gymnasium's ``SyncVectorEnv`` of :class:`~ogmp_sb3.sb3.gym_env.OgmpEnv` does, bit for bit.
    ``infos`` holds ``deviation`` (the weighted norm that the bound is about) and ``termination`` (the rule that ended
    the episode, empty while it runs). How episodes begin anew is declared in ``metadata["autoreset_mode"]``:

    - ``SameStep``: in the step that ends one; its last observation is in ``final_obs``, its infos in ``final_info``.
    - ``NextStep``: in the step after that, whose action is ignored and whose reward is 0.
    - ``Disabled``: by ``reset(options={"reset_mask": ...})``, without which the next step is refused.

    A recurrent policy forgets where an episode begins: in the first mode behind a step with ``terminations |
    truncations``, in the second one step later, in the third with the reset.

    A copy (``copy.deepcopy``, ``pickle``) goes on exactly where the original is.

    :param num_envs: number of environments
    :param task: a task, the name of a shipped one or of one in a plug-in, or the path of a YAML file
    :param render_mode: ``"rgb_array"``, to draw pictures, or None
    :param autoreset_mode: a mode of Gymnasium's, or its name
    :param threads: physics threads, 0 for one per CPU
    :param overrides: replace values of the task, e.g. ``rho=0.3`` or ``**{"modes.jump.h": 0.2}``
    :raises ValueError: for another render mode or autoreset mode
    """

    def __init__(
        self,
        num_envs: int = 1,
        task: TaskConfig | str | Path = "parkour",
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        threads: int = 0,
        **overrides: Any,
    ) -> None:
        check_render_mode(render_mode)
        self.render_mode, self.autoreset_mode = render_mode, _autoreset_mode(autoreset_mode)
        task = loaded_task(task, overrides)
        self.batch, self.num_envs = BatchEnv(task, num_envs, threads=threads), num_envs
        self.single_observation_space, self.single_action_space = spaces_of(self.batch)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {**render_metadata(task), "autoreset_mode": self.autoreset_mode}
        self._pictures = Pictures(self.batch)
        self._observation: np.ndarray | None = None  # none before the first reset
        self._waiting = np.zeros(num_envs, dtype=bool)  # the episode has ended, the next has not begun

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin new episodes.

        :param seed: environment i is seeded with ``seed + i``, or with the ith of several; one without a seed goes on
            drawing, at first from a seed that is drawn
        :param options: ``{"reset_mask": mask}``: only these, shape (num_envs,), bool
        :return: the observations of all, shape (num_envs, size), float32; no infos
        :raises KeyError: for another option
        :raises TypeError: for a mask that is no array of bool
        :raises ValueError: for another number of seeds, or a mask of another shape, without any environment, or
            before all were reset once
        """
        super().reset(seed=int(seed) if isinstance(seed, int | np.integer) else None)
        mask = _reset_mask(options or {}, self.num_envs)
        if self._observation is None and not mask.all():
            raise ValueError(f"{MASK!r} leaves environments out, but none has been reset yet: reset all of them first.")
        rows = np.flatnonzero(mask)
        for row, own in zip(rows, self._row_seeds(seed)[mask], strict=True):
            if own is not None:
                self.batch.seed_row(int(row), int(own))
        begun = self.batch.reset(rows)
        self._observation = begun if self._observation is None else self._observation
        self._observation[rows] = begun
        self._waiting[rows] = False
        self._pictures.forget(rows)
        return self._observation.copy(), {}

    def _row_seeds(self, seed: int | Sequence[int | None] | None) -> np.ndarray:
        """A seed for each environment, shape (num_envs,), of int or None."""
        if seed is None and self._observation is None:
            seed = int(self.np_random.integers(2**31))
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + row for row in range(self.num_envs)]
        seeds = [None] * self.num_envs if seed is None else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"'seed' must be one number, or {self.num_envs} of them, found {len(seeds)}.")
        return np.array(seeds, dtype=object)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance one control step.

        :param actions: shape (num_envs, joints), clipped to [-1, 1]
        :return: observations, rewards, terminations, truncations and infos
        :raises ResetNeeded: before the first reset, and where an episode has ended that is not to begin by itself
        :raises ValueError: for actions of another shape
        """
        if self._observation is None:
            raise ResetNeeded("the environments must be reset before their first step.")
        waiting = self._waiting.copy()
        if waiting.any() and self.autoreset_mode == AutoresetMode.DISABLED:
            rows = ", ".join(map(str, np.flatnonzero(waiting)))
            raise ResetNeeded(f"the episodes of environments {rows} have ended: reset these, by the option {MASK!r}.")
        begun = self._begin(np.flatnonzero(waiting))
        result = step_others(self.batch, np.asarray(actions), waiting)
        observation = result.observation.copy()
        observation[waiting] = begun
        terminated, truncated = result.terminated & ~waiting, result.truncated & ~waiting
        done, infos = terminated | truncated, _infos(result, ~waiting)
        self._waiting = done
        if self.autoreset_mode == AutoresetMode.SAME_STEP and done.any():
            infos = {**_infos(result, ~done), **_final(result, done)}
            observation[done] = self._begin(np.flatnonzero(done))
            self._waiting = np.zeros_like(done)
        self._observation = observation
        return observation.copy(), np.where(waiting, 0.0, result.reward), terminated, truncated, infos

    def _begin(self, rows: np.ndarray) -> np.ndarray:
        """The first observations of new episodes, shape (n, size), float32."""
        self._pictures.forget(rows)
        return self.batch.reset(rows) if len(rows) else np.zeros((0, self.batch.observation_size), np.float32)

    @property
    def critic_observation(self) -> np.ndarray:
        """What only a critic sees at present, shape (num_envs, size): ``critic_observations`` of the task."""
        return self.batch.critic_observation()

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of every environment, each of shape (height, width, 3), uint8; None without a render mode.

        :raises ValueError: if there is no OpenGL
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() draws nothing: make the environments with render_mode='rgb_array'.")
            return None
        return tuple(self._pictures.draw(row) for row in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        self._pictures.close()


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    names = [each.value for each in AutoresetMode]
    if not isinstance(mode, AutoresetMode) and mode not in names:
        raise ValueError(f"unknown autoreset mode {mode!r}{did_you_mean(str(mode), names)}")
    return AutoresetMode(mode)


def _reset_mask(options: dict[str, Any], num_envs: int) -> np.ndarray:
    """Which environments are to be reset, shape (num_envs,), bool."""
    for name in options:
        if name != MASK:
            raise KeyError(f"unknown option {name!r} of a reset{did_you_mean(name, [MASK])}")
    mask = options.get(MASK, np.ones(num_envs, dtype=bool))
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        raise TypeError(f"{MASK!r} must be an array of bool, found {describe(mask)}.")
    if mask.shape != (num_envs,):
        raise ValueError(f"{MASK!r} must be of shape ({num_envs},), found {mask.shape}.")
    if not mask.any():
        raise ValueError(f"{MASK!r} names no environment to reset.")
    return mask


def _infos(result: StepResult, mask: np.ndarray) -> dict[str, Any]:
    """Infos of some environments in Gymnasium's form: each with a mask of who has it.

    :param mask: whose, shape (num_envs,), bool
    """
    if not mask.any():
        return {}
    termination = result.termination.astype(object)
    termination[~mask] = None
    deviation = np.where(mask, result.view.deviation, 0.0)
    return {"deviation": deviation, "_deviation": mask, "termination": termination, "_termination": mask.copy()}


def _final(result: StepResult, done: np.ndarray) -> dict[str, Any]:
    """Where episodes ended in this step, in Gymnasium's form."""
    observations = np.full(len(done), None, dtype=object)
    for row in np.flatnonzero(done):
        observations[row] = result.observation[row].copy()
    final_info = {"final_info": _infos(result, done), "_final_info": done.copy()}
    return {"final_obs": observations, "_final_obs": done.copy(), **final_info}
