"""A learner of seconds: a small network on a few environments, trained a little."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch as th
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.yaml_files import apply_overrides, read_yaml
from ogmp_sb3.runs.checkpoint import save_checkpoint
from ogmp_sb3.sb3.policy import policy_kwargs
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

STEPS, ENVS = 8, 2
ROLLOUT = STEPS * ENVS
PATH = TASKS_DIR / "dive.yaml"


def task_data(**changes: Any) -> dict[str, Any]:
    return {**read_yaml(PATH), **changes}


def policy_info() -> dict[str, Any]:
    """What a training writes into policy.json."""
    return {"task": task_data(), "task_file": str(PATH), "seed": 0, "versions": {"mujoco": "3"}}


def learner(seed: int = 0, hidden: int = 8, envs: int = ENVS, **changes: Any) -> tuple[RecurrentPPO, BaseCallback]:
    """A learner before its first rollout, and a callback that does nothing."""
    env = OgmpVecEnv(task_from_data(task_data(**changes), PATH), envs, seed, threads=1)
    seen_by_critic = env.critic_observation.shape[1]
    scale = env.batch.observation_scale
    kwargs = policy_kwargs(scale, lstm_hidden_size=hidden, n_lstm_layers=1, critic_inputs=seen_by_critic)
    settings: dict[str, Any] = {"n_steps": STEPS, "batch_size": ROLLOUT, "n_epochs": 1, "seed": seed}
    model = RecurrentPPO("MlpLstmPolicy", env, device="cpu", policy_kwargs=kwargs, **settings)
    _, callback = model._setup_learn(10**6)
    model.set_logger(Logger(None, []))
    return model, callback


def update(model: RecurrentPPO, callback: BaseCallback, times: int = 1) -> None:
    for _ in range(times):
        model.collect_rollouts(model.env, callback, model.rollout_buffer, model.n_steps)
        model.train()


def whole(folder: Path) -> bool:
    return (folder / "policy.safetensors").is_file() and (folder / "policy.json").is_file()


def make_policy(folder: Path, name: str, layers: int, *overrides: str, input_layers: tuple[int, ...] = ()) -> Path:
    """A policy with random weights whose actions reach their limits now and then.

    :param layers: of the LSTMs
    :param input_layers: units of the layers in front of them
    """
    path = TASKS_DIR / f"{name}.yaml"
    data = apply_overrides(read_yaml(path), overrides, name)
    env = OgmpVecEnv(task_from_data(data, path), num_envs=4, threads=1)
    kwargs = policy_kwargs(
        env.batch.observation_scale, lstm_hidden_size=32, n_lstm_layers=layers, input_layers=input_layers
    )
    model = RecurrentPPO("MlpLstmPolicy", env, n_steps=16, batch_size=64, n_epochs=1, seed=0, policy_kwargs=kwargs)
    model.learn(64)
    with th.no_grad():
        model.policy.action_net.weight.mul_(150.0)
        model.policy.action_net.bias.normal_()
    save_checkpoint(model, folder, {"task": data, "task_file": str(path)})
    return folder
