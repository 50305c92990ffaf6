"""Reward terms of the paper (sec. III-C): pure functions of an :class:`~ogmp_sb3.env.view.EnvView`.

None exceeds its ``weight``, or 0 if that is negative.
"""

from __future__ import annotations

import numpy as np

from ogmp_sb3.config.registry import parameter_units, rewards
from ogmp_sb3.config.task import Terms
from ogmp_sb3.env.view import EnvView


@rewards.register()
@parameter_units(sharpness="1/m")
def position_tracking(view: EnvView, weight: float, sharpness: float) -> np.ndarray:
    """``weight exp(-sharpness ||p_ref - p||)``, the trunk's origin in metres, shape (num_envs,)."""
    error = np.linalg.norm(view.reference[:, 3:6] - view.base_pos_w, axis=1)
    reward: np.ndarray = weight * np.exp(-sharpness * error)
    return reward


@rewards.register()
def orientation_tracking(view: EnvView, weight: float, sharpness: float) -> np.ndarray:
    """``weight exp(-sharpness (1 - <q, q_ref>^2))``: the sine squared of half the error angle, shape (num_envs,)."""
    inner = np.einsum("ij,ij->i", view.base_quat, view.reference_quat)
    reward: np.ndarray = weight * np.exp(-sharpness * (1.0 - inner**2))
    return reward


@rewards.register()
@parameter_units(sharpness="1/(N m)")
def torque_regulation(view: EnvView, weight: float, sharpness: float) -> np.ndarray:
    """``weight exp(-sharpness ||u||)``, u the PD torque before the limits in N m, shape (num_envs,)."""
    reward: np.ndarray = weight * np.exp(-sharpness * np.linalg.norm(view.torque, axis=1))
    return reward


@rewards.register()
def body_contact(view: EnvView, weight: float) -> np.ndarray:
    """``weight`` while anything but a foot touches the terrain, shape (num_envs,)."""
    return weight * view.body_contact.astype(float)


def highest_reward(terms: Terms) -> float | None:
    """The most that one control step can give, the sum of all positive weights.

    :param terms: reward terms in use with their parameters, as in a task file
    :return: None if a term has no ``weight``, so that its bound is not known
    """
    in_use = [parameters for parameters in terms.values() if parameters is not None]
    if not all("weight" in parameters for parameters in in_use):
        return None
    return float(sum(max(parameters["weight"], 0.0) for parameters in in_use))
