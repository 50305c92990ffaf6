"""Task files as plain data: a file may extend another and then says only what differs.

``extends: parkour`` names a task, or a file by a path that starts from the directory of the file which says so. What is
checked, shown and stored is the merged data, without ``extends``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ogmp_sb3.config.catalogue import find, is_path, shown_path
from ogmp_sb3.config.messages import Where, located
from ogmp_sb3.config.strict import check_keys, null_leaves_out, read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.yaml_files import WHOLE, read_yaml, resolved

EXTENDS = "extends"
KEYS = (EXTENDS, *(field.name for field in dataclasses.fields(TaskConfig) if not field.metadata.get("internal")))
"""The keys that a task file can have."""
File = tuple[Path, dict[str, Any]]
"""A task file, and what it says but for ``extends``."""


def read_task(path: Path) -> dict[str, Any]:
    """Read a task file and those that it extends as plain data. Raises as :func:`with_extended`."""
    return with_extended(read_yaml(path), path)


def with_extended(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """What a task file says together with what it extends.

    A relative path of a robot starts from the directory of the file that says it.

    :param data: as read from ``path``
    :raises KeyError: for an unknown key at the top of one of the files, and an unknown task
    :raises TypeError: if ``extends`` is no text
    :raises ValueError: if one of the files cannot be read, or extends itself
    """
    if EXTENDS not in data:
        return data
    files = _files(data, path)
    result: dict[str, Any] = {}
    for _, own in reversed(files):
        result = merged(result, own)
    file, own = next((file for file in files if "robot" in file[1]), files[0])
    robot = own.get("robot")
    if file is not path and isinstance(robot, str):
        robot = resolved({"robot": robot}, Where(shown_path(file)), own)["robot"]
        result["robot"] = str((file.parent / robot).absolute()) if is_path(str(robot)) else robot
    return result


def extended_files(path: Path) -> list[Path]:
    """The files that a task file extends, the nearest first; none if it cannot be read, as when a run is older."""
    try:
        if EXTENDS not in path.read_text(encoding="utf-8"):  # which spares the time that reading YAML takes
            return []
        return [file for file, _ in _files(read_yaml(path), path)[1:]]
    except (OSError, KeyError, TypeError, ValueError):
        return []


def merged(extended: Mapping[str, Any], own: Mapping[str, Any], place: tuple[str, ...] = ()) -> dict[str, Any]:
    """What a file says over what it extends: mappings merge, and everything else replaces what was there.

    A mapping at a key of :data:`~ogmp_sb3.config.yaml_files.WHOLE` replaces it too. Null stays where null is a value,
    and takes out what was there where it is none.

    :param place: the keys of the mapping that both are, from the top of the task
    """
    result = dict(extended)
    for name, value in own.items():
        held = result.get(name)
        if isinstance(value, dict) and isinstance(held, dict) and (place or name not in WHOLE):
            result[name] = merged(held, value, (*place, name))
        elif value is None and name in result and null_leaves_out(TaskConfig, (*place, name)):
            del result[name]
        else:
            result[name] = value
    return result


def _files(data: dict[str, Any], path: Path) -> list[File]:
    """A task file and those that it extends, the nearest first."""
    files: list[File] = []
    while True:
        where = Where(shown_path(path))
        check_keys(data, KEYS, where)
        files.append((path, {key: value for key, value in data.items() if key != EXTENDS}))
        if EXTENDS not in data:
            return files
        name = read(str, data[EXTENDS], where / EXTENDS)
        with located(where / EXTENDS):
            path = find("task", name, path.parent)
        seen = [file.resolve() for file, _ in files]
        if path.resolve() in seen:
            circle = [shown_path(file) for file, _ in files[seen.index(path.resolve()) :]]
            raise ValueError(f"{where / EXTENDS} leads back to the same file: {' -> '.join([*circle, circle[0]])}.")
        data = read_yaml(path)
