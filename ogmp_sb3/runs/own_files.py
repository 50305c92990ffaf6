"""The robot and the encoder of a training lie in its run: made at the start, used whenever it goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.config.robot_files import ROBOT_FILE
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.latent import changed_file, copy_encoder, encoder_dir
from ogmp_sb3.runs.robot_copy import (
    ROBOT,
    RobotRecord,
    changes,
    keep_robot,
    original,
    own_robot,
    read_record,
    task_robot,
    warn_of_changes,
)
from ogmp_sb3.runs.run_directory import CONFIG, ENCODER, INFO, checkpoint_info, entry, run_config


def run_robot(run_dir: Path, data: dict[str, Any]) -> Path:
    """The ``robot.yaml`` that a run goes on with: its copy, or where the robot is.

    :param data: of its ``config.yaml``
    :raises ValueError: if there is neither, or the copy is not that of the training
    """
    file = str(run_dir / CONFIG)
    try:
        name, record = entry(data["task"], "robot", str, Where(file, "task")), read_record(data, Where(file))
        return task_robot(name, Path(data["task_file"]), record, run_dir)
    except (KeyError, TypeError, ValueError) as error:
        reason = str(error.args[0])
        raise ValueError(reason if reason.startswith(str(run_dir)) else f"{file}: {reason}") from None


def check_same_files(task: TaskConfig, run_dir: Path, record: RobotRecord | None) -> None:
    """Compare the robot and the encoder of a task with those that a run has of it.

    :param record: of the run's robot
    :raises ValueError: if one has changed since the run was begun
    """
    what = _changed_robot(task.robot_config, run_dir, record) or _changed_encoder(task, run_dir)
    if what:
        raise ValueError(
            f"{run_dir / CONFIG}: holds another run: {what}. Choose another directory, or remove that one, or go on "
            f"with what it was begun with: ogmp-train resume={run_dir}"
        )


def _changed_robot(robot: RobotConfig, run_dir: Path, record: RobotRecord | None) -> str:
    if record is None:
        return ""
    own = own_robot(record, run_dir)
    changed = changes(record, robot, None if own is None else load_robot(str(own)))
    return f"{robot.path} has changed since ({changed})" if changed else ""


def _changed_encoder(task: TaskConfig, run_dir: Path) -> str:
    if not (task.uses_latent and task.encoder and (run_dir / ENCODER).is_dir()):
        return ""
    folder = encoder_dir(task.encoder)
    name = changed_file(run_dir / ENCODER, folder)
    return f"{folder / name} has changed since" if name else ""


def with_own_files(
    task: TaskConfig, robot: str, run_dir: Path, checkpoint: Path | None
) -> tuple[TaskConfig, RobotRecord]:
    """The task with the run's copies of its robot and its encoder, which are made at the start of a run.

    :param robot: by which the task's data name the robot
    :param checkpoint: that the run goes on from; None: it begins
    :return: the task, and the record of the robot
    :raises ValueError: if a copy is not that of the checkpoint, whose checksums hold
    :raises OSError: if a copy cannot be made
    """
    config, record = _own_robot(task, robot, run_dir, checkpoint)
    return replace(_with_own_encoder(task, run_dir, checkpoint), robot_config=config), record


def _own_robot(task: TaskConfig, name: str, run_dir: Path, checkpoint: Path | None) -> tuple[RobotConfig, RobotRecord]:
    """The run's copy of its robot, and its record. A run that is older than such copies gets one when it goes on."""
    robot, own = task.robot_config, run_dir / ROBOT / ROBOT_FILE
    if checkpoint is not None:
        record = read_record(checkpoint_info(checkpoint), Where(str(checkpoint / INFO)))
    elif robot.path.absolute() == own.absolute():  # it was stopped before its first checkpoint
        record = read_record(run_config(run_dir), Where(str(run_dir / CONFIG)))
    else:
        record = None
    if record is None:
        return keep_robot(robot, name, run_dir)
    if own_robot(record, run_dir) is None:
        if changed := changes(record, robot, None):
            raise ValueError(f"{robot.path}: changed since the training ({changed}), and {own} is missing.")
        return keep_robot(robot, name, run_dir)
    copy = load_robot(str(own))
    warn_of_changes(copy, original(name, Path(task.file), record, run_dir), record, "")
    return copy, record


def _with_own_encoder(task: TaskConfig, run_dir: Path, checkpoint: Path | None) -> TaskConfig:
    """The task with the run's copy of its encoder."""
    if not (task.uses_latent and task.encoder):
        return task
    own = run_dir / ENCODER
    if checkpoint is None:
        copy_encoder(task.encoder, own)
    elif name := changed_file(checkpoint / ENCODER, own):
        saved = checkpoint / ENCODER / name
        raise ValueError(f"{own / name}: not the file that the run was trained with, which is {saved}.")
    return replace(task, encoder=str(own))
