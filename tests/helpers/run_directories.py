"""Run directories as trainings leave them, written in no time."""

from __future__ import annotations

import csv
from pathlib import Path

import yaml

from ogmp_sb3.runs.logs import STEP_COLUMN


def write_log(path: Path, steps: list[int], **columns: list[float | str]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([STEP_COLUMN, *(name.replace("__", "/") for name in columns)])
        writer.writerows(zip(steps, *columns.values(), strict=True))


def make_run(
    path: Path, overrides: list[str], total: int = 1000, steps: int = 0, checkpoint: int = 0, config: bool = True
) -> Path:
    """A run directory as ogmp-train leaves it."""
    (path / ".hydra").mkdir(parents=True)
    (path / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(overrides))
    if config:
        task = {"rho": 0.5, "oracle": "preview", "action": {"scale": 2.0}}
        data = {"task": task, "train": {"seed": 0, "total_timesteps": total}}
        (path / "config.yaml").write_text(yaml.safe_dump(data))
    if steps:
        rows = list(range(100, steps + 1, 100))
        write_log(path / "progress.csv", rows, episode__return=[float(row) for row in rows])
    if checkpoint:
        folder = path / "checkpoints" / f"{checkpoint:012d}"
        folder.mkdir(parents=True)
        (folder / "policy.json").write_text("{}")
    return path
