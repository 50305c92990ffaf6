"""A training from its first sample to its last, in a run directory that it can go on with."""

from __future__ import annotations

import gc
import math
import shlex
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch as th
from stable_baselines3.common.callbacks import BaseCallback, CallbackList

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.runs.atomic import locked, reason
from ogmp_sb3.runs.autosave import Checkpoints, StopTraining, complete_best, mean_return
from ogmp_sb3.runs.banner import banner, typed_at_first
from ogmp_sb3.runs.callbacks import EpisodeStatistics, Pace, ProgressBar, UnstableSteps
from ogmp_sb3.runs.checkpoint import latest_checkpoint
from ogmp_sb3.runs.failed_steps import FOLDER as UNSTABLE
from ogmp_sb3.runs.films import FOLDER as FILMS
from ogmp_sb3.runs.films import Films
from ogmp_sb3.runs.logs import say
from ogmp_sb3.runs.own_files import check_same_files, with_own_files
from ogmp_sb3.runs.provenance import BEGAN, provenance
from ogmp_sb3.runs.robot_copy import ROBOT, read_record
from ogmp_sb3.runs.run_directory import (
    CONFIG,
    ENCODER,
    FAILURE,
    RESUMABLE,
    TRAINER,
    checkpoint_dirs,
    checkpoint_info,
    run_config,
    tidy_run,
)
from ogmp_sb3.runs.settings import TrainConfig, thread_count, torch_device, versions
from ogmp_sb3.runs.signals import saved_first
from ogmp_sb3.runs.storage import load_json, write_yaml
from ogmp_sb3.runs.tracker_runs import TrackedTraining
from ogmp_sb3.runs.trackers import check_installed, end_with, group_of, make_logger
from ogmp_sb3.sb3.learner import make_model
from ogmp_sb3.sb3.policy_average import PolicyAverage
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

NEVER: Any = None  # of SB3's own logging; its annotation knows numbers only
LOG_EVERY = 16_384  # samples between two rows of progress.csv, or a twentieth of a short run


@dataclass(frozen=True, kw_only=True)
class Job:
    """What is trained, how, and where."""

    task: TaskConfig
    """the task"""
    task_data: dict[str, Any]
    """the same as plain data, for the files"""
    config: TrainConfig
    """everything else about the training"""
    run_dir: Path
    """where to write"""
    overrides: tuple[str, ...] = ()
    """the command line, for the files; if there is none, that of before stays"""


def begin_or_go_on(job: Job) -> float:
    """Train in a directory that may hold this run already: unfinished it goes on, finished it is left alone.

    :return: mean return of the last episodes
    :raises ValueError: if the directory holds another run
    """
    run_dir = job.run_dir
    begun = bool(checkpoint_dirs(run_dir))
    if not (run_dir / CONFIG).is_file():
        if begun:
            raise ValueError(
                f"{run_dir}: has checkpoints, but no {CONFIG}. Choose another directory, or remove that one."
            )
        return train(job, resume=False)
    data = run_config(run_dir)
    name = {"task name": Path(data["task_file"]).stem}
    wanted = {"task name": job.task.name, "task": job.task_data, "train": job.config.as_data()}
    record = read_record(data, Where(str(run_dir / CONFIG)))
    for key, is_kept in (("robot", record is not None), ("encoder", (run_dir / ENCODER).is_dir())):
        if is_kept and key in job.task_data:  # what it is counts, not where
            data["task"][key] = job.task_data[key]
    _check_same(run_dir / CONFIG, {**data, **name}, wanted)
    check_same_files(job.task, run_dir, record)
    checkpoint = latest_checkpoint(run_dir) if begun else None
    if checkpoint is None or int(checkpoint.name) < job.config.total_timesteps:
        return train(job, resume=begun)
    say(f"{run_dir} is trained to step {int(checkpoint.name)} already.")
    file = checkpoint / TRAINER[1]
    statistics = read(dict[str, Any], load_json(file).get("statistics"), Where(str(file), "statistics"))
    complete_best(run_dir, statistics.get("best_at", 0))
    return float(checkpoint_info(checkpoint).get("return", math.nan))


def _check_same(file: Path, there: dict[str, Any], wanted: dict[str, Any], key: str = "") -> None:
    """:raises ValueError: naming the first key, of those that cannot change, in which two runs differ."""
    for name in [*wanted, *(name for name in there if name not in wanted)]:
        if (key == "train" and name in RESUMABLE) or (not key and name not in wanted):
            continue
        inner = f"{key}.{name}" if key else name
        before, now = there.get(name), wanted.get(name)
        if isinstance(before, dict) and isinstance(now, dict):
            _check_same(file, before, now, inner)
        elif before != now:
            raise ValueError(
                f"{file}: holds another run: '{inner}' is {before!r} there and {now!r} here. "
                "Choose another directory, or remove that one."
            )


