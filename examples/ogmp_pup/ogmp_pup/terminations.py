"""A termination of our own."""

import numpy as np

from ogmp_sb3.config.registry import terminations
from ogmp_sb3.env.view import EnvView
from ogmp_sb3.guidance.rotations import quat_rotate

UP = np.array([0.0, 0.0, 1.0])


@terminations.register()
def tipped(view: EnvView, max_tilt: float) -> np.ndarray:
    """True where the trunk leans farther from upright than ``max_tilt`` (rad), shape (num_envs,), bool."""
    return quat_rotate(view.base_quat, UP)[:, 2] < np.cos(max_tilt)
