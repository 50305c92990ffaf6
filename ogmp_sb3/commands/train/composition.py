"""Keys of the task that are given without ``task.``: a place for each at the top of Hydra's configuration.

Hydra then takes them as they were typed, in sweeps too, and names directories by them.
"""

from __future__ import annotations

import typing
from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf

from ogmp_sb3.commands.train.command_line import TASK_KEYS
from ogmp_sb3.config.task import TaskConfig

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
    found = {key: plain[key] for key in TASK_KEYS if plain.get(key, MISSING) != MISSING}
    return {key: value for key, value in found.items() if value != {} or key in typed}


register_bare_keys()
