"""Run directories of ``ogmp-train``: settings, progress and checkpoints, read from disk."""

from __future__ import annotations

import hashlib
import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf
from tqdm import tqdm

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import UNREADABLE, read_yaml
from ogmp_sb3.runs.atomic import occupied, tidy
from ogmp_sb3.runs.failed_steps import FOLDER as UNSTABLE
from ogmp_sb3.runs.logs import STEP_COLUMN, read_rows
from ogmp_sb3.runs.robot_copy import ROBOT
from ogmp_sb3.runs.storage import load_json

BEST = "best"  # in a run directory: the best policy so far
CONFIG = "config.yaml"  # in a run directory: the task, the run, the versions
MULTIRUN = "multirun.yaml"  # in the directory of a multirun
# What may change when a run goes on.
RESUMABLE = (
    *("total_timesteps", "checkpoint_interval", "keep_checkpoints"),
    *("torch_threads", "physics_threads", "device", "logger", "videos"),
)
FAILURE = "failure.txt"  # in the directory of a job that failed: why
RETURN = "episode/return"  # column of the log: mean over the episodes since the row before
ELAPSED = "time/time_elapsed"  # column of the log: s since the training began, or went on
LOG, OVERRIDES = "progress.csv", ".hydra/overrides.yaml"
TRACKERS = "trackers.json"  # in a run directory: which run it is in each tracker
CHECKPOINTS = "checkpoints"  # in a run directory: a directory for each, named by its samples
WEIGHTS, INFO = "policy.safetensors", "policy.json"
TRAINER = ("trainer.safetensors", "trainer.json")
ENCODER = "encoder"  # directory beside the weights: the encoder a policy was trained with

FINISHED, RUNNING, STOPPED, FAILED = "finished", "running", "stopped", "failed"
LAST_ROWS = 5  # rows of progress.csv that a final value is the mean of


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
    """finished: all samples; running: a process trains there; failed: ended by a mistake, or before its first
    checkpoint; stopped: has a checkpoint to go on from; missing: was never started, or has gone; damaged: has a file
    that cannot be read"""
    problem: str = ""
    """a sentence on why it is damaged, or failed"""

    @property
    def samples(self) -> int:
        """Samples so far, by the log and the checkpoints."""
        return _samples(self.path, self.log)

    @property
    def seconds(self) -> float:
        """How long it has trained, s, pauses left out: by the log, without what was trained again after a stop."""
        elapsed = self.log.get(ELAPSED, np.zeros(0))
        elapsed = elapsed[np.isfinite(elapsed)]
        step = np.diff(elapsed, prepend=0.0)
        return float(np.where(step < 0, elapsed, step).sum())

    @property
    def command(self) -> str:
        """What was typed, as a shell reads it."""
        return shlex.join(["ogmp-train", *self.overrides])

    @property
    def fingerprint(self) -> str:
        """Identifies a training: all of its settings but those that may change when it is resumed."""
        train = {key: value for key, value in self.config.get("train", {}).items() if key not in RESUMABLE}
        task, record = self.config.get("task"), self.config.get(ROBOT)
        if task and record:  # which tells robots apart, wherever they lie
            task = {**task, "robot": record.get("digest")}
        data = json.dumps([task, train, self.config.get("versions")], sort_keys=True)
        return hashlib.sha256(data.encode()).hexdigest()[:16]

    def final(self, column: str) -> float:
        """Mean of the last rows of a column of the log, nan if there is none."""
        values = self.log.get(column, np.array([]))[-LAST_ROWS:]
        values = values[np.isfinite(values)]
        return float(values.mean()) if len(values) else float("nan")


def samples_text(samples: int) -> str:
    """A number of samples as people say it: 512, 30.0k, 16.0M."""
    return str(samples) if samples < 1000 else str(tqdm.format_sizeof(samples))


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
        overrides = read_overrides(path / OVERRIDES)
    log = read_log(path / LOG) if (path / LOG).is_file() else {}
    problem = (path / FAILURE).read_text("utf-8", "replace") if (path / FAILURE).is_file() else ""
    total = config.get("train", {}).get("total_timesteps")
    return Run(path, overrides, config, log, run_state(path, total, _samples(path, log)), problem)


def read_log(path: Path) -> dict[str, np.ndarray]:
    """Read a ``progress.csv``.

    :raises ValueError: if it holds anything but numbers
    """
    rows = read_rows(path)
    return {key: np.array([float(row[key] or "nan") for row in rows]) for key in (rows[0] if rows else ())}


def read_overrides(path: Path) -> tuple[str, ...]:
    """What Hydra has kept of a command line; nothing if it kept none."""
    if not path.is_file():
        return ()
    try:
        data = OmegaConf.to_container(OmegaConf.load(path))  # unresolved: only text
        return read(tuple[str, ...], data, Where(str(path)))
    except UNREADABLE as error:
        raise ValueError(f"{path}: not readable as a list of overrides ({' '.join(str(error).split())}).") from None


def _samples(path: Path, log: dict[str, np.ndarray]) -> int:
    return samples_so_far(path, float(log[STEP_COLUMN][-1]) if log else 0.0)


def samples_so_far(path: Path, logged: float) -> int:
    """Samples of a run so far.

    :param logged: those of the last row of its log
    """
    return max([int(logged), *(int(folder.name) for folder in checkpoint_dirs(path))])


def run_state(path: Path, total: int | None, samples: int) -> str:
    """The state of a run whose files can be read, as :attr:`Run.state` has it.

    :param total: samples of the whole run; None: it was not begun
    :param samples: so far
    """
    if total is not None and samples >= total:
        return FINISHED
    if occupied(path):
        return RUNNING
    return FAILED if (path / FAILURE).is_file() or not checkpoint_dirs(path) else STOPPED


def entry(data: dict[str, Any], key: str, kind: Any, where: Where) -> Any:
    """A value of plain data, checked.

    :raises ValueError: if it is missing or not of the kind
    """
    if key not in data:
        raise ValueError(f"{where / key} is missing.")
    try:
        return read(kind, data[key], where / key)
    except TypeError as error:
        raise ValueError(str(error)) from None


def tidy_run(run_dir: Path) -> None:
    """Clean up a run directory after a kill or a full disk."""
    for folder, names in (
        (run_dir, BEST),
        (run_dir, CONFIG),
        (run_dir, TRACKERS),
        (run_dir, ROBOT),
        (run_dir / CHECKPOINTS, "*"),
        (run_dir / UNSTABLE, "*"),
    ):
        tidy(folder, names)


def run_config(run_dir: Path) -> dict[str, Any]:
    """The ``config.yaml`` of a run: its task, the file that came from, and its settings.

    :raises ValueError: if it is damaged or missing
    """
    file = run_dir / CONFIG
    data, where = read_yaml(file), Where(str(file))
    for key, kind in {"task": dict[str, Any], "task_file": str, "train": dict[str, Any]}.items():
        entry(data, key, kind, where)
    return data


def checkpoint_dirs(run_dir: Path) -> list[Path]:
    """All checkpoints of a run, oldest first."""
    folders = (run_dir / CHECKPOINTS).glob("[0-9]*")
    return sorted(p for p in folders if p.name.isdecimal() and (p / INFO).is_file())


def checkpoint_info(folder: Path) -> dict[str, Any]:
    """What the ``policy.json`` of a checkpoint says: the task, the samples, the mean return, the versions.

    :raises ValueError: if it is damaged or missing
    """
    return load_json(folder / INFO)
