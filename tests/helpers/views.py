"""A snapshot of a control step, made by hand."""

from typing import Any

import numpy as np

from ogmp_sb3.env.view import EnvView
from ogmp_sb3.guidance.rotations import quat_rotate_inverse
from ogmp_sb3.guidance.srb import STATE_SIZE
from ogmp_sb3.guidance.terrain import empty_terrain


def make_view(num_envs: int = 3, **fields: Any) -> EnvView:
    """Robots at rest at the origin, upright, 0.5 m above ground that is not there, on their reference."""
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (num_envs, 1))
    position = np.asarray(fields.get("base_pos_w", np.tile([0.0, 0.0, 0.5], (num_envs, 1))), dtype=float)
    state = np.zeros((num_envs, STATE_SIZE))
    state[:, 3:6] = position
    values: dict[str, Any] = {
        "base_pos_w": position,
        "base_quat": upright,
        "base_linvel_w": np.zeros((num_envs, 3)),
        "base_angvel_b": np.zeros((num_envs, 3)),
        "joint_pos": np.zeros((num_envs, 10)),
        "joint_vel": np.zeros((num_envs, 10)),
        "down": np.tile([0.0, 0.0, -1.0], (num_envs, 1)),
        "action": np.zeros((num_envs, 10)),
        "torque": np.zeros((num_envs, 10)),
        "body_contact": np.zeros(num_envs, dtype=bool),
        "terrain": empty_terrain(num_envs, 4),
        "ground_height": np.zeros(num_envs),
        "state": state,
        "reference": state.copy(),
        "reference_quat": upright.copy(),
        "deviation": np.zeros(num_envs),
        "latent": np.zeros((num_envs, 2)),
        "phase": np.zeros(num_envs, dtype=int),
        "period": np.full(num_envs, 30),
        "commanded_speed": np.zeros(num_envs),
    }
    values |= fields
    values.setdefault("base_linvel_b", quat_rotate_inverse(values["base_quat"], values["base_linvel_w"]))
    return EnvView(**values)
