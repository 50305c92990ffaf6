"""A termination of our own."""

import numpy as np

from ogmp_sb3.extend import EnvView, quat_rotate, termination

UP = np.array([0.0, 0.0, 1.0])


@termination
def tipped(view: EnvView, max_tilt: float) -> np.ndarray:
    """True where the trunk leans farther from upright than ``max_tilt`` (rad), shape (num_envs,), bool."""
    return quat_rotate(view.base_quat, UP)[:, 2] < np.cos(max_tilt)
