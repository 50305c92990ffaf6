"""What Hydra does not do by itself when it composes a task.

Keys of the task that are given without ``task.`` have a place each at the top of the configuration: Hydra then takes
them as they were typed, in sweeps too, and names directories by them. And where Hydra merges a mapping into the one
that is there, those of :data:`~ogmp_sb3.config.yaml_files.WHOLE` replace it, whether typed or in a file.
"""

from __future__ import annotations

import typing
from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

from hydra._internal import hydra as hydra_internals
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.config_store import ConfigStore
from hydra.core.default_element import ResultDefault
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.plugins.config_source import ConfigResult
from omegaconf import MISSING, DictConfig, OmegaConf

from ogmp_sb3.commands.train.command_line import TASK_KEYS
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.task_files import EXTENDS, with_extended
from ogmp_sb3.config.yaml_files import WHOLE
from ogmp_sb3.runs.multirun import plain_key

NAME = "bare_task_keys"  # in the defaults of conf/train.yaml


def register_bare_keys() -> None:
    """Make the places known to Hydra."""
    hints = typing.get_type_hints(TaskConfig)
    places = {key: _open() if _is_mapping(hints[key]) else MISSING for key in TASK_KEYS}
    ConfigStore.instance().store(name=NAME, node=OmegaConf.create(places), provider="ogmp_sb3")


def _is_mapping(annotation: Any) -> bool:
    kinds = typing.get_args(annotation) if typing.get_origin(annotation) is not dict else (annotation,)
    return any(is_dataclass(kind) or typing.get_origin(kind) is dict for kind in kinds or (annotation,))


def _open() -> DictConfig:
    """A mapping that takes any key."""
    return DictConfig({}, flags={"struct": False})


def given_bare(plain: Mapping[str, Any], overrides: Iterable[str]) -> dict[str, Any]:
    """The keys of the task that a configuration holds at its top.

    :param plain: the composed configuration
    :param overrides: the command line, which tells an empty mapping that was given from none
    """
    typed = {override.partition("=")[0].lstrip("+") for override in overrides}
    here = [key for key in TASK_KEYS if key not in WHOLE]  # those are in the task already, see Composition
    found = {key: plain[key] for key in here if plain.get(key, MISSING) != MISSING}
    return {key: value for key, value in found.items() if value != {} or key in typed}


class Composition(ConfigLoaderImpl):
    """Hydra's composition, after which the task holds the keys of :data:`WHOLE` as they were given last."""

    def _compose_config_from_defaults_list(self, defaults: list[ResultDefault], repo: Any) -> DictConfig:
        """The files one over another: the task, then experiments."""
        given: dict[str, Any] = {}
        for default in defaults:
            if default.config_path != NAME:
                file = OmegaConf.to_container(self._load_single_config(default, repo).config)
                given |= _whole_keys(file) | _whole_keys(file.get("task"))  # type: ignore[union-attr]
        config = super()._compose_config_from_defaults_list(defaults, repo)
        _set_whole(config, given)
        for key in given:  # may get names that it has not
            if isinstance(OmegaConf.select(config, f"task.{key}"), DictConfig):
                OmegaConf.set_struct(config.task[key], False)
        return config

    def _load_single_config(self, default: ResultDefault, repo: Any) -> ConfigResult:
        """One file; a task with what it extends, wherever Hydra found it."""
        loaded = super()._load_single_config(default, repo)
        task = OmegaConf.select(loaded.config, "task", default=None)
        group, _, name = str(default.config_path).partition("/")
        if group == "task" and isinstance(task, DictConfig) and EXTENDS in task:
            folder = Path(loaded.path.removeprefix("file://"))
            data = with_extended(OmegaConf.to_container(task), folder / f"task/{name}.yaml")  # type: ignore[arg-type]
            OmegaConf.update(loaded.config, "task", data, merge=False)
        return loaded

    def _load_configuration_impl(self, *args: Any, **kwargs: Any) -> DictConfig:
        """The command line over the files."""
        config = super()._load_configuration_impl(*args, **kwargs)
        typed = OmegaConf.to_container(config.hydra.overrides.task)  # in which ${...} stays as it is
        overrides = OverridesParser.create().parse_overrides(typed)  # type: ignore[arg-type]
        for override in overrides:
            key, _, name = plain_key(override.key_or_group).partition(".")
            if key not in WHOLE or override.is_sweep_override():
                continue
            if not name:
                _set_whole(config, {key: override.value()})
                continue
            held = OmegaConf.select(config, f"task.{key}")
            mapping = {} if held is None else dict(OmegaConf.to_container(held))  # type: ignore[arg-type]
            mapping.pop(name, None)
            _set_whole(config, {key: mapping if override.is_delete() else {**mapping, name: override.value()}})
        return config


def _whole_keys(node: Any) -> dict[str, Any]:
    return {key: node[key] for key in WHOLE if key in node} if isinstance(node, dict) else {}


def _set_whole(config: DictConfig, values: Mapping[str, Any]) -> None:
    if isinstance(config.get("task"), DictConfig):
        for key, value in values.items():
            OmegaConf.update(config, f"task.{key}", value, merge=False, force_add=True)


def register_composition() -> None:
    """Have Hydra compose as above; launchers take it along to where their jobs run."""
    hydra_internals.ConfigLoaderImpl = Composition  # type: ignore[attr-defined]


register_bare_keys()
