"""Run directories and multirun directories, as ``ogmp-train`` leaves them: what was asked for, and how far it got."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf

from ogmp_sb3.checkpoints import checkpoint_dirs
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import UNREADABLE, read_yaml
from ogmp_sb3.failures import FAILURE
from ogmp_sb3.files import occupied
from ogmp_sb3.logs import STEP_COLUMN, read_rows
from ogmp_sb3.saving import CONFIG, entry
from ogmp_sb3.training import RESUMABLE

FINISHED, RUNNING, STOPPED, FAILED = "finished", "running", "stopped", "failed"
MISSING, DAMAGED = "missing", "damaged"
LAST_ROWS = 5  # rows of progress.csv that a final value is the mean of
LOG, OVERRIDES, MULTIRUN = "progress.csv", ".hydra/overrides.yaml", "multirun.yaml"


@dataclass(frozen=True)
class Run:
    """One training on disk, or one that a sweep should have made."""

    path: Path
    """the directory"""
    overrides: tuple[str, ...]
    """its command line, ``key=value``"""
    config: dict[str, Any]
    """``config.yaml``; empty if it was never written"""
    log: dict[str, np.ndarray]
    """``progress.csv`` by column, each of shape (rows,); nan where a cell is empty"""
    state: str
    """finished: all samples; running: a process trains there; stopped: has a checkpoint to go on from; failed: has
    none; missing: was never started, or has gone; damaged: has a file that cannot be read"""
    problem: str = ""
    """a sentence on why it is damaged, or failed"""

    @property
    def samples(self) -> int:
        """Samples so far, by the log and the checkpoints."""
        return _samples(self.path, self.log)

    @property
    def command(self) -> str:
        """What was typed, as a shell reads it."""
        return shlex.join(["ogmp-train", *self.overrides])

    @property
    def fingerprint(self) -> str:
        """What tells a training from every other one; of its settings, all but those that may change on the way."""
        train = {key: value for key, value in self.config.get("train", {}).items() if key not in RESUMABLE}
        data = json.dumps([self.config.get("task"), train, self.config.get("versions")], sort_keys=True)
        return hashlib.sha256(data.encode()).hexdigest()[:16]

    def final(self, column: str) -> float:
        """Mean of the last rows of a column of the log, nan if there is none."""
        values = self.log.get(column, np.array([]))[-LAST_ROWS:]
        values = values[np.isfinite(values)]
        return float(values.mean()) if len(values) else float("nan")

    def setting(self, key: str) -> Any:
        """The value of a key of the command line; one that was not given is looked up in ``config.yaml``."""
        given = [override for override in self.overrides if plain_key(override.partition("=")[0]) == key]
        if given:
            short = [override for override in given if "task." not in override.partition("=")[0]]  # it is the one used
            return OverridesParser.create().parse_override((short or given)[-1]).value()
        for part in ("task", "train"):
            node = self.config.get(part)
            for name in key.split("."):
                node = node.get(name) if isinstance(node, dict) else None
            if node is not None:
                return node
        return None


def owner(run: str) -> Path | None:
    """The run directory that a policy lies in, else its own directory; None for a shipped policy and for a ``.zip``."""
    folder = Path(run).resolve()
    if not folder.is_dir():
        return None
    return next((path for path in (folder, *folder.parents[:2]) if (path / CONFIG).is_file()), folder)


def default_out(run: str, name: str, kind: str) -> Path:
    """Where results go that no directory is named for: not beside a policy that is replaced in time.

    :param run: what the policy was loaded from
    :param name: of the policy
    :param kind: of results: ``evaluation`` or ``report``
    """
    folder = owner(run)
    return Path(kind) / name if folder is None else folder / kind / Path(run).resolve().relative_to(folder)


def read_run(path: Path) -> Run:
    """Read a run directory, in whatever state it is.

    :raises ValueError: if a file in it cannot be read
    """
    config = read_yaml(path / CONFIG) if (path / CONFIG).is_file() else {}
    for key in ("task", "train"):
        if key in config:
            entry(config, key, dict[str, Any], Where(str(path / CONFIG)))
    if "total_timesteps" in config.get("train", {}):
        entry(config["train"], "total_timesteps", int, Where(str(path / CONFIG), "train"))
    if "overrides" in config:
        overrides = entry(config, "overrides", tuple[str, ...], Where(str(path / CONFIG)))
    else:  # not begun; what Hydra keeps is that of the last attempt
        overrides = _read_overrides(path / OVERRIDES)
    log = read_log(path / LOG) if (path / LOG).is_file() else {}
    problem = (path / FAILURE).read_text("utf-8", "replace") if (path / FAILURE).is_file() else ""
    return Run(path, overrides, config, log, _state(path, config, log), problem)


def read_sweep(path: Path, asked: bool = False) -> list[Run]:
    """Read the jobs of a multirun directory; those that the command line asked for and that are not there come too.

    A job with a file that cannot be read is one of them, with the reason.

    :param asked: leave out those that another command line asked for, where that is known
    :raises ValueError: if it holds no job
    """
    jobs = [_read_job(folder) for folder in _job_folders(path)]
    wanted = {_identity(job): job for job in _wanted(path / MULTIRUN)} if (path / MULTIRUN).is_file() else {}
    found = {_identity(job.overrides) for job in jobs}
    if asked and wanted:
        jobs = [job for job in jobs if _identity(job.overrides) in wanted]
    jobs += [Run(path / "-", wanted[job], {}, {}, MISSING) for job in wanted if job not in found]
    if not jobs:
        raise ValueError(f"{path}: holds no job of a multirun (a directory with {CONFIG}).")
    order = {job: i for i, job in enumerate(wanted)}
    return sorted(jobs, key=lambda job: order.get(_identity(job.overrides), len(order)))


def _read_job(path: Path) -> Run:
    """A run directory, without what is in it if a file of it cannot be read."""
    try:
        return read_run(path)
    except ValueError as error:
        try:
            overrides = _read_overrides(path / OVERRIDES)
        except ValueError:
            overrides = ()
        return Run(path, overrides, {}, {}, DAMAGED, str(error))


def _job_folders(path: Path) -> Iterator[Path]:
    """Directories of jobs, at any depth: a value with a slash makes one within another. Multiruns within are left."""
    for folder in sorted(p for p in path.iterdir() if p.is_dir() and not (p / MULTIRUN).is_file()):
        if (folder / CONFIG).is_file() or (folder / OVERRIDES).is_file():
            yield folder
        elif not (folder.is_symlink() or folder.name.startswith(".")):
            yield from _job_folders(folder)


def _identity(overrides: tuple[str, ...]) -> frozenset[str]:
    """What tells a job from the others: its command line without what may change when it goes on."""
    return frozenset(override for override in overrides if plain_key(override.partition("=")[0]) not in RESUMABLE)


def swept_keys(jobs: list[Run]) -> list[str]:
    """The keys of the command line in which jobs differ, but for what may change when they go on."""
    names = dict.fromkeys(plain_key(override.partition("=")[0]) for job in jobs for override in job.overrides)
    return [key for key in names if key not in RESUMABLE and len({str(job.setting(key)) for job in jobs}) > 1]


def read_log(path: Path) -> dict[str, np.ndarray]:
    """Read a ``progress.csv``.

    :raises ValueError: if it holds anything but numbers
    """
    rows = read_rows(path)
    return {key: np.array([float(row[key] or "nan") for row in rows]) for key in (rows[0] if rows else ())}


def _read_overrides(path: Path) -> tuple[str, ...]:
    """What Hydra has kept of a command line; nothing if it kept none."""
    if not path.is_file():
        return ()
    try:
        data = OmegaConf.to_container(OmegaConf.load(path))  # unresolved: only text
        return read(tuple[str, ...], data, Where(str(path)))
    except UNREADABLE as error:
        raise ValueError(f"{path}: not readable as a list of overrides ({' '.join(str(error).split())}).") from None


def _samples(path: Path, log: dict[str, np.ndarray]) -> int:
    logged = int(log[STEP_COLUMN][-1]) if log else 0
    saved = [int(folder.name) for folder in checkpoint_dirs(path)]
    return max([logged, *saved])


def _state(path: Path, config: dict[str, Any], log: dict[str, np.ndarray]) -> str:
    total = config.get("train", {}).get("total_timesteps")
    if total is not None and _samples(path, log) >= total:
        return FINISHED
    if occupied(path):
        return RUNNING
    return STOPPED if checkpoint_dirs(path) else FAILED


def _wanted(path: Path) -> list[tuple[str, ...]]:
    """The command lines of all jobs that a multirun asked for; none if a sweeper chose them as it went."""
    hydra = read_yaml(path).get("hydra", {})
    sweeper = hydra.get("sweeper", {})
    if not str(sweeper.get("_target_", "")).endswith(BasicSweeper.__name__):
        return []
    params = [f"{key}={value}" for key, value in (sweeper.get("params") or {}).items()]
    given = [*params, *hydra.get("overrides", {}).get("task", [])]
    try:
        (jobs,) = BasicSweeper.split_arguments(OverridesParser.create().parse_overrides(given), None)
    except HydraException:  # glob(*), for one, needs the configuration that was searched
        return []
    return [tuple(job) for job in jobs]


def plain_key(key: str) -> str:
    """The name of a setting, which ``task.rho``, ``+rho`` and ``rho`` all mean."""
    return key.lstrip("+~").removeprefix("task.")
