"""``ogmp-train``: train one policy for a task, or a sweep of them (``-m``), or go on with a run (``resume=``)."""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.plugins.config_source import ConfigLoadError
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.train.command_line import REPLACES_TASK, checked, run_hydra, sentence
from ogmp_sb3.config import catalogue
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where, did_you_mean
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.yaml_files import read_value, read_yaml
from ogmp_sb3.runs.run_directory import CONFIG, FAILURE, RESUMABLE, checkpoint_dirs, run_config
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.runs.training import Job, begin_or_go_on, train

PROGRAM = "ogmp-train"


def _task_of(cfg: DictConfig) -> tuple[TaskConfig, dict[str, Any]]:
    """The task of a composed configuration, with the bare rho, oracle and horizon put in."""
    name = HydraConfig.get().runtime.choices["task"]
    path = _task_file(name)
    plain = OmegaConf.to_container(cfg)  # ${...} stays text, as in a task file
    assert isinstance(plain, dict)
    data = plain["task"]
    data |= {key: plain[key] for key in REPLACES_TASK if not OmegaConf.is_missing(cfg, key)}
    robot = str(data.get("robot", ""))
    if robot.endswith((".yaml", ".yml")):
        data["robot"] = str((path.parent / robot).resolve())
    return task_from_data(data, path), data


def _task_file(name: str) -> Path:
    """Where Hydra found a task: the user's directory, or the file that was registered."""
    for source in HydraConfig.get().runtime.config_sources:
        path = Path(source.path) / "task" / f"{name}.yaml"
        if source.schema == "file" and path.is_file():
            return path
    try:
        return Path(str(ConfigStore.instance().load(f"task/{name}.yaml").provider))
    except ConfigLoadError:  # of a source that is no directory
        return Path(f"{name}.yaml")


@hydra.main(version_base="1.3", config_path="pkg://ogmp_sb3.conf", config_name="train")
def _hydra_main(cfg: DictConfig) -> float:
    run_dir = Path(HydraConfig.get().runtime.output_dir)
    try:
        task, task_data = _task_of(cfg)
        plain = OmegaConf.to_container(cfg, throw_on_missing=False)
        assert isinstance(plain, dict)
        values = {k: v for k, v in plain.items() if k not in ("task", *REPLACES_TASK)}
        config = read(TrainConfig, values, Where(PROGRAM))
        overrides = tuple(HydraConfig.get().overrides.task)
        return begin_or_go_on(Job(task=task, task_data=task_data, config=config, run_dir=run_dir, overrides=overrides))
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
    given = dict(argument.partition("=")[::2] for argument in arguments)
    run_dir = Path(given.pop("resume"))
    data = run_config(run_dir)
    for key, value in given.items():
        if key not in RESUMABLE:
            raise KeyError(f"'{key}' cannot change when a run is resumed{did_you_mean(key, RESUMABLE)}")
        data["train"][key] = read_value(value)
    task = task_from_data(data["task"], Path(data["task_file"]))
    config = read(TrainConfig, data["train"], Where(str(run_dir / CONFIG), "train"))
    resume = bool(checkpoint_dirs(run_dir))
    if not resume:
        print("there is no checkpoint yet: beginning anew")
    train(Job(task=task, task_data=data["task"], config=config, run_dir=run_dir), resume)


def _register_tasks(arguments: list[str]) -> list[str]:
    """Make tasks known to Hydra: shipped ones, those given by path, and those of plug-ins if one may be meant.

    :return: the arguments, with names for paths
    :raises KeyError: for a task that is nowhere
    """
    rewritten, names = [], set()
    by_path: set[str] = set()
    for argument in arguments:
        key, sign, value = argument.partition("=")
        if key == "task" and sign:
            given = [_register_path(name) for name in value.split(",")]
            _check_different(given, value.split(","))
            argument = f"task={','.join(given)}"
            names.update(given)
            by_path.update(set(given) - set(value.split(",")))
        rewritten.append(argument)
    known = {path.stem for path in catalogue.TASKS_DIR.glob("*.yaml")}
    own = {path.stem for folder in _config_dirs(arguments) for path in folder.glob("task/*.yaml")} | by_path
    all_listed = not names or bool({"--help", "-h"} & set(arguments))
    if all_listed or not names <= known | own:
        known.update(catalogue.names("task"))
    for name in known - own:  # a user's file of the same name counts
        _store(name, catalogue.find("task", name))
    if not any(argument.startswith("hydra.searchpath=") for argument in arguments):
        for name in names - known - own:
            if not name or name.replace("-", "_").isidentifier():  # not one of Hydra's expressions, such as glob(*)
                catalogue.find("task", name)
    return rewritten


def _registered(name: str) -> dict[str, Any]:
    """The data of a task as it was registered; nothing for one that Hydra has yet to find."""
    try:
        return OmegaConf.to_container(ConfigStore.instance().load(f"task/{name}.yaml").node)  # type: ignore[return-value]
    except ConfigLoadError:
        return {}


def _check_different(names: list[str], given: list[str]) -> None:
    """:raises ValueError: if two tasks have one name, which Hydra tells tasks apart by."""
    for i, name in enumerate(names):
        first = names.index(name)
        if given[first] != given[i]:
            raise ValueError(f"'{given[first]}' and '{given[i]}' are both called '{name}': rename one of the files.")


def _register_path(name: str) -> str:
    """Make a task that is given by path known to Hydra; returns its name."""
    if not name.endswith((".yaml", ".yml")):
        return name
    path = Path(name)
    _store(path.stem, path)
    return path.stem


def _store(name: str, path: Path) -> None:
    """Make a task known to Hydra, also in the processes that a launcher starts; its provider is the file."""
    node = OmegaConf.create(read_yaml(path))
    ConfigStore.instance().store(group="task", name=name, node=node, provider=str(path))


def _config_dirs(arguments: list[str]) -> list[Path]:
    """What ``--config-dir`` names."""
    found = [Path(a.partition("=")[2]) for a in arguments if a.startswith("--config-dir=")]
    return found + [Path(b) for a, b in itertools.pairwise(arguments) if a in ("--config-dir", "-cd")]


def _run(arguments: list[str]) -> None:
    """Run Hydra with a command line."""
    arguments = _register_tasks(arguments)
    names = [name for a in arguments if a.startswith("task=") for name in a.removeprefix("task=").split(",")]
    sys.argv[1:] = checked(arguments, [_registered(name) for name in names])
    run_hydra(_hydra_main)


def main() -> None:
    """Entry point."""
    arguments = sys.argv[1:]
    searches = [argument.removeprefix("+search=") for argument in arguments if argument.startswith("+search=")]
    try:
        if any(argument.startswith("resume=") for argument in arguments):
            _resume(arguments)
        elif searches:
            from ogmp_sb3.commands.train.search import (
                search,  # brings evaluation and its plots, which a training does without
            )

            rest = [a for a in arguments if a not in ("-m", "--multirun") and not a.startswith("+search=")]
            search(searches[-1], rest, _run)
        else:
            if {"--help", "-h"} & set(arguments) and not any(argument.startswith("task=") for argument in arguments):
                arguments.append("task=parkour")  # Hydra shows no help before the task is known
            _run(arguments)
    except cli.MISTAKES as error:
        cli.fail(PROGRAM, error)
    except KeyboardInterrupt:  # a second Ctrl-C, or one before the training began
        raise SystemExit(130) from None


if __name__ == "__main__":
    main()
