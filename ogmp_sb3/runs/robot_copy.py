"""The robot of a training travels with it: its files lie in the run, and in the policy too if they are small.

What a run and its policies record of it (:class:`RobotRecord`) tells whether a copy is whole, and whether the robot
that was copied has changed since.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ogmp_sb3.config.catalogue import find, is_file
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.config.robot_files import ROBOT_FILE, robot_files
from ogmp_sb3.config.strict import read
from ogmp_sb3.env.robot_digest import robot_changes, robot_digest, same_model
from ogmp_sb3.runs.atomic import fresh, put_in_place, remove
from ogmp_sb3.runs.storage import checksum

ROBOT = "robot"  # directory of the copy; and the key of its record in config.yaml and policy.json
SMALL = 2**20  # bytes of a robot that every policy has a copy of; a larger one is in its run alone
SHOWN = 4  # changes that a sentence names


@dataclass(frozen=True, kw_only=True)
class RobotRecord:
    """What is known of the robot that a policy was trained on."""

    digest: str
    """of what it is in a simulation (:func:`~ogmp_sb3.env.robot_digest.robot_digest`)"""
    files: dict[str, str]
    """SHA-256 of each file of its copy, by name; empty if it could not be copied"""
    beside: str | None
    """where the robot.yaml was, from the run directory; None for a robot that has a name"""


def read_record(data: dict[str, Any], where: Where) -> RobotRecord | None:
    """The record in a ``config.yaml`` or ``policy.json``; None if it is older than records are.

    :raises TypeError: if it is none
    """
    return read(RobotRecord | None, data.get(ROBOT), where / ROBOT)  # type: ignore[arg-type]


def keep_robot(robot: RobotConfig, name: str, run_dir: Path) -> tuple[RobotConfig, RobotRecord]:
    """Copy a robot into a run directory. One whose copy would be another model is left where it is, with a warning.

    :param name: by which the task names it: a name or a path
    :return: the copy, or the robot itself; and its record
    :raises OSError: if a file cannot be read or written
    """
    folder, files = run_dir / ROBOT, robot_files(robot)
    temporary = fresh(folder)
    for file, content in files.items():
        (temporary / file).parent.mkdir(exist_ok=True)
        (temporary / file).write_bytes(content)
    is_path = name.endswith((".yaml", ".yml")) or "/" in name
    beside = os.path.relpath(robot.path.resolve(), run_dir.resolve()) if is_path else None
    record = RobotRecord(digest=robot_digest(robot), files=_sums(files), beside=beside)
    if not _is_copy(robot, temporary):
        remove(temporary)
        warnings.warn(f"{robot.path}: cannot be copied; the run needs it where it is.", stacklevel=2)
        return robot, RobotRecord(digest=record.digest, files={}, beside=beside)
    put_in_place(temporary, folder)
    return load_robot(str(folder / ROBOT_FILE)), record


def _is_copy(robot: RobotConfig, folder: Path) -> bool:
    copy = load_robot(str(folder / ROBOT_FILE))
    try:
        return same_model(robot.mjcf_path, copy.mjcf_path)
    except ValueError:
        return False


def copy_small(source: Path, folder: Path) -> None:
    """Copy the directory of a robot, unless it is large.

    :param source: the directory
    :param folder: of a policy
    :raises OSError: if it cannot be written
    """
    if sum(file.stat().st_size for file in source.rglob("*")) <= SMALL:
        shutil.copytree(source, folder / ROBOT)


def own_robot(record: RobotRecord | None, *folders: Path | None) -> Path | None:
    """The ``robot.yaml`` of the first copy that is whole; None if there is no copy.

    :param folders: that may have one: a run, a policy
    :raises ValueError: if there are copies and none is whole, naming a file that is not as it was
    """
    changed = []
    for copy in (folder / ROBOT for folder in folders if folder is not None):
        if record is None or not record.files or not copy.is_dir():
            continue
        wrong = [name for name, sum_ in record.files.items() if _sum_of(copy / name) != sum_]
        if not wrong:
            return (copy / ROBOT_FILE).absolute()
        changed.append(copy / wrong[0])
    if changed:
        raise ValueError(
            f"{changed[0]}: changed or missing, so this copy is not the robot of the training. Put the file back, or "
            "evaluate with another robot: robot=<its robot.yaml>."
        )
    return None


def original(name: str, task_file: Path, record: RobotRecord | None, run: Path | None) -> Path | None:
    """Where the robot of a training was taken from, also after its project has moved; None if it is not there now.

    :param name: by which the task names it: a name or a path
    :param task_file: which a path starts from
    :param run: the run directory
    """
    if run is not None and record is not None and record.beside is not None and is_file(run / record.beside):
        return Path(os.path.normpath(run.absolute() / record.beside))
    try:
        return find("robot", name, task_file.parent).absolute()
    except (KeyError, ValueError):
        return None


def task_robot(
    name: str, task_file: Path, record: RobotRecord | None, run: Path | None, policy: Path | None = None
) -> Path:
    """The ``robot.yaml`` of a training: its copy, or the file that the task names.

    :param run: the run directory; None: the policy is alone
    :param policy: its directory, which may have a copy too
    :raises ValueError: if there is neither, or a copy that is not whole
    """
    place = own_robot(record, run, policy) or original(name, task_file, record, run)
    if place is not None:
        return place
    try:
        return find("robot", name, task_file.parent)
    except (KeyError, ValueError) as error:
        raise ValueError(
            f"'robot': {error.args[0]} There is no copy of it: give it with robot=<its robot.yaml>."
        ) from None


def changes(record: RobotRecord, now: RobotConfig, own: RobotConfig | None) -> str:
    """What has changed in a robot since a training, in words; nothing if it simulates as it did.

    :param now: the robot as it is now
    :param own: the copy of the training, if there is one
    """
    try:
        sums = _sums(robot_files(now))
        files = [name for name in {**record.files, **sums} if sums.get(name) != record.files.get(name)]
        if not files or robot_digest(now) == record.digest:
            return ""
        parts = robot_changes(own, now) if own is not None else ["files"]
    except (ValueError, OSError) as error:
        return f"it cannot be read: {' '.join(str(error).split())}"
    more = f" and {len(parts) - SHOWN} more" if len(parts) > SHOWN else ""
    return f"{', '.join(parts[:SHOWN])}{more}; in {', '.join(files)}" if parts else ""


def warn_of_changes(
    used: RobotConfig, place: Path | None, record: RobotRecord | None, instead: str, stacklevel: int = 3
) -> None:
    """Tell if the robot that a run was begun with is another one now.

    :param used: the robot that is used
    :param place: of the other: where it was taken from
    :param instead: what to do to have the new one, or what happens
    """
    if place is None or record is None:
        return
    is_copy = used.path.resolve() != place.resolve()
    try:
        now = load_robot(str(place.absolute()))
        changed = changes(record, now, used if is_copy else None)
    except (KeyError, TypeError, ValueError) as error:
        changed = f"it cannot be read: {error.args[0]}"
    if changed:
        what = f"the run's own copy is used{instead}" if is_copy else "there is no copy, so the new one is used"
        warnings.warn(f"{place}: changed since the training ({changed}); {what}.", stacklevel=stacklevel)


def _sums(files: dict[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}


def _sum_of(file: Path) -> str | None:
    return checksum(file) if is_file(file) else None
