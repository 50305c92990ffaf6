"""What a training says of itself before its first sample: where, what, with how much, and how to look at it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.runs.films import FOLDER as FILMS
from ogmp_sb3.runs.run_directory import CONFIG, RESUMABLE, entry, run_config
from ogmp_sb3.runs.run_folders import relative
from ogmp_sb3.runs.settings import TENSORBOARD, TrainConfig, thread_count
from ogmp_sb3.sb3.hyperparameters import PPOConfig
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.vec_env import OgmpVecEnv


def banner(run_dir: Path, config: TrainConfig, model: RecurrentPPO, overrides: Sequence[str]) -> str:
    """Plain text of a dozen lines, without colours and the like.

    :param model: the learner, on an :class:`~ogmp_sb3.sb3.vec_env.OgmpVecEnv`
    :param overrides: the command line, ``key=value``
    """
    env = model.env
    assert isinstance(env, OgmpVecEnv)
    task, robot = env.batch.task, env.batch.task.robot_config
    folder = relative(run_dir, Path())
    changed = [override for override in overrides if not override.startswith("task=")]
    rows = {
        "task": _task(task),
        "changed": shlex.join(changed) if changed else "nothing, all settings are the defaults",
        "robot": f"{robot.name}, {len(robot.joints)} joints, {robot.srb.mass:.3g} kg",
        "observation": _observation(env),
        "network": f"{_network(config.ppo)}, {sum(p.numel() for p in model.policy.parameters()):,} parameters",
        "samples": _samples(config, model.num_timesteps),
        "threads": f"{thread_count(config.physics_threads)} for physics, {thread_count(config.torch_threads)} for the "
        f"networks, which are on {model.device}",
        "time": "said after half a minute of training, by its pace",
        **({"videos": f"every {config.videos:,} samples into {folder}/{FILMS}"} if config.videos else {}),
        **({"TensorBoard": f"tensorboard --logdir {shlex.quote(folder)}"} if TENSORBOARD in config.trackers else {}),
    }
    width = max(map(len, rows))
    return "\n".join([folder, *(f"  {name:<{width}}  {text}" for name, text in rows.items())])


def typed_at_first(run_dir: Path) -> tuple[str, ...]:
    """The command line that a run was begun with, without what may have changed since; nothing if it has not begun.

    :raises ValueError: if it cannot be read
    """
    if not (run_dir / CONFIG).is_file():
        return ()
    data: dict[str, Any] = {"overrides": [], **run_config(run_dir)}
    overrides: tuple[str, ...] = entry(data, "overrides", tuple[str, ...], Where(str(run_dir / CONFIG)))
    return tuple(override for override in overrides if override.partition("=")[0].lstrip("+") not in RESUMABLE)


def _task(task: TaskConfig) -> str:
    rho = "no bound" if task.rho is None else f"rho {task.rho:g}"
    return f"{task.name}: {', '.join(task.mode_ranges)}; {task.oracle} oracle, {rho}"


def _observation(env: OgmpVecEnv) -> str:
    extra = env.critic_observation.shape[1]
    return f"{env.batch.observation_size} numbers" + (f", and {extra} more for the critic" if extra else "")


def _network(ppo: PPOConfig) -> str:
    layers = f"layers of {_sizes(ppo.input_layers)} and " if ppo.input_layers else ""
    lstm = f"{layers}LSTM {ppo.n_lstm_layers} x {ppo.lstm_hidden_size}"
    if ppo.critic_layers is None:
        return f"{lstm} each for actor and critic"
    return f"{lstm} for the actor, layers of {_sizes(ppo.critic_layers)} for the critic"


def _sizes(layers: Sequence[int]) -> str:
    return ", ".join(map(str, layers))


def _samples(config: TrainConfig, done: int) -> str:
    begun = f"{done:,} of " if done else ""
    update = config.ppo.n_steps * config.num_envs
    return f"{begun}{config.total_timesteps:,}, {update:,} to an update from {config.num_envs} environments"
