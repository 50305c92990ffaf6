"""Files of control steps in which a simulation failed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.events import Events
from ogmp_sb3.env.failed_step import UnstableStep
from ogmp_sb3.runs.atomic import replacing
from ogmp_sb3.runs.robot_copy import own_robot, read_record

FOLDER = "unstable"  # in a run directory
MOST = 20  # files in it
FORMAT = 3
KEY = "ogmp"  # of the plain data in a file
VARIED = "varied."  # in front of the names of what was varied


def save_step(step: UnstableStep, path: Path, **info: Any) -> None:
    """Write a step.

    :param info: plain data to add; ``task`` and ``task_file``, without which it cannot be replayed, among it
    :raises OSError: if the file cannot be written
    """
    arrays = {"state": step.state, "terrain": step.terrain, "action": step.action}
    for name, events in (("targets", step.targets), ("kicks", step.kicks)):
        arrays |= {name: events.values, f"{name}_at": events.at}
    arrays |= {VARIED + name: values for name, values in step.varied.items()}
    plain = {"format": FORMAT, **step.info, "substeps": step.substeps, **info}
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        file.write_bytes(save(arrays, {KEY: json.dumps(plain)}))


def load_step(path: Path) -> tuple[UnstableStep, TaskConfig]:
    """Read what :func:`save_step` wrote, with its task.

    :raises ValueError: if the file is damaged or missing
    """
    try:
        with safe_open(path, "numpy") as file:
            plain = json.loads((file.metadata() or {})[KEY])
            arrays = {name: file.get_tensor(name) for name in file.keys()}
        where = Where(str(path))
        if read(int, plain["format"], where / "format") != FORMAT:
            raise ValueError(f"format {plain['format']}, expected {FORMAT}")
        task_data = read(dict[str, Any], plain["task"], where / "task")
        task_file = Path(read(str, plain["task_file"], where / "task_file"))
        own = own_robot(read_record(plain, where), path.parent.parent)
        task = task_from_data(task_data if own is None else {**task_data, "robot": str(own)}, task_file)
        read(dict[str, str], plain.get("versions", {}), where / "versions")
        return UnstableStep(
            state=arrays["state"],
            terrain=arrays["terrain"],
            action=arrays["action"],
            targets=_events(arrays, "targets"),
            kicks=_events(arrays, "kicks"),
            varied={name.removeprefix(VARIED): values for name, values in arrays.items() if name.startswith(VARIED)},
            substeps=read(int, plain["substeps"], where / "substeps"),
            info=plain,
        ), task
    except (OSError, ValueError, KeyError, TypeError, RecursionError, SafetensorError) as error:
        raise ValueError(f"{path}: not readable as a step that failed ({' '.join(str(error).split())}).") from None


def _events(arrays: dict[str, np.ndarray], name: str) -> Events:
    at = arrays[f"{name}_at"]
    return Events(at, np.zeros(len(at), dtype=int), arrays[name])
