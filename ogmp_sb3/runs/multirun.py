"""Multirun directories, as ``ogmp-train -m`` leaves them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.yaml_files import read_yaml_quickly
from ogmp_sb3.runs.robot_copy import ROBOT
from ogmp_sb3.runs.run_directory import CONFIG, MULTIRUN, OVERRIDES, RESUMABLE, Run, entry, read_overrides, read_run
from ogmp_sb3.runs.run_folders import run_folders

SEED, DESCRIPTION = "seed", "description"  # keys: of a training; of a task, and no setting
MISSING, DAMAGED = "missing", "damaged"
SWEEPERS = (BasicSweeper.__name__, "HalvingSweeper")  # whose command line says which jobs there are


def read_sweep(path: Path, asked: bool = False) -> list[Run]:
    """Read the jobs of a multirun directory; those that the command line asked for and that are not there come too.

    A job with a file that cannot be read is one of them, with the reason.

    :param asked: leave out those that another command line asked for, where that is known
    :raises ValueError: if it holds no job
    """
    jobs = [_read_job(folder) for folder in _job_folders(path)]
    wanted = {_identity(job): job for job in wanted_jobs(path / MULTIRUN)} if (path / MULTIRUN).is_file() else {}
    present = {_identity(job.overrides) for job in jobs}
    if asked and wanted:
        jobs = [job for job in jobs if _identity(job.overrides) in wanted]
    jobs += [Run(path / "-", wanted[job], {}, {}, MISSING) for job in wanted if job not in present]
    if not jobs:
        raise ValueError(f"{path}: holds no job of a multirun (a directory with {CONFIG}).")
    order = {job: i for i, job in enumerate(wanted)}
    return sorted(jobs, key=lambda job: order.get(_identity(job.overrides), len(order)))


def count_missing(sweep: Path, jobs: Iterable[tuple[str, ...]]) -> int:
    """How many jobs a multirun asked for that are not there (yet).

    :param sweep: its directory
    :param jobs: the command lines of those that are
    :raises ValueError: if its file cannot be read
    """
    return len({_identity(job) for job in wanted_jobs(sweep / MULTIRUN)} - {_identity(job) for job in jobs})


def read_runs(paths: list[Path]) -> list[Run]:
    """Read runs to compare, each once.

    :param paths: run directories, and directories of several
    :raises ValueError: if one is missing, or holds no run
    """
    found: list[Run] = []
    for path in paths:
        if not path.is_dir():
            raise ValueError(f"'{path}': no such directory.")
        found += [_read_job(path)] if (path / CONFIG).is_file() else read_sweep(path)
    return list({(run.path.resolve(), run.overrides): run for run in found}.values())


def _read_job(path: Path) -> Run:
    """A run directory, without what is in it if a file of it cannot be read."""
    try:
        return read_run(path)
    except ValueError as error:
        try:
            overrides = read_overrides(path / OVERRIDES)
        except ValueError:
            overrides = ()
        return Run(path, overrides, {}, {}, DAMAGED, str(error))


def _job_folders(path: Path) -> list[Path]:
    """Directories of jobs, at any depth: a value with a slash makes one within another. Multiruns within are left."""
    return [run.path for run in run_folders(path) if run.sweep in (None, path)]


def _identity(overrides: tuple[str, ...]) -> frozenset[str]:
    """What tells a job from the others: its command line without what may change when it goes on."""
    pairs = (override.partition("=") for override in overrides)
    return frozenset(f"{plain_key(key)}{sign}{value}" for key, sign, value in pairs if plain_key(key) not in RESUMABLE)


def setting(job: Run, key: str) -> Any:
    """The value of a key of a job's command line; one that is not there is looked up in its ``config.yaml``."""
    typed = [override for override in job.overrides if plain_key(override.partition("=")[0]) == key]
    if typed and "${" not in typed[-1]:  # its value is in config.yaml
        short = [override for override in typed if "task." not in override.partition("=")[0]]  # it is the one used
        return OverridesParser.create().parse_override((short or typed)[-1]).value()
    for part in ("task", "train"):
        node = job.config.get(part)
        for name in key.split("."):
            node = node.get(name) if isinstance(node, dict) else None
        if node is not None:
            return node
    return None


def swept_keys(jobs: list[Run]) -> list[str]:
    """The keys in which jobs differ, but for what may change when they go on.

    They are those of the command lines, and behind them others in which jobs differ that these do not tell apart: of a
    task file that was edited between two trainings, say.
    """
    names = dict.fromkeys(plain_key(override.partition("=")[0]) for job in jobs for override in job.overrides)
    typed = [key for key in names if key not in RESUMABLE and len({str(setting(job, key)) for job in jobs}) > 1]
    alike: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for job in jobs:
        if job.config:
            values = tuple(str(setting(job, key)) for key in typed if key != SEED)
            alike.setdefault(values, []).append(_settings(job))
    hidden = dict.fromkeys(
        key for settings in alike.values() for key in _differing(settings) if key not in typed
    )  # fmt: skip
    return [*typed, *hidden]


def _settings(job: Run) -> dict[str, str]:
    """All settings of a training, by key, as text; a robot by what it is, wherever it lies."""
    task, train = job.config.get("task", {}), job.config.get("train", {})
    digest = job.config.get(ROBOT, {}).get("digest")
    settings = _leaves({**task, **({ROBOT: digest} if digest else {})}) | _leaves(train)
    return {key: value for key, value in settings.items() if key not in RESUMABLE and key != DESCRIPTION}


def _leaves(data: dict[str, Any], above: str = "") -> dict[str, str]:
    """The values of nested mappings by dotted key; null is as if it were not there."""
    found: dict[str, str] = {}
    for key, value in data.items():
        if isinstance(value, dict) and value:
            found |= _leaves(value, f"{above}{key}.")
        elif value is not None:
            found[f"{above}{key}"] = str(value)
    return found


def _differing(settings: list[dict[str, str]]) -> list[str]:
    keys = dict.fromkeys(key for each in settings for key in each)
    return [key for key in keys if len({each.get(key) for each in settings}) > 1]


def wanted_jobs(path: Path) -> list[tuple[str, ...]]:
    """The command lines of all jobs that a multirun asked for; none if a sweeper chose them as it went.

    :param path: its ``multirun.yaml``
    :raises ValueError: if it cannot be read
    """
    hydra = entry({"hydra": {}, **read_yaml_quickly(path, dict)}, "hydra", dict[str, Any], Where(str(path)))
    sweeper = hydra.get("sweeper", {})
    if not str(sweeper.get("_target_", "")).endswith(SWEEPERS):
        return []
    params = [f"{key}={value}" for key, value in (sweeper.get("params") or {}).items()]
    overrides = [*params, *hydra.get("overrides", {}).get("task", [])]
    try:
        (jobs,) = BasicSweeper.split_arguments(OverridesParser.create().parse_overrides(overrides), None)
    except HydraException:  # glob(*), for one, needs the configuration that was searched
        return []
    return [tuple(job) for job in jobs]


def plain_key(key: str) -> str:
    """The name of a setting, which ``task.rho``, ``+rho`` and ``rho`` all mean."""
    return key.lstrip("+~").removeprefix("task.")
