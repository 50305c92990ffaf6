"""A training from its first sample to its last, in a run directory that it can go on with."""

from __future__ import annotations

import math
import shutil
import signal
import sys
from dataclasses import asdict, replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.callbacks import BaseCallback, CallbackList

from ogmp_sb3.adapters import OgmpVecEnv
from ogmp_sb3.checkpoints import (
    ENCODER,
    checkpoint_dirs,
    checkpoint_info,
    copy_policy,
    latest_checkpoint,
    load_trainer,
    policy_kwargs,
    save_checkpoint,
)
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.latent import copy_encoder
from ogmp_sb3.logs import EpisodeStatistics, ProgressBar, make_logger
from ogmp_sb3.recipe import TrainConfig, thread_count, versions
from ogmp_sb3.recurrent import RecurrentPPO
from ogmp_sb3.schema import read_yaml, write_yaml

LOG_EVERY = 16_384  # samples between two rows of progress.csv, or a twentieth of a short run
CONFIG = "config.yaml"  # in a run directory: the task, the run, the versions
# What may change when a run goes on.
RESUMABLE = ("total_timesteps", "checkpoint_interval", "keep_checkpoints", "torch_threads", "physics_threads")


class StopTraining(Exception):
    """Raised between two updates after Ctrl-C or SIGTERM."""


class Checkpoints(BaseCallback):
    """Saves between updates: every ``checkpoint_interval`` samples, and when asked to stop.

    :param run_dir: the run directory
    :param config: the run
    :param info: goes into every policy.json
    :param statistics: of the logs, saved with every checkpoint
    """

    def __init__(self, run_dir: Path, config: TrainConfig, info: dict[str, Any], statistics: EpisodeStatistics) -> None:
        super().__init__()
        self.run_dir, self.config, self.info, self.statistics = run_dir, config, info, statistics
        self.best = -math.inf
        self.stop_requested = False

    def request_stop(self, signum: int, frame: FrameType | None) -> None:
        """Signal handler: finish the update, save, stop."""
        if self.stop_requested:
            raise KeyboardInterrupt
        self.stop_requested = True
        print("\nStopping after this update; press Ctrl-C again to quit at once.", file=sys.stderr)

    def _on_training_start(self) -> None:
        self.saved_at = self.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.stop_requested:
            raise StopTraining
        if self.num_timesteps - self.saved_at >= self.config.checkpoint_interval:
            self.save()

    def _on_step(self) -> bool:
        return True

    def save(self) -> None:
        """Write a checkpoint, drop the oldest beyond ``keep_checkpoints``, and keep the best apart."""
        model = self.model
        assert isinstance(model, RecurrentPPO)
        steps, score = model.num_timesteps, _score(model)
        self.best, is_best = max(self.best, score), score > self.best
        folder = self.run_dir / "checkpoints" / f"{steps:012d}"
        log = self.statistics
        statistics = {"sums": log.sums, "causes": log.causes, "best": self.best}
        save_checkpoint(model, folder, {**self.info, "num_timesteps": steps, "return": _mean_return(model)}, statistics)
        self.saved_at = steps
        if is_best:
            copy_policy(folder, self.run_dir / "best")
        for old in checkpoint_dirs(self.run_dir)[: -self.config.keep_checkpoints]:
            shutil.rmtree(old)

    def restore(self, statistics: dict[str, Any]) -> None:
        """Go on with the statistics of a checkpoint."""
        self.statistics.sums, self.statistics.causes = statistics["sums"], statistics["causes"]
        self.best = statistics["best"]


def _mean_return(model: RecurrentPPO) -> float:
    """Mean return of the last episodes, -1e9 before the first one has ended."""
    returns = [episode["r"] for episode in model.ep_info_buffer or []]
    return float(np.mean(returns)) if returns else -1e9


def _score(model: RecurrentPPO) -> float:
    """By what the best policy is chosen: the curriculum's level in tenths first, then the mean return."""
    levels = [episode["level"] for episode in model.ep_info_buffer or []]
    level = round(float(np.mean(levels)), 1) if levels else 0.0
    steps: int = model.env.batch.task.episode_steps  # type: ignore[union-attr]
    return level * steps + _mean_return(model)


