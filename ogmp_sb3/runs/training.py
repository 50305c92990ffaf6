"""A training from its first sample to its last, in a run directory that it can go on with."""

from __future__ import annotations

import gc
import math
import shlex
import signal
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch as th
from stable_baselines3.common.callbacks import CallbackList

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.latent import changed_file, copy_encoder
from ogmp_sb3.runs.atomic import alone, reason
from ogmp_sb3.runs.autosave import Checkpoints, StopTraining, complete_best, mean_return
from ogmp_sb3.runs.callbacks import EpisodeStatistics, ProgressBar, UnstableSteps
from ogmp_sb3.runs.checkpoint import latest_checkpoint
from ogmp_sb3.runs.failed_steps import FOLDER as UNSTABLE
from ogmp_sb3.runs.logs import make_logger
from ogmp_sb3.runs.run_directory import (
    CONFIG,
    ENCODER,
    RESUMABLE,
    TRAINER,
    checkpoint_dirs,
    checkpoint_info,
    run_config,
    tidy_run,
)
from ogmp_sb3.runs.settings import TrainConfig, thread_count, versions
from ogmp_sb3.runs.storage import load_json, write_yaml
from ogmp_sb3.sb3.learner import make_model
from ogmp_sb3.sb3.policy_average import PolicyAverage
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

LOG_EVERY = 16_384  # samples between two rows of progress.csv, or a twentieth of a short run


def begin_or_go_on(
    task: TaskConfig, task_data: dict[str, Any], config: TrainConfig, run_dir: Path, overrides: Sequence[str] = ()
) -> float:
    """Train in a directory that may hold this run already: unfinished it goes on, finished it is left alone.

    :param task: the task
    :param task_data: the same as plain data
    :param config: the run
    :param run_dir: where to write
    :param overrides: the command line, for the files
    :return: mean return of the last episodes
    :raises ValueError: if the directory holds another run
    """
    begun = bool(checkpoint_dirs(run_dir))
    if not (run_dir / CONFIG).is_file():
        if begun:
            raise ValueError(
                f"{run_dir}: has checkpoints, but no {CONFIG}. Choose another directory, or remove that one."
            )
        return train(task, task_data, config, run_dir, False, overrides)
    data = run_config(run_dir)
    name = {"task name": Path(data["task_file"]).stem}
    wanted = {"task name": task.name, "task": task_data, "train": asdict(config)}
    _check_same(run_dir / CONFIG, {**data, **name}, wanted)
    if not begun:
        return train(task, task_data, config, run_dir, False, overrides)
    checkpoint = latest_checkpoint(run_dir)
    if int(checkpoint.name) >= config.total_timesteps:
        print(f"{run_dir} is trained to step {int(checkpoint.name)} already.")
        file = checkpoint / TRAINER[1]
        statistics = read(dict[str, Any], load_json(file).get("statistics"), Where(str(file), "statistics"))
        complete_best(run_dir, statistics.get("best_at", 0))
        return float(checkpoint_info(checkpoint).get("return", math.nan))
    return train(task, task_data, config, run_dir, True, overrides)


def _check_same(file: Path, found: dict[str, Any], wanted: dict[str, Any], key: str = "") -> None:
    """:raises ValueError: naming the first key, of those that cannot change, in which two runs differ."""
    for name in [*wanted, *(name for name in found if name not in wanted)]:
        if (key == "train" and name in RESUMABLE) or (not key and name not in wanted):
            continue
        inner = f"{key}.{name}" if key else name
        before, now = found.get(name), wanted.get(name)
        if isinstance(before, dict) and isinstance(now, dict):
            _check_same(file, before, now, inner)
        elif before != now:
            raise ValueError(
                f"{file}: holds another run: '{inner}' is {before!r} there and {now!r} here. "
                "Choose another directory, or remove that one."
            )


