"""A warning where the references of a task leave what its encoder was trained on."""

from __future__ import annotations

import shlex
from functools import cache
from pathlib import Path
from typing import Any

from ogmp_sb3.config.catalogue import find
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.task_files import read_task
from ogmp_sb3.guidance.encoder_scope import REFERENCE_KEYS, leaves, outside
from ogmp_sb3.runs.logs import say


def encoder_warning(task: TaskConfig, data: dict[str, Any], path: Path) -> str | None:
    """What the task's encoder was not trained on, and the command that trains another.

    :param task: the task
    :param data: the same as plain data
    :param path: its file
    :return: a sentence; None if there is nothing to say
    :raises KeyError: if there is no such encoder
    :raises ValueError: if its files are damaged
    """
    what = outside(task)
    if what is None:
        return None
    name = f"my_{task.name}"
    command = ["ogmp-encode", f"task={_typed(path)}", *_changes(data, path), f"out=encoders/{name}"]
    return f"{what}; {shlex.join(command)} trains one for encoder={name}."


@cache
def warn_once(sentence: str) -> None:
    """Say a warning, unless this process has done so already: the jobs of a sweep differ in other things."""
    say(f"Warning: {sentence}")


def _typed(path: Path) -> str:
    """What one types for a task file: its name, if it is found by that."""
    try:
        return path.stem if find("task", path.stem).samefile(path) else str(path)
    except KeyError:
        return str(path)


def _changes(data: dict[str, Any], path: Path) -> list[str]:
    """The keys that references depend on and that are not as in the task file, as one types them."""
    before, now = (dict(leaves({key: each.get(key) for key in REFERENCE_KEYS})) for each in (read_task(path), data))
    return [f"{key}={_value(value)}" for key, value in now.items() if before.get(key) != value]


def _value(value: Any) -> str:
    """A value as one types it."""
    if isinstance(value, list):
        return f"[{','.join(map(_value, value))}]"
    return "null" if value is None else str(value)
