"""Hyper-parameters for the RL Zoo (``rl_zoo3``), those of ``ogmp-train``: ``-conf ogmp_sb3.zoo``, see docs/sb3.md."""

from __future__ import annotations

import math
from typing import Any

from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.sb3.hyperparameters import DEFAULTS, default_ppo


def ppo_lstm() -> dict[str, Any]:
    """Plain data, as the Zoo saves it beside the model."""
    settings, action = default_ppo(), load_task("parkour").action
    return {
        "n_envs": read_yaml(DEFAULTS)["num_envs"],
        "n_timesteps": read_yaml(DEFAULTS)["total_timesteps"],
        "normalize": {"norm_obs": True, "norm_reward": False},
        "policy": "ogmp_sb3.sb3.policy.LstmPolicy",
        "policy_kwargs": {
            "net_arch": [],
            "lstm_hidden_size": settings.lstm_hidden_size,
            "n_lstm_layers": settings.n_lstm_layers,
            "log_std_init": math.log(action.noise / action.scale),
        },
        **settings.stock_settings(),  # the Zoo trains with sb3-contrib's own RecurrentPPO
    }


hyperparams = {"default": ppo_lstm()}
