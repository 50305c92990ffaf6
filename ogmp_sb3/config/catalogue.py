"""Where tasks and robots are: those that ship, those of plug-ins, and files by their path."""

from __future__ import annotations

from pathlib import Path

from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.config.plugins import broken_plugins, load_plugins

PACKAGE = Path(__file__).parents[1]
TASKS_DIR = PACKAGE / "tasks"
ROBOTS_DIR = PACKAGE / "robots"


def task_path(name_or_path: str | Path) -> Path:
    """Where a task's YAML is.

    :raises ValueError: if there is no such file
    :raises KeyError: if no task of this name ships or is in a plug-in
    """
    text = str(name_or_path)
    if text.endswith((".yaml", ".yml")) or "/" in text:
        path = Path(text)
        if not is_file(path):
            raise ValueError(f"{text}: no such file.")
        return path
    path = TASKS_DIR / f"{text}.yaml"
    if is_file(path):
        return path
    tasks = _task_files()
    if text not in tasks:
        known = did_you_mean(text, tasks)
        raise KeyError(f"unknown task {text!r}{known} Or give the path of a YAML file.{broken_plugins()}")
    return tasks[text]


def task_names() -> list[str]:
    """The tasks that ship, and those of plug-ins."""
    return sorted(_task_files())


def _task_files() -> dict[str, Path]:
    return {path.stem: path for path in files("tasks/*.yaml")}


def files(pattern: str) -> list[Path]:
    """Files that ship or that plug-ins bring."""
    folders = [PACKAGE, *(plugin.folder for plugin in load_plugins() if plugin.folder)]
    return [path for folder in folders for path in sorted(folder.glob(pattern))]


def is_file(path: Path) -> bool:
    """Whether there is such a file; not if its name is too long for one."""
    try:
        return path.is_file()
    except OSError:
        return False


def shown_path(path: Path) -> str:
    """A path as a message shows it: shipped files by their short name."""
    try:
        return str(path.resolve().relative_to(PACKAGE.resolve().parent))
    except ValueError:
        return str(path)
