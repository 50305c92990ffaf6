"""What is shared of a policy: its weights, its task, its encoder and its robot, complete in one directory."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from ogmp_sb3.config.catalogue import shipped
from ogmp_sb3.config.messages import Where
from ogmp_sb3.guidance.latent import copy_encoder
from ogmp_sb3.runs.hub import REPLAY, TRAINING
from ogmp_sb3.runs.policies import LoadedPolicy, load_policy
from ogmp_sb3.runs.robot_copy import ROBOT, own_robot, read_record
from ogmp_sb3.runs.run_directory import CONFIG, ENCODER, INFO, WEIGHTS
from ogmp_sb3.runs.storage import load_json, write_manifest


def write_policy(loaded: LoadedPolicy, training: Path | None, folder: Path) -> None:
    """Copy a policy, and check that the copy is the same policy wherever it is loaded.

    :param training: the ``config.yaml`` of its run, if there is one
    :param folder: an empty directory
    :raises ValueError: if a part of it cannot travel
    """
    for name in (WEIGHTS, INFO):
        shutil.copyfile(loaded.path / name, folder / name)
    if loaded.task.uses_latent and loaded.task.encoder:
        copy_encoder(loaded.task.encoder, folder / ENCODER)
    _copy_robot(loaded, folder)
    write_manifest(folder)
    if training is not None:
        shutil.copyfile(training, folder / TRAINING)
    if load_policy(folder).digest != loaded.digest:
        raise ValueError(f"{loaded.path}: its copy would be another policy; evaluate it, and share what is found then.")


def _copy_robot(loaded: LoadedPolicy, folder: Path) -> None:
    """Copy the robot, unless it is one that ships."""
    file = loaded.path / INFO
    record, name = read_record(load_json(file), Where(str(file))), load_json(file)["task"]["robot"]
    for part in record.files if record is not None else ():
        source = loaded.task.robot_config.path.parent / part
        if source.is_file():
            (folder / ROBOT / part).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, folder / ROBOT / part)
    if own_robot(record, folder) is None and name not in shipped("robot"):
        raise ValueError(f"{loaded.path}: there is no copy of its robot '{name}', without which nobody can load it.")


def training_file(loaded: LoadedPolicy, run: Path | None) -> Path | None:
    """The settings of the training that a policy is from, if they are known.

    :param run: the run directory, if there is one
    """
    places = [loaded.path / TRAINING, *([run / CONFIG] if run is not None else [])]
    return next((place for place in places if place.is_file()), None)


def copy_replay(source: Path, folder: Path) -> list[str]:
    """Copy a video, a picture or a directory of them.

    :return: the names of the files, from ``folder``
    :raises ValueError: if there is none
    """
    files = [source] if source.is_file() else sorted(path for path in source.rglob("*") if path.is_file())
    if not files:
        raise ValueError(f"'replay': '{source}' is neither a file nor a directory of files.")
    names = []
    for file in files:
        target = folder / REPLAY / (file.name if file == source else file.relative_to(source))
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)
        names.append(target.relative_to(folder).as_posix())
    return names


def own_paths(data: Any) -> list[str]:
    """The paths of this machine that plain data names, which everybody will see."""
    if isinstance(data, dict | list):
        values = data.values() if isinstance(data, dict) else data
        return list(dict.fromkeys(path for value in values for path in own_paths(value)))
    return [data] if isinstance(data, str) and data.startswith("/") else []