def train(job: Job, resume: bool) -> float:
    """Train a policy and leave everything in the run directory.

    :param resume: go on from the latest checkpoint of the run directory
    :return: mean return of the last episodes
    :raises ValueError: if nothing can be written there, a checkpoint to resume from is damaged, or the library of a
        tracker is missing
    """
    check_installed(job.config.trackers)
    th.set_num_threads(thread_count(job.config.torch_threads))
    try:
        job.run_dir.mkdir(parents=True, exist_ok=True)
        with locked(job.run_dir):
            tidy_run(job.run_dir)
            (job.run_dir / FAILURE).unlink(missing_ok=True)  # of an attempt before
            mean = _train(job, latest_checkpoint(job.run_dir) if resume else None)
    except OSError as error:
        raise ValueError(f"{error.filename or job.run_dir}: {reason(error)}.") from None
    gc.collect()  # learner and environment refer to each other, and a sweep trains its next job in this process
    return mean


def _train(job: Job, checkpoint: Path | None) -> float:
    """Begin, or go on from a checkpoint, and train until the end or until asked to stop."""
    config, run_dir = job.config, job.run_dir
    task, record = with_own_files(job.task, job.task_data["robot"], run_dir, checkpoint)
    env = OgmpVecEnv(task, config.num_envs, config.seed, thread_count(config.physics_threads))
    model = make_model(env, config.ppo, config.seed, device=torch_device(config.device))
    origin = {"task": job.task_data, "task_file": task.file, ROBOT: asdict(record), "versions": versions()}
    callbacks, checkpoints = _callbacks(job, task, origin)
    progress = ProgressBar(config.total_timesteps)
    checkpoints.model = model
    if checkpoint is not None:
        checkpoints.restore(checkpoint)
        origin = {**run_config(run_dir), "task": job.task_data, ROBOT: asdict(record)}
    else:
        origin[BEGAN] = provenance()
    command = {"overrides": list(job.overrides)} if job.overrides else {}
    settings = {"task": job.task_data, "train": config.as_data(), "versions": origin.get("versions", {})}
    training = TrackedTraining(folder=run_dir, task=task.name, group=group_of(run_dir, task.name), settings=settings)
    remaining = config.total_timesteps - model.num_timesteps
    with ExitStack() as stack:
        stack.enter_context(saved_first(checkpoints))
        model.set_logger(make_logger(config.trackers, training, None if checkpoint is None else model.num_timesteps))
        stack.enter_context(closing(model.logger))
        stack.enter_context(closing(progress))
        say(banner(run_dir, config, model, job.overrides or typed_at_first(run_dir)))
        if checkpoint is not None:
            say(f"resumed at step {model.num_timesteps}")
        write_yaml(run_dir / CONFIG, {**origin, "train": config.as_data(), **command})
        try:
            if remaining > 0:
                model.learn(
                    remaining,
                    callback=CallbackList([*callbacks, Pace(config.total_timesteps), progress]),
                    log_interval=NEVER,
                    reset_num_timesteps=False,
                )
                checkpoints.save_last()
            checkpoints.hand_on()
            end_with(model.logger, checkpoints.summary())
        except StopTraining:
            checkpoints.save_last()
            say(f"\nStopped at step {model.num_timesteps}. To go on:  ogmp-train {shlex.quote(f'resume={run_dir}')}")
            raise SystemExit(130) from None
    say(f"Trained to step {model.num_timesteps}. To evaluate:  ogmp-eval {shlex.quote(f'run={run_dir}')}")
    return mean_return(model)


def _callbacks(job: Job, task: TaskConfig, origin: dict[str, Any]) -> tuple[list[BaseCallback], Checkpoints]:
    """What counts and saves in a training, in the order it is called, and the one of them that saves.

    :param task: with the robot and the encoder of the run
    :param origin: plain data for the files: the task, where it is from, the versions
    """
    config, run_dir = job.config, job.run_dir
    rollout = config.ppo.n_steps * config.num_envs
    statistics = EpisodeStatistics(every=max(rollout, min(LOG_EVERY, config.total_timesteps // 20)))
    unstable = UnstableSteps(run_dir / UNSTABLE, config.seed, origin)
    average = PolicyAverage(config.policy_average) if config.policy_average else None
    checkpoints = Checkpoints(run_dir, config, {**origin, "seed": config.seed}, statistics, unstable, average)
    callbacks: list[BaseCallback] = [checkpoints, unstable, statistics]
    if config.videos is not None:
        callbacks.append(Films(run_dir / FILMS, task, config.videos, average))
    if average is not None:
        callbacks.insert(0, average)  # a checkpoint has the average with the last update
    return callbacks, checkpoints