def begin_or_go_on(task: TaskConfig, task_data: dict[str, Any], config: TrainConfig, run_dir: Path) -> float:
    """Train in a directory that may hold this run already: unfinished it goes on, finished it is left alone.

    :param task: the task
    :param task_data: the same as plain data
    :param config: the run
    :param run_dir: where to write
    :return: mean return of the last episodes
    :raises ValueError: if the directory holds another run
    """
    if not (run_dir / CONFIG).is_file() or not checkpoint_dirs(run_dir):
        return train(task, task_data, config, run_dir, resume=False)
    data = read_yaml(run_dir / CONFIG)
    name = {"task name": Path(data["task_file"]).stem}
    wanted = {"task name": task.name, "task": task_data, "train": asdict(config)}
    _check_same(run_dir / CONFIG, {**data, **name}, wanted)
    checkpoint = latest_checkpoint(run_dir)
    if int(checkpoint.name) >= config.total_timesteps:
        print(f"{run_dir} is trained to step {int(checkpoint.name)} already.")
        return float(checkpoint_info(checkpoint)["return"])
    write_yaml(run_dir / CONFIG, {**data, "train": asdict(config)})
    return train(task, task_data, config, run_dir, resume=True)


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


def train(task: TaskConfig, task_data: dict[str, Any], config: TrainConfig, run_dir: Path, resume: bool) -> float:
    """Train a policy and leave everything in the run directory.

    :param task: the task
    :param task_data: the same as plain data, for the files
    :param config: the run
    :param run_dir: where to write
    :param resume: go on from the latest checkpoint of ``run_dir``
    :return: mean return of the last episodes
    """
    th.set_num_threads(thread_count(config.torch_threads))
    if task.uses_latent and task.encoder:
        if not resume:
            copy_encoder(task.encoder, run_dir / ENCODER)
        task = replace(task, encoder=str(run_dir / ENCODER))
    env = OgmpVecEnv(task, config.num_envs, config.seed, thread_count(config.physics_threads))
    network = policy_kwargs(
        env.batch.observation_scale,
        lstm_hidden_size=config.ppo.lstm_hidden_size,
        n_lstm_layers=config.ppo.n_lstm_layers,
        log_std_init=float(np.log(task.action.noise / task.action.scale)),
    )
    model = RecurrentPPO(
        "MlpLstmPolicy", env, seed=config.seed, device="cpu", policy_kwargs=network, **config.ppo.settings()
    )
    # By samples, not by the share that is done: a run does not depend on how far it will go.
    model.lr_schedule = lambda _: config.ppo.learning_rate_at(model.num_timesteps)
    info = {"task": task_data, "task_file": task.file, "seed": config.seed, "versions": versions()}
    rollout = config.ppo.n_steps * config.num_envs
    statistics = EpisodeStatistics(every=max(rollout, min(LOG_EVERY, config.total_timesteps // 20)))
    checkpoints = Checkpoints(run_dir, config, info, statistics)
    if resume:
        checkpoints.restore(load_trainer(model, latest_checkpoint(run_dir)))
        print(f"resumed at step {model.num_timesteps}")
    else:
        _write_run_files(run_dir, task_data, task, config)
    model.set_logger(make_logger(run_dir, resumed_at=model.num_timesteps))
    callbacks = CallbackList([checkpoints, statistics, ProgressBar(config.total_timesteps)])
    handlers = {s: signal.signal(s, checkpoints.request_stop) for s in (signal.SIGINT, signal.SIGTERM)}
    remaining = config.total_timesteps - model.num_timesteps
    try:
        if remaining > 0:
            model.learn(remaining, callback=callbacks, log_interval=None, reset_num_timesteps=False)  # type: ignore[arg-type]
    except StopTraining:
        checkpoints.save()
        print(f"\nStopped at step {model.num_timesteps}. To go on:  ogmp-train resume={run_dir}")
        raise SystemExit(130) from None
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        model.logger.close()
    if remaining > 0:
        checkpoints.save()
    print(f"Trained to step {model.num_timesteps}. To evaluate:  ogmp-eval run={run_dir}")
    return _mean_return(model)


def _write_run_files(run_dir: Path, task_data: dict[str, Any], task: TaskConfig, config: TrainConfig) -> None:
    run_dir.mkdir(parents=True, exist_ok=True)
    data = {"task": task_data, "task_file": task.file, "train": asdict(config), "versions": versions()}
    write_yaml(run_dir / CONFIG, data)
