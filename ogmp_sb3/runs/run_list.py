"""A list of runs: what one line each can tell, read from as little of their files as will do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.yaml_files import read_yaml_quickly
from ogmp_sb3.runs.logs import STEP_COLUMN, last_rows
from ogmp_sb3.runs.multirun import DAMAGED, plain_key
from ogmp_sb3.runs.run_directory import (
    CONFIG,
    FAILED,
    FAILURE,
    LAST_ROWS,
    LOG,
    OVERRIDES,
    RETURN,
    entry,
    run_state,
    samples_so_far,
)
from ogmp_sb3.runs.run_folders import RunFolder


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """One line about a run."""

    folder: RunFolder
    """where it is"""
    state: str
    """as :attr:`~ogmp_sb3.runs.run_directory.Run.state` has it"""
    overrides: tuple[str, ...] = ()
    """its command line, ``key=value``"""
    task: str = ""
    """the name of its task; empty if it is not known"""
    rho: float | str | None = None
    """its permissible-state bound, as it was typed if it was not begun; None: it has none"""
    samples: int = 0
    """so far"""
    total: int | None = None
    """samples of the whole run; None: it was not begun"""
    returned: float = float("nan")
    """mean return in the last rows of its log; nan before the first one"""
    problem: str = ""
    """a sentence on why it is damaged, or failed"""


def summarise(folder: RunFolder) -> RunSummary:
    """Summarise a run in whatever state it is; one with a file that cannot be read is damaged."""
    try:
        return _summary(folder)
    except (ValueError, OSError) as error:
        return RunSummary(folder=folder, state=DAMAGED, problem=" ".join(str(error).split()))


def _summary(folder: RunFolder) -> RunSummary:
    """:raises ValueError: if a file cannot be read."""
    path = folder.path
    config, where = read_yaml_quickly(path / CONFIG, dict), Where(str(path / CONFIG))
    if "overrides" in config:
        overrides = entry(config, "overrides", tuple[str, ...], where)
    else:
        kept = {"overrides": read_yaml_quickly(path / OVERRIDES, list)}
        overrides = entry(kept, "overrides", tuple[str, ...], Where(str(path / OVERRIDES)))
    typed = {plain_key(key): value for key, _, value in (text.partition("=") for text in overrides)}
    rows = last_rows(path / LOG) if (path / LOG).exists() else []
    samples = samples_so_far(path, float(rows[-1][STEP_COLUMN]) if rows else 0.0)
    name, rho, total = typed.get("task", ""), typed.get("rho"), None
    if config:
        task, train = (entry(config, key, dict[str, Any], where) for key in ("task", "train"))
        name = entry({"task_file": name, **config}, "task_file", str, where)
        rho = entry({"rho": None, **task}, "rho", float | None, where / "task")
        total = entry(train, "total_timesteps", int, where / "train")
    state = run_state(path, total, samples)
    problem = (path / FAILURE).read_text("utf-8", "replace") if state == FAILED and (path / FAILURE).exists() else ""
    return RunSummary(
        folder=folder,
        state=state,
        overrides=overrides,
        task=Path(name).stem,
        rho=rho,
        samples=samples,
        total=total,
        returned=_mean_return(rows),
        problem=" ".join(problem.split()),
    )


def _mean_return(rows: list[dict[str, str]]) -> float:
    """As :meth:`~ogmp_sb3.runs.run_directory.Run.final` has it."""
    values = np.array([float(row.get(RETURN) or "nan") for row in rows[-LAST_ROWS:]])
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else float("nan")
