"""The job that a composed configuration of Hydra's describes: its task, its settings, its directory."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.encoder_warning import encoder_warning, warn_once
from ogmp_sb3.commands.train.command_line import PROGRAM, TASK_KEYS
from ogmp_sb3.commands.train.composition import given_bare
from ogmp_sb3.commands.train.tasks import task_file
from ogmp_sb3.config.catalogue import shown_path
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.yaml_files import apply_overrides, resolved
from ogmp_sb3.guidance.latent import encoder_dir
from ogmp_sb3.rendering.opengl import gl_library
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.runs.trackers import check_installed
from ogmp_sb3.runs.training import Job


def read_job(config: DictConfig, run_dir: Path) -> Job:
    """Check a composed configuration. Paths start where the command was started, also with ``hydra.job.chdir``.

    :param config: with or without Hydra's own part, which is that of :class:`hydra.core.hydra_config.HydraConfig`
    :param run_dir: where it trains
    :raises KeyError: for an unknown or missing name
    :raises TypeError: for a value of the wrong type
    :raises ValueError: for a value that is out of range, a file that cannot be read, and ``${...}`` without a value
    """
    with _where_it_was_started():
        return _read_job(config, plain(HydraConfig.get().overrides.task), run_dir)


def check_films(settings: TrainConfig) -> None:
    """Check that a training can be filmed here, if it is to be.

    :raises ValueError: naming the extra, or saying that nothing can be drawn
    """
    if settings.videos is not None:
        cli.require("viewer", "PIL", "imageio_ffmpeg")
        try:
            gl_library()
        except ValueError as error:
            raise ValueError(f"'videos': {error}") from None


def warn_of_encoder(job: Job) -> None:
    """Say where the references of a job's task leave what its encoder was trained on; once for all jobs of a sweep."""
    with _where_it_was_started():
        path = task_file(HydraConfig.get().runtime.choices["task"])
        if warning := encoder_warning(job.task, job.task_data, path):
            warn_once(warning)


def _where_it_was_started() -> contextlib.AbstractContextManager[None]:
    hydra = HydraConfig.get()
    return contextlib.chdir(hydra.runtime.cwd) if hydra.job.chdir else contextlib.nullcontext()


def plain(config: Any) -> Any:
    """Plain data, in which ``${...}`` stays text, as in a task file."""
    return OmegaConf.to_container(config)


def _read_job(config: DictConfig, overrides: list[str], run_dir: Path) -> Job:
    path = task_file(HydraConfig.get().runtime.choices["task"])
    values, data = _values(plain(config), overrides, path)
    robot = str(data.get("robot", ""))
    if robot.endswith((".yaml", ".yml")):
        data["robot"] = str((path.parent / robot).resolve())
    task = _with_encoder(task_from_data(data, path))
    settings = read(TrainConfig, values, Where(PROGRAM))
    check_films(settings)
    check_installed(settings.trackers)
    return Job(task=task, task_data=data, config=settings, run_dir=run_dir, overrides=tuple(overrides))


def _values(composed: dict[str, Any], overrides: list[str], path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The settings of the training and the data of its task, which may refer to one another by ``${...}``.

    :param path: of the task
    """
    settings = {key: value for key, value in composed.items() if key not in ("task", "hydra", *TASK_KEYS)}
    data = apply_overrides(composed["task"], given_bare(composed, overrides), shown_path(path))
    names = {**settings, **data, "task": data}  # no setting has the name of a key of the task
    return resolved(settings, Where(PROGRAM), names), resolved(data, Where(shown_path(path)), names)


def _with_encoder(task: TaskConfig) -> TaskConfig:
    """The task with the whole path of its encoder, if there is one; a run that goes on has its own."""
    if not (task.uses_latent and task.encoder):
        return task
    try:
        return replace(task, encoder=str(encoder_dir(task.encoder).absolute()))
    except KeyError:
        return task
