"""Environments without physics: random observations, and episodes that end at random, a given share of the steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.sb3.gym_env import spaces_of


class RandomEnv(VecEnv):
    """Shapes and scales of a task, and nothing else of it, so that a learner alone is what takes time.

    :param task: the task
    :param num_envs: number of environments
    :param endings: share of the steps that end an episode
    :param seed: of everything that is random
    """

    def __init__(self, task: TaskConfig, num_envs: int, endings: float, seed: int = 0) -> None:
        self.batch = BatchEnv(task, 1, threads=1)  # whose scales a policy asks for
        self.render_mode = None
        super().__init__(num_envs, *spaces_of(self.batch))
        self.endings, self._rng = endings, np.random.default_rng(seed)

    def _observation(self) -> np.ndarray:
        size = (self.num_envs, self.batch.observation_size)
        return (self.batch.observation_scale * self._rng.standard_normal(size)).astype(np.float32)

    def reset(self) -> np.ndarray:
        return self._observation()

    def step_async(self, actions: np.ndarray) -> None:
        pass

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        rewards = self._rng.random(self.num_envs, dtype=np.float32)
        dones = self._rng.random(self.num_envs) < self.endings
        return self._observation(), rewards, dones, [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        return [getattr(self, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        return [False] * self.num_envs

    def get_images(self) -> Sequence[np.ndarray | None]:
        return [None] * self.num_envs
