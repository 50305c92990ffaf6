"""The tasks that a command line of ``ogmp-train`` names, made known to Hydra under the names of their files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.plugins.config_source import ConfigLoadError
from omegaconf import OmegaConf

from ogmp_sb3.commands.train.command_line import quoted, read_by_hydra
from ogmp_sb3.config import catalogue
from ogmp_sb3.config.task_files import read_task

SUFFIXES = (".yaml", ".yml")


def register_tasks(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Make tasks known to Hydra: shipped ones, those given by path, and those of plug-ins if one may be meant.

    :return: the arguments, with names for paths; and the names of the tasks
    :raises KeyError: for a task that is nowhere
    :raises ValueError: if two tasks have one name, or a file cannot be read
    """
    rewritten: list[str] = []
    by_path, names = set[str](), list[str]()
    for argument in arguments:
        if argument.startswith("task="):
            texts = _split(argument.removeprefix("task="))
            names = [_name(text) for text in texts]
            _check_different(names, texts)
            by_path.update(_store(Path(text)) for text in texts if text.endswith(SUFFIXES))
            argument = f"task={','.join(_as_hydra_reads(name) if name in by_path else name for name in names)}"
        rewritten.append(argument)
    _register_by_name(set(names), by_path, arguments)
    return rewritten, names


def _split(value: str) -> list[str]:
    """The tasks that a value names; a comma in the path of a file separates nothing."""
    pieces, tasks = value.split(","), []
    while pieces:
        joined = (n for n in range(len(pieces), 1, -1) if _is_task_file(",".join(pieces[:n])))
        count = next(joined, 1)
        tasks.append(",".join(pieces[:count]))
        pieces = pieces[count:]
    return tasks


def _is_task_file(text: str) -> bool:
    return text.endswith(SUFFIXES) and catalogue.is_file(Path(text))


def _name(text: str) -> str:
    return Path(text).stem if text.endswith(SUFFIXES) else text


def _as_hydra_reads(name: str) -> str:
    """A name as a value of Hydra's, in quotes if it would be read as anything else."""
    override = read_by_hydra(f"task={name}")
    return name if override is not None and override.value() == name else quoted(name)


def _check_different(names: list[str], texts: list[str]) -> None:
    """:raises ValueError: if two tasks have one name, which Hydra tells tasks apart by."""
    for i, name in enumerate(names):
        first = names.index(name)
        if texts[first] != texts[i]:
            raise ValueError(f"'{texts[first]}' and '{texts[i]}' are both called '{name}': rename one of the files.")


def _store(path: Path) -> str:
    """Make a task known to Hydra, also in the processes that a launcher starts; its provider is the file."""
    node = OmegaConf.create(read_task(path))
    ConfigStore.instance().store(group="task", name=path.stem, node=node, provider=str(path))
    return path.stem


def _register_by_name(names: set[str], by_path: set[str], arguments: list[str]) -> None:
    """:raises KeyError: for a task that is neither given by path, nor in a directory of the user's, nor known"""
    known = {path.stem for path in catalogue.TASKS_DIR.glob("*.yaml")}
    own = {path.stem for folder in _config_dirs(arguments) for path in folder.glob("task/*.yaml")} | by_path
    if not names or not names <= known | own:
        known.update(catalogue.names("task"))
    for name in known - own:  # a user's file of the same name counts
        _store(catalogue.find("task", name))
    if not any(argument.startswith("hydra.searchpath=") for argument in arguments):
        for name in names - known - own:
            if not name or name.replace("-", "_").isidentifier():  # not one of Hydra's expressions, such as glob(*)
                catalogue.find("task", name)


def _config_dirs(arguments: list[str]) -> list[Path]:
    """What ``--config-dir`` names."""
    option = "--config-dir="
    return [Path(argument.removeprefix(option)) for argument in arguments if argument.startswith(option)]


def registered_data(names: Iterable[str]) -> list[dict[str, Any]]:
    """The data of tasks as they were registered; nothing for one that Hydra has yet to find."""
    return [_registered(name) for name in names]


def _registered(name: str) -> dict[str, Any]:
    try:
        return OmegaConf.to_container(ConfigStore.instance().load(f"task/{name}.yaml").node)  # type: ignore[return-value]
    except ConfigLoadError:
        return {}


def task_file(name: str) -> Path:
    """Where Hydra found a task: the user's directory, or the file that was registered."""
    for source in HydraConfig.get().runtime.config_sources:
        path = Path(source.path) / "task" / f"{name}.yaml"
        if source.schema == "file" and path.is_file():
            return path
    try:
        return Path(str(ConfigStore.instance().load(f"task/{name}.yaml").provider))
    except ConfigLoadError:  # of a source that is no directory
        return Path(f"{name}.yaml")
