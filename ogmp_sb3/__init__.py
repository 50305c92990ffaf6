"""Oracle Guided Multi-mode Policies for legged robots, as a plug-in for Stable-Baselines3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium

# Importing these modules registers what a task file can name.
from ogmp_sb3 import metrics, modes, observations, oracles, rewards, terminations  # noqa: F401
from ogmp_sb3.config import load_task
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.opengl import import_mujoco

if TYPE_CHECKING:
    from ogmp_sb3.adapters import OgmpEnv, OgmpVecEnv, make_env
    from ogmp_sb3.recurrent import RecurrentPPO

__version__ = "0.1.0"
__all__ = ["OgmpEnv", "OgmpVecEnv", "RecurrentPPO", "TaskConfig", "load_task", "make_env"]

_HEAVY = {"OgmpEnv": "adapters", "OgmpVecEnv": "adapters", "make_env": "adapters", "RecurrentPPO": "recurrent"}

import_mujoco()

for _name in ("Parkour", "Dive"):
    gymnasium.register(f"OGMP/{_name}-v0", entry_point="ogmp_sb3.adapters:OgmpEnv", kwargs={"task": _name.lower()})


def __getattr__(name: str) -> Any:
    """Import what needs PyTorch only when it is asked for."""
    if name in _HEAVY:
        import importlib

        return getattr(importlib.import_module(f"ogmp_sb3.{_HEAVY[name]}"), name)
    raise AttributeError(f"module 'ogmp_sb3' has no attribute '{name}'")
