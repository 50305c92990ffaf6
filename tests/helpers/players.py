"""Players without a trained policy, and a task of flat ground."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from gymnasium import spaces

from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.sb3.policy import LstmPolicy


class Still:
    """A policy that holds the nominal pose, and remembers when it was told that an episode starts."""

    def __init__(self, observations: int) -> None:
        self.observation_space = spaces.Box(-1.0, 1.0, (observations,))
        self.starts: list[bool] = []

    def predict(self, observation: np.ndarray, state: Any, episode_start: np.ndarray, deterministic: bool) -> Any:
        assert deterministic
        self.starts.append(bool(episode_start[0]))
        return np.zeros((1, 10)), (np.zeros(1),)


def still_player(task: TaskConfig, seed: int = 0) -> Player:
    return Player(task, cast(LstmPolicy, Still(BatchEnv(task).observation_size)), seed)


def flat(**overrides: Any) -> TaskConfig:
    return load_task("parkour", {"modes.jump": None, "modes.leap": None, "curriculum": None, **overrides})