def train(
    task: TaskConfig,
    task_data: dict[str, Any],
    config: TrainConfig,
    run_dir: Path,
    resume: bool,
    overrides: Sequence[str] = (),
) -> float:
    """Train a policy and leave everything in the run directory.

    :param task: the task
    :param task_data: the same as plain data, for the files
    :param config: the run
    :param run_dir: where to write
    :param resume: go on from the latest checkpoint of ``run_dir``
    :param overrides: the command line, for the files; if there is none, that of before stays
    :return: mean return of the last episodes
    :raises ValueError: if nothing can be written there, or a checkpoint to resume from is damaged
    """
    th.set_num_threads(thread_count(config.torch_threads))
    try:
        run_dir.mkdir(parents=True, exist_ok=True)
        with alone(run_dir):
            tidy_run(run_dir)
            returned = _train(task, task_data, config, run_dir, resume, overrides)
    except OSError as error:
        raise ValueError(f"{error.filename or run_dir}: {reason(error)}.") from None
    gc.collect()  # learner and environment refer to each other, and a sweep trains its next job in this process
    return returned


def _train(
    task: TaskConfig,
    task_data: dict[str, Any],
    config: TrainConfig,
    run_dir: Path,
    resume: bool,
    overrides: Sequence[str],
) -> float:
    checkpoint = latest_checkpoint(run_dir) if resume else None
    if task.uses_latent and task.encoder:
        if checkpoint is None:
            copy_encoder(task.encoder, run_dir / ENCODER)
        else:
            _check_encoder(run_dir / ENCODER, checkpoint / ENCODER)
        task = replace(task, encoder=str(run_dir / ENCODER))
    env = OgmpVecEnv(task, config.num_envs, config.seed, thread_count(config.physics_threads))
    model = make_model(env, config.ppo, config.seed)
    origin = {"task": task_data, "task_file": task.file, "versions": versions()}
    rollout = config.ppo.n_steps * config.num_envs
    statistics = EpisodeStatistics(every=max(rollout, min(LOG_EVERY, config.total_timesteps // 20)))
    unstable = UnstableSteps(run_dir / UNSTABLE, config.seed, origin)
    average = PolicyAverage(config.policy_average) if config.policy_average else None
    checkpoints = Checkpoints(run_dir, config, {**origin, "seed": config.seed}, statistics, unstable, average)
    checkpoints.model = model
    if checkpoint is not None:
        checkpoints.restore(checkpoint)
        origin = run_config(run_dir)
    command = {"overrides": list(overrides)} if overrides else {}
    write_yaml(run_dir / CONFIG, {**origin, "train": asdict(config), **command})
    model.set_logger(make_logger(run_dir, resumed_at=model.num_timesteps))
    if checkpoint is not None:
        print(f"resumed at step {model.num_timesteps}")
    callbacks = [checkpoints, unstable, statistics, ProgressBar(config.total_timesteps)]
    if average is not None:
        callbacks.insert(0, average)  # a checkpoint has the average with the last update
    handlers = {s: signal.signal(s, checkpoints.request_stop) for s in (signal.SIGINT, signal.SIGTERM)}
    remaining = config.total_timesteps - model.num_timesteps
    try:
        if remaining > 0:
            never: Any = None  # to SB3, though its annotation knows numbers only
            model.learn(remaining, callback=CallbackList(callbacks), log_interval=never, reset_num_timesteps=False)
            checkpoints.save_last()
    except StopTraining:
        checkpoints.save_last()
        print(f"\nStopped at step {model.num_timesteps}. To go on:  ogmp-train {shlex.quote(f'resume={run_dir}')}")
        raise SystemExit(130) from None
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        model.logger.close()
    print(f"Trained to step {model.num_timesteps}. To evaluate:  ogmp-eval {shlex.quote(f'run={run_dir}')}")
    return mean_return(model)


def _check_encoder(used: Path, saved: Path) -> None:
    """:raises ValueError: if the encoder of a run is not that of its checkpoint, whose checksums hold."""
    name = changed_file(saved, used)
    if name:
        raise ValueError(f"{used / name}: not the file that the run was trained with, which is {saved / name}.")
