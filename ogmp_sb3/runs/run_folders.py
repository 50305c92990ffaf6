"""Where runs lie: the run directories below a folder, the sweep that each is a job of, and when it was begun."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ogmp_sb3.config.catalogue import is_file
from ogmp_sb3.runs.run_directory import CONFIG, MULTIRUN, OVERRIDES

RUNS = Path("runs")  # where ogmp-train makes run directories


@dataclass(frozen=True)
class RunFolder:
    """A run directory that was found."""

    path: Path
    """the directory"""
    sweep: Path | None
    """the multirun that it is a job of, if it is"""

    @property
    def begun(self) -> float:
        """When it was begun or last resumed, in seconds since 1970: ``config.yaml`` is written then."""
        for file in (self.path / CONFIG, self.path / OVERRIDES):
            try:
                return file.stat().st_mtime
            except OSError:
                continue
        return 0.0


def run_folders(folder: Path, sweep: Path | None = None) -> Iterator[RunFolder]:
    """The run directories of a folder, at any depth, in the order of their names; that folder itself, if it is one.

    Hidden folders, and those that cannot be read, are passed over; of links to folders those to a run are followed.

    :param sweep: a multirun around the folder
    """
    if is_run(folder):
        yield RunFolder(folder, sweep or _sweep_around(folder))
        return
    sweep = folder if (folder / MULTIRUN).is_file() else sweep
    for inner in _entries(folder):
        if not inner.name.startswith(".") and inner.is_dir() and (is_run(inner) or not inner.is_symlink()):
            yield from run_folders(inner, sweep)


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def is_run(folder: Path) -> bool:
    """Whether a directory is that of a run, begun or not."""
    return is_file(folder / CONFIG) or is_file(folder / OVERRIDES)


def _sweep_around(run: Path) -> Path | None:
    """The multirun that a run directory lies in."""
    return next((above for above in run.absolute().parents if (above / MULTIRUN).is_file()), None)


def newest_first(folders: Iterable[RunFolder]) -> list[RunFolder]:
    """Runs by when they were begun; those of the same time by name, the last one first."""
    return sorted(folders, key=lambda run: (run.begun, run.path), reverse=True)


def name_elements(name: str) -> list[str]:
    """What a name is put together of: directories, and the settings in the name of a sweep's job."""
    return re.split("[/,]", name)


def short_names(runs: Iterable[RunFolder], root: Path) -> dict[Path, str]:
    """Names of runs, by directory: what comes below a root, of a sweep's job only the settings that not all jobs have.

    ``run=`` takes them (:mod:`~ogmp_sb3.runs.run_names`), if the root is that of its names.

    :param root: directory that names start from
    """
    jobs: dict[Path, list[Path]] = {}
    names: dict[Path, str] = {}
    for run in runs:
        names[run.path] = relative(run.path, root)
        if run.sweep is not None:
            jobs.setdefault(run.sweep, []).append(run.path)
    for sweep, paths in jobs.items():
        elements = {path: name_elements(relative(path, sweep)) for path in paths}
        shared = set.intersection(*map(set, elements.values())) if len(paths) > 1 else set()
        short = {path: ",".join(e for e in elements[path] if e not in shared) for path in paths}
        if len(set(short.values())) == len(paths) and all(short.values()):
            names.update({path: f"{relative(sweep, root)}/{short[path]}" for path in paths})
    return names


def relative(path: Path, root: Path) -> str:
    """A path as seen from a directory, if it is below it."""
    absolute, above = Path(os.path.abspath(path)), Path(os.path.abspath(root))
    return absolute.relative_to(above).as_posix() if absolute.is_relative_to(above) else str(path)
