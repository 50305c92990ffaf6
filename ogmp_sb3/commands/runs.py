"""``ogmp-runs``: which trainings there are, how far they are, and what their policies earn."""

from __future__ import annotations

import contextlib
import math
import time
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from ogmp_sb3.commands import cli
from ogmp_sb3.config import catalogue
from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.runs.multirun import count_missing
from ogmp_sb3.runs.run_directory import samples_text
from ogmp_sb3.runs.run_folders import RUNS, newest_first, relative, run_folders, short_names
from ogmp_sb3.runs.run_list import RunSummary, summarise
from ogmp_sb3.runs.storage import save_json

PROGRAM = "ogmp-runs"
HEADER = ("name", "task", "rho", "samples", "return", "state", "age")
RIGHT = (2, 3, 4, 6)  # columns of numbers
UNITS = ((86_400, "d"), (3_600, "h"), (60, "min"), (1, "s"))
INDENT = "  "

Row = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class RunsConfig:
    """Keys of the command line."""

    dir: str = cli.option("directory to list; it may also be given without the key", str(RUNS))
    task: str | None = cli.option("only runs of this task; null: of all", None)
    state: Literal["running", "finished", "stopped", "failed", "damaged"] | None = cli.option(
        "only runs in this state: running, finished, stopped, failed or damaged; null: in any", None
    )
    json: str | None = cli.option("also write the list to this file", None)


HELP = cli.usage(
    PROGRAM,
    "list the runs below a directory, the newest first, and the jobs of each sweep together.",
    [
        "ogmp-runs",
        "ogmp-runs runs/sweeps",
        "ogmp-runs task=parkour state=running",
        "ogmp-runs dir=/data/runs json=runs.json",
    ],
    RunsConfig,
    "",
) + (
    "\n\nsamples: so far / of the whole run; return: mean in the last rows of progress.csv; age: since it was begun or "
    "last resumed.\nfinished: has all samples; running: a process trains there; stopped: can go on (ogmp-train "
    "resume=<name>);\nfailed: by a mistake, or before its first checkpoint; damaged: has a file that cannot be read."
    "\nrun=<name>, run=<part of a name> and run=latest of the other programs mean the runs below runs/."
)


def table(runs: list[RunSummary], root: Path, now: float) -> list[str]:
    """The lines of the list: a header, then runs, and sweeps with their jobs below them.

    :param runs: in the order of the list
    :param root: directory that names start from
    :param now: seconds since 1970
    """
    names = short_names((run.folder for run in runs), root)
    rows: list[Row] = [HEADER]
    together: dict[Path, list[RunSummary]] = {}
    for run in runs:
        together.setdefault(run.folder.sweep or run.folder.path, []).append(run)
    for folder, jobs in together.items():
        indent, above = "", ""
        if jobs[0].folder.sweep is not None:
            indent, above = INDENT, f"{relative(folder, root)}/"
            rows.append((above, *[""] * 4, _states(folder, jobs), ""))
        rows += [_row(indent + names[job.folder.path].removeprefix(above), job, now) for job in jobs]
    widths = [max(len(row[i]) for row in rows if row[i] and not row[0].endswith("/")) for i in range(len(HEADER))]
    widths[0] = max(len(row[0]) for row in rows)
    return ["  ".join(_padded(text, i, widths[i]) for i, text in enumerate(row)).rstrip() for row in rows]


def _padded(text: str, column: int, width: int) -> str:
    return text.rjust(width) if column in RIGHT else text.ljust(width)


def _row(name: str, run: RunSummary, now: float) -> Row:
    rho = "off" if run.rho is None else f"{run.rho:g}" if isinstance(run.rho, float) else run.rho
    known = run.state != "damaged"
    samples = f"{samples_text(run.samples)} / {'?' if run.total is None else samples_text(run.total)}"
    returned = "" if math.isnan(run.returned) else f"{run.returned:.1f}"
    age = short_time(now - run.folder.begun)
    return name, run.task, rho if known else "", samples if known else "", returned, run.state, age


def _states(sweep: Path, jobs: list[RunSummary]) -> str:
    """How many jobs of a sweep are in which state; missing ones too, which were asked for and are not there."""
    states = Counter(job.state for job in jobs)
    with contextlib.suppress(ValueError):  # of a damaged multirun.yaml
        states["missing"] = count_missing(sweep, (job.overrides for job in jobs))
    return f"{len(jobs)} jobs: " + ", ".join(f"{count} {state}" for state, count in states.items() if count)


def short_time(seconds: float) -> str:
    """A time in its largest unit that is there twice: ``90 s``, ``119 min``, ``47 h``, ``12 d``."""
    whole = max(0, int(seconds))
    size, unit = next(((size, unit) for size, unit in UNITS if whole >= 2 * size), UNITS[-1])
    return f"{whole // size} {unit}"


def as_data(run: RunSummary, name: str) -> dict[str, Any]:
    """A run as plain data."""
    return {
        "name": name,
        "path": str(run.folder.path),
        "sweep": None if run.folder.sweep is None else str(run.folder.sweep),
        "task": run.task or None,
        "rho": run.rho,
        "samples": run.samples,
        "total_timesteps": run.total,
        "return": None if math.isnan(run.returned) else run.returned,
        "state": run.state,
        "begun": datetime.fromtimestamp(run.folder.begun, UTC).isoformat(timespec="seconds"),
        "problem": run.problem or None,
    }


def listed(config: RunsConfig) -> list[RunSummary]:
    """The runs that are asked for, the newest first.

    :raises KeyError: for a task that neither a run nor a file has
    :raises ValueError: if there is no such directory
    """
    root = Path(config.dir)
    if not root.is_dir():
        if config.dir == str(RUNS):
            return []
        beside = [path.name for path in root.absolute().parent.glob("*/")] if root.absolute().parent.is_dir() else []
        raise ValueError(f"'{root}': no such directory{did_you_mean(root.name, beside)}")
    runs = [summarise(folder) for folder in newest_first(run_folders(root))]
    tasks = {run.task for run in runs if run.task}
    if config.task is not None and config.task not in {*tasks, *catalogue.names("task")}:
        raise KeyError(f"no run is of a task '{config.task}'{did_you_mean(config.task, tasks)}")
    return [run for run in runs if config.task in (None, run.task) and config.state in (None, run.state)]


def _run(arguments: list[str]) -> None:
    bare = [argument for argument in arguments if "=" not in argument]
    keys = [*(f"dir={argument}" for argument in bare), *(a for a in arguments if a not in bare)]
    config, _ = cli.parse(RunsConfig, keys, PROGRAM)
    runs, root = listed(config), Path(config.dir)
    console = cli.console()
    if config.json is not None:
        names = short_names((run.folder for run in runs), root)
        save_json(Path(config.json), {"runs": [as_data(run, names[run.folder.path]) for run in runs]})
    if not runs:
        of = [f"of task '{config.task}'"] * (config.task is not None) + [f"that is {config.state}"] * bool(config.state)
        console.print(" ".join(["No run", *of, f"below '{config.dir}'."]))
        return
    console.print("\n".join(table(runs, root, time.time())))
    for run in runs:
        if run.problem:
            console.print(f"{run.folder.path}: {run.problem}")


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run, alone=True)


if __name__ == "__main__":
    main()
