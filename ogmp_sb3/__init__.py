"""Oracle Guided Multi-mode Policies for legged robots, as a plug-in for Stable-Baselines3.

Train on environments of a task, and test the policy that ships::

    from ogmp_sb3 import load_policy, make_env, make_model, play_episodes

    env = make_env("parkour", num_envs=64, rho=0.4)  # an SB3 VecEnv; any key of the task file may be replaced
    model = make_model(env, learning_rate=1e-4)  # the RecurrentPPO of ogmp-train
    model.learn(100_000)
    model.save("my_policy.zip")

    loaded = load_policy("parkour")
    for episode in play_episodes(loaded.policy, loaded.task.for_evaluation(), episodes=4, seed=0):
        print(episode.steps, episode.termination)

Modes, oracles and terms of your own: :mod:`ogmp_sb3.extend`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium

from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env import observations, randomisation, rewards, terminations  # noqa: F401

# Importing these modules registers what a task file can name.
from ogmp_sb3.evaluation import metrics  # noqa: F401
from ogmp_sb3.guidance import modes, oracles  # noqa: F401
from ogmp_sb3.machine import import_matplotlib
from ogmp_sb3.rendering.opengl import import_mujoco

if TYPE_CHECKING:
    from ogmp_sb3.env.batch_env import BatchEnv
    from ogmp_sb3.evaluation.episodes import play_episodes
    from ogmp_sb3.evaluation.evaluate import evaluate
    from ogmp_sb3.rendering.player import Player
    from ogmp_sb3.rendering.video import write_video
    from ogmp_sb3.runs.policies import load_policy
    from ogmp_sb3.sb3.gym_env import OgmpEnv
    from ogmp_sb3.sb3.gym_vector_env import OgmpVectorEnv
    from ogmp_sb3.sb3.learner import make_model
    from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
    from ogmp_sb3.sb3.rsl_rl_env import RslRlVecEnv
    from ogmp_sb3.sb3.vec_env import OgmpVecEnv, make_env

__version__ = "0.1.0"
__all__ = [
    "BatchEnv",
    "OgmpEnv",
    "OgmpVecEnv",
    "OgmpVectorEnv",
    "Player",
    "RecurrentPPO",
    "RslRlVecEnv",
    "TaskConfig",
    "evaluate",
    "load_policy",
    "load_task",
    "make_env",
    "make_model",
    "play_episodes",
    "write_video",
]

_LATER = {
    "BatchEnv": "env.batch_env",
    "OgmpEnv": "sb3.gym_env",
    "OgmpVecEnv": "sb3.vec_env",
    "OgmpVectorEnv": "sb3.gym_vector_env",
    "Player": "rendering.player",
    "RecurrentPPO": "sb3.recurrent_ppo",
    "RslRlVecEnv": "sb3.rsl_rl_env",
    "evaluate": "evaluation.evaluate",
    "load_policy": "runs.policies",
    "make_env": "sb3.vec_env",
    "make_model": "sb3.learner",
    "play_episodes": "evaluation.episodes",
    "write_video": "rendering.video",
}

import_matplotlib()
import_mujoco()

for _name in (path.stem for path in sorted(TASKS_DIR.glob("*.yaml"))):
    gymnasium.register(
        f"OGMP/{_name.title().replace('_', '')}-v0",
        entry_point="ogmp_sb3.sb3.gym_env:OgmpEnv",
        vector_entry_point="ogmp_sb3.sb3.gym_vector_env:OgmpVectorEnv",
        kwargs={"task": _name},
    )


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def __getattr__(name: str) -> Any:
    """Import what takes long, as PyTorch does, only when it is asked for."""
    if name in _LATER:
        import importlib

        return getattr(importlib.import_module(f"ogmp_sb3.{_LATER[name]}"), name)
    raise AttributeError(f"module 'ogmp_sb3' has no attribute '{name}'")
