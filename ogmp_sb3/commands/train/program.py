"""``ogmp-train``: train one policy for a task, or a sweep of them (``-m``), or go on with a run (``resume=``)."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.encoder_warning import encoder_warning, warn_once
from ogmp_sb3.commands.train.command_line import TASK_KEYS, checked, joined, run_hydra, sentence
from ogmp_sb3.commands.train.composition import given_bare
from ogmp_sb3.commands.train.search import check_one_task, expanded, register_sweeper
from ogmp_sb3.commands.train.tasks import register_tasks, registered_data, task_file
from ogmp_sb3.commands.train.usage import usage
from ogmp_sb3.config.catalogue import shown_path
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where, did_you_mean
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.yaml_files import apply_overrides, read_value
from ogmp_sb3.runs.run_directory import CONFIG, FAILURE, RESUMABLE, checkpoint_dirs, run_config
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.runs.training import Job, begin_or_go_on, train

PROGRAM = "ogmp-train"


def _plain(config: Any) -> Any:
    """Plain data, in which ``${...}`` stays text, as in a task file."""
    return OmegaConf.to_container(config)


def _task_of(plain: dict[str, Any], overrides: list[str]) -> tuple[TaskConfig, dict[str, Any]]:
    """The task of a composed configuration, with its keys that were given without ``task.`` put in."""
    path = task_file(HydraConfig.get().runtime.choices["task"])
    data = apply_overrides(plain["task"], given_bare(plain, overrides), shown_path(path))
    robot = str(data.get("robot", ""))
    if robot.endswith((".yaml", ".yml")):
        data["robot"] = str((path.parent / robot).resolve())
    return task_from_data(data, path), data


@hydra.main(version_base="1.3", config_path="pkg://ogmp_sb3.conf", config_name="train")
def _hydra_main(cfg: DictConfig) -> float:
    run_dir = Path(HydraConfig.get().runtime.output_dir)
    try:
        plain, overrides = _plain(cfg), _plain(HydraConfig.get().overrides.task)
        task, task_data = _task_of(plain, overrides)
        values = {k: v for k, v in plain.items() if k not in ("task", *TASK_KEYS)}
        config = read(TrainConfig, values, Where(PROGRAM))
        warning = encoder_warning(task, task_data, task_file(HydraConfig.get().runtime.choices["task"]))
        if warning:
            warn_once(warning)
        job = Job(task=task, task_data=task_data, config=config, run_dir=run_dir, overrides=tuple(overrides))
        return begin_or_go_on(job)
    except OmegaConfBaseException as error:  # e.g. of ${...}, which is resolved when it is read
        return _failed(run_dir, ValueError(sentence(error)))
    except cli.MISTAKES as error:
        return _failed(run_dir, error)


def _failed(run_dir: Path, error: Exception) -> float:
    """End a run with a sentence; in a multirun leave it to the end, for the other jobs go on.

    :return: no number
    """
    if HydraConfig.get().mode != RunMode.MULTIRUN:
        cli.fail(PROGRAM, error)
    (run_dir / FAILURE).write_text(cli.one_line(PROGRAM, error), encoding="utf-8")
    return math.nan


def _resume(arguments: list[str]) -> None:
    """``ogmp-train resume=<run dir> [total_timesteps=...]``: everything else is as it was."""
    changes = dict(argument.partition("=")[::2] for argument in arguments)
    run_dir = Path(changes.pop("resume"))
    data = run_config(run_dir)
    for key, value in changes.items():
        if key not in RESUMABLE:
            raise KeyError(f"'{key}' cannot change when a run is resumed{did_you_mean(key, RESUMABLE)}")
        data["train"][key] = read_value(value)
    task = task_from_data(data["task"], Path(data["task_file"]))
    config = read(TrainConfig, data["train"], Where(str(run_dir / CONFIG), "train"))
    resume = bool(checkpoint_dirs(run_dir))
    if not resume:
        print("there is no checkpoint yet: beginning anew")
    train(Job(task=task, task_data=data["task"], config=config, run_dir=run_dir), resume)


def _train(arguments: list[str]) -> None:
    """Run Hydra with a command line."""
    register_sweeper()
    arguments, names = register_tasks(expanded(joined(arguments)))
    check_one_task(arguments, names)
    sys.argv[1:] = checked(arguments, registered_data(names))
    run_hydra(_hydra_main)


def _body(arguments: list[str]) -> None:
    resume = any(argument.startswith("resume=") for argument in arguments)
    (_resume if resume else _train)(arguments)


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, usage, _body)


if __name__ == "__main__":
    main()
