"""Before a training starts: is the command line right, and which directory is its own?

Hydra makes directories before it hands over. So what is wrong is found here, where it has made none, and a directory
that is named after the time is one that no other start has, also in the same second.
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.train.command_line import PROGRAM, quoted, sentence
from ogmp_sb3.commands.train.jobs import plain, read_job
from ogmp_sb3.runs.atomic import occupied
from ogmp_sb3.runs.multirun import SWEEPERS
from ogmp_sb3.runs.run_directory import CONFIG, FAILURE

BY_TIME = "${now:"  # in the name of a directory
MANY = "for several tasks give a directory too: hydra.sweep.dir=<directory>."


class Start(Callback):
    """Checks a command line and makes its directory. Hydra calls it (``hydra.callbacks``)."""

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """:raises SystemExit: with a sentence, if the job is not right"""
        with _or_a_sentence(), _current(config) as copied:
            read_job(copied, Path())
            folder = Path(str(copied.hydra.run.dir))
            config.hydra.run.dir = str(_own(folder, _is_new(config, "run")))

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """:raises SystemExit: with a sentence, if none of the jobs is right"""
        with _or_a_sentence(), _current(config) as copied:
            _check_jobs(copied)
            try:
                folder = Path(str(copied.hydra.sweep.dir))
            except OmegaConfBaseException:  # the directory of a ready sweep is named after its task
                raise ValueError(MANY) from None
            if _is_new(config, "sweep"):
                config.hydra.sweep.dir = str(_own(folder, new=True))
                config.hydra.overrides.hydra.append(f"hydra.sweep.dir={quoted(config.hydra.sweep.dir)}")  # for the jobs
            else:
                _own(folder, new=False)


@contextmanager
def _or_a_sentence() -> Iterator[None]:
    """End the program where Hydra would make a warning of what a callback raises."""
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        cli.fail(PROGRAM, ValueError(sentence(error)))
    except cli.MISTAKES as error:
        cli.fail(PROGRAM, error)


@contextmanager
def _current(config: DictConfig) -> Iterator[DictConfig]:
    """A copy of a configuration as Hydra's present one, which ``${hydra:...}`` refers to."""
    before = HydraConfig.instance().cfg
    copied = copy.deepcopy(config)
    HydraConfig.instance().set_config(copied)
    try:
        yield copied
    finally:
        HydraConfig.instance().cfg = before


def _check_jobs(config: DictConfig) -> None:
    """Check the jobs of a multirun until one is right; what the others have is told when that one has trained.

    :raises ValueError: what the first has, if none is right
    """
    first: Exception | None = None
    for number, overrides in enumerate(_jobs(config)):
        found = mistake(config, overrides, number)
        if found is None:
            return
        first = first or found
    if first is not None:
        raise first


def mistake(config: DictConfig, overrides: list[str], number: int = 0) -> Exception | None:
    """What is wrong with a job of a multirun, None if nothing is.

    :param config: of the multirun
    :param overrides: the command line of the job
    :param number: of the job
    """
    try:
        job = GlobalHydra.instance().config_loader().load_sweep_config(config, overrides)
        with open_dict(job.hydra.job):
            job.hydra.job.num, job.hydra.job.id = number, str(number)
        with _current(job) as current:
            read_job(current, Path())
    except (HydraException, OmegaConfBaseException, *cli.MISTAKES) as error:
        return error
    return None


def _jobs(config: DictConfig) -> list[list[str]]:
    """The command lines of the jobs of a multirun; none if a sweeper chooses them as it goes."""
    sweeper = config.hydra.sweeper
    if not str(sweeper._target_).endswith(SWEEPERS):
        return []
    params = [f"{key}={value}" for key, value in (plain(sweeper).get("params") or {}).items()]
    parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
    overrides = parser.parse_overrides([*params, *plain(config.hydra.overrides.task)])
    (jobs,) = BasicSweeper.split_arguments(overrides, None)
    return jobs


def _is_new(config: DictConfig, mode: str) -> bool:
    """Whether the directory is named after the time by default; who names one decides by himself."""
    text = str(plain(config.hydra[mode])["dir"])
    typed = (override.partition("=")[0].lstrip("+") for override in plain(config.hydra.overrides.hydra))
    return BY_TIME in text and f"hydra.{mode}.dir" not in typed


_made: list[Path] = []  # the directories that were not there when this start began, the innermost first


def _own(folder: Path, new: bool) -> Path:
    """The directory of a run or a multirun, made if it is to be new: then with a number if another start has it."""
    for number in itertools.count(1):
        own = folder if number == 1 else folder.with_name(f"{folder.name}_{number:02}")
        missing = [path.absolute() for path in (own, *own.parents) if not path.exists()]
        if new:
            try:
                own.mkdir(parents=True)
            except FileExistsError:
                continue
        _made[:] = missing
        return own
    raise AssertionError("there is always another number")


def remove_unused() -> None:
    """Remove the directories that this start has made, if nothing came of it."""
    for folder in _made[:1]:
        files = [*folder.rglob(CONFIG), *folder.rglob(FAILURE)]
        begun = any(file.parent.name != ".hydra" for file in files)  # Hydra keeps what was typed there
        if not begun and not occupied(folder):
            shutil.rmtree(folder, ignore_errors=True)
    for folder in _made:
        with contextlib.suppress(OSError):  # another start may be within
            folder.rmdir()
    _made.clear()
