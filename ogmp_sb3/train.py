"""``ogmp-train``: train one policy for a task, or a sweep of them (``-m``), or go on with a run (``resume=``)."""

from __future__ import annotations

import itertools
import math
import shutil
import signal
import sys
from dataclasses import asdict, replace
from pathlib import Path
from types import FrameType
from typing import Any

import hydra
import numpy as np
import torch as th
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from stable_baselines3.common.callbacks import BaseCallback, CallbackList

from ogmp_sb3.adapters import OgmpVecEnv
from ogmp_sb3.checkpoints import (
    ENCODER,
    checkpoint_dirs,
    copy_policy,
    latest_checkpoint,
    load_trainer,
    policy_kwargs,
    save_checkpoint,
)
from ogmp_sb3.config import TASKS_DIR, task_from_data, task_names, task_path
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.latent import copy_encoder
from ogmp_sb3.logs import EpisodeStatistics, ProgressBar, make_logger
from ogmp_sb3.recipe import TrainConfig, thread_count, versions
from ogmp_sb3.recurrent import RecurrentPPO
from ogmp_sb3.registry import did_you_mean
from ogmp_sb3.schema import Where, read, read_yaml

LOG_EVERY = 16_384  # samples between two rows of progress.csv, or a twentieth of a short run
REPLACES_TASK = ("rho", "oracle", "horizon")
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
        steps, value = model.num_timesteps, _mean_return(model)
        self.best, is_best = max(self.best, value), value > self.best
        folder = self.run_dir / "checkpoints" / f"{steps:012d}"
        log = self.statistics
        statistics = {"sums": log.sums, "causes": log.causes, "best": self.best}
        save_checkpoint(model, folder, {**self.info, "num_timesteps": steps, "return": value}, statistics)
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
    OmegaConf.save(OmegaConf.create(data), run_dir / "config.yaml")


def _task_of(cfg: DictConfig) -> tuple[TaskConfig, dict[str, Any]]:
    """The task of a composed configuration, with the bare rho, oracle and horizon put in."""
    name = HydraConfig.get().runtime.choices["task"]
    path = _task_file(name)
    data = OmegaConf.to_container(cfg.task)
    assert isinstance(data, dict)
    for key in REPLACES_TASK:
        if not OmegaConf.is_missing(cfg, key):
            data[key] = cfg[key]
    robot = str(data.get("robot", ""))
    if robot.endswith((".yaml", ".yml")):
        data["robot"] = str((path.parent / robot).resolve())
    return task_from_data(data, path), data  # type: ignore[return-value,arg-type]


def _task_file(name: str) -> Path:
    """Where Hydra found a task: a path given by the user, the user's directory, or ours."""
    if name in _task_files:
        return _task_files[name]
    for source in HydraConfig.get().runtime.config_sources:
        path = Path(source.path) / "task" / f"{name}.yaml"
        if source.schema == "file" and path.is_file():
            return path
    try:
        return task_path(name)
    except KeyError:  # of a source that is no directory
        return Path(f"{name}.yaml")


@hydra.main(version_base="1.3", config_path="conf", config_name="train")
def _hydra_main(cfg: DictConfig) -> float:
    run_dir = Path(HydraConfig.get().runtime.output_dir)
    try:
        task, task_data = _task_of(cfg)
        plain = OmegaConf.to_container(cfg, throw_on_missing=False)
        assert isinstance(plain, dict)
        values = {k: v for k, v in plain.items() if k not in ("task", *REPLACES_TASK)}
        config = read(TrainConfig, values, Where("ogmp-train"))
        return train(task, task_data, config, run_dir, resume=False)
    except (ValueError, KeyError, TypeError) as error:
        _fail(error)
        raise


def _resume(arguments: list[str]) -> None:
    """``ogmp-train resume=<run dir> [total_timesteps=...]``: everything else is as it was."""
    given = dict(argument.partition("=")[::2] for argument in arguments)
    run_dir = Path(given.pop("resume"))
    data = read_yaml(run_dir / "config.yaml")
    for key, value in given.items():
        if key not in RESUMABLE:
            raise KeyError(f"'{key}' cannot change when a run is resumed{did_you_mean(key, RESUMABLE)}")
        data["train"][key] = int(value) if value.isdigit() else value
    task = task_from_data(data["task"], Path(data["task_file"]))
    config = read(TrainConfig, data["train"], Where(str(run_dir / "config.yaml"), "train"))
    data["train"] = asdict(config)
    train(task, data["task"], config, run_dir, resume=True)
    OmegaConf.save(OmegaConf.create(data), run_dir / "config.yaml")


_task_files: dict[str, Path] = {}  # tasks given by path, by the name they are registered under


def _register_tasks(arguments: list[str]) -> list[str]:
    """Make tasks known to Hydra: shipped ones, those given by path, and those of plug-ins if one may be meant.

    :return: the arguments, with names for paths
    :raises KeyError: for a task that is nowhere
    """
    _task_files.clear()
    rewritten, names = [], set()
    for argument in arguments:
        key, sign, value = argument.partition("=")
        if key == "task" and sign:
            given = [_register_path(name) for name in value.split(",")]
            argument = f"task={','.join(given)}"
            names.update(given)
        rewritten.append(argument)
    known = {path.stem for path in TASKS_DIR.glob("*.yaml")}
    own = {path.stem for folder in _config_dirs(arguments) for path in folder.glob("task/*.yaml")} | set(_task_files)
    all_listed = not names or bool({"--help", "-h"} & set(arguments))
    if all_listed or not names <= known | own:
        known.update(task_names())
    for name in known - own:  # a user's file of the same name counts
        _store(name, task_path(name))
    if not any(argument.startswith("hydra.searchpath=") for argument in arguments):
        for name in names - known - own:
            if name.replace("-", "_").isidentifier():  # not one of Hydra's expressions, such as glob(*)
                task_path(name)
    return rewritten


def _register_path(name: str) -> str:
    """Make a task that is given by path known to Hydra; returns its name."""
    if not name.endswith((".yaml", ".yml")):
        return name
    path = Path(name)
    _store(path.stem, path)
    _task_files[path.stem] = path
    return path.stem


def _store(name: str, path: Path) -> None:
    ConfigStore.instance().store(group="task", name=name, node=OmegaConf.create(read_yaml(path)))


def _config_dirs(arguments: list[str]) -> list[Path]:
    """What ``--config-dir`` names."""
    found = [Path(a.partition("=")[2]) for a in arguments if a.startswith("--config-dir=")]
    return found + [Path(b) for a, b in itertools.pairwise(arguments) if a in ("--config-dir", "-cd")]


def _fail(error: Exception) -> None:
    print(f"ogmp-train: {error.args[0] if error.args else error}", file=sys.stderr)
    raise SystemExit(2) from None


def main() -> None:
    """Entry point."""
    arguments = sys.argv[1:]
    try:
        if any(argument.startswith("resume=") for argument in arguments):
            _resume(arguments)
            return
        arguments = _register_tasks(arguments)
    except (ValueError, KeyError, TypeError) as error:
        _fail(error)
    # Hydra wants its options before the overrides; people write them anywhere.
    sys.argv[1:] = sorted(arguments, key=lambda a: "=" in a and not a.startswith("-"))
    _hydra_main()


if __name__ == "__main__":
    main()
