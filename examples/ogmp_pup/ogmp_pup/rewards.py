"""A reward of our own."""

import numpy as np

from ogmp_sb3.extend import EnvView, reward


@reward
def calm(view: EnvView, weight: float, sharpness: float) -> np.ndarray:
    """``weight exp(-sharpness ||joint velocities||)``, in rad/s, shape (num_envs,).

    :param weight: reward of joints at rest
    :param sharpness: how fast it falls with their speed, s/rad
    """
    return weight * np.exp(-sharpness * np.linalg.norm(view.joint_vel, axis=1))
