"""Files by name or path: tasks, scenes, robots, encoders and policies, shipped, of plug-ins, or a user's own."""

from __future__ import annotations

import difflib
from pathlib import Path

from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.config.plugins import FILES, SHIPPED, broken_plugins, load_plugins

PACKAGE = SHIPPED
TASKS_DIR = PACKAGE / "tasks"
ROBOTS_DIR = PACKAGE / "robots"
WRITTEN_HERE = ("encoder", "robot", "task")  # kinds that programs write where they run, and that are found there
UNKNOWN = {
    "task": "unknown task {name!r}{known} Or give the path of a YAML file.",
    "scene": "unknown scene {name!r}{known} Or give the path of a YAML file.",
    "robot": "unknown robot {name!r}{known}",
    "encoder": "no encoder {name!r}{known} ogmp-encode trains one.",
    "policy": "{name!r} is neither a run directory nor a shipped policy{known}",
}


def find(kind: str, name_or_path: str | Path, relative_to: Path = Path()) -> Path:
    """The file of a task, scene, robot, encoder or policy.

    :param kind: ``"task"``, ``"scene"``, ``"robot"``, ``"encoder"`` or ``"policy"``
    :param name_or_path: the name of one that ships or that a plug-in brings, or a path: of the YAML file, or of the
        directory of an encoder or a policy
    :param relative_to: directory that a relative path starts from
    :return: the YAML file, ``encoder.json`` or ``policy.json``
    :raises ValueError: if there is no such YAML file
    :raises KeyError: if nothing of this kind has this name
    """
    text = str(name_or_path)
    path = relative_to / text
    if FILES[kind].endswith(".yaml"):
        if is_path(text):
            if not is_file(path):
                raise ValueError(f"{path}: no such file.{_similar(path)}")
            return path
    elif is_file(path / Path(FILES[kind]).name):
        return path / Path(FILES[kind]).name
    files = _files(kind, _folders_without_plugins(kind))
    if text not in files:  # only now are plug-ins loaded
        files = _all_files(kind)
    if text not in files:
        raise KeyError(UNKNOWN[kind].format(name=text, known=did_you_mean(text, files)) + broken_plugins())
    return files[text]


def is_path(text: str) -> bool:
    """Whether the path of a YAML file is meant, and no name."""
    return text.endswith((".yaml", ".yml")) or "/" in text


def _similar(path: Path) -> str:
    """The end of a sentence: a YAML file beside one that is not there, if its name is close."""
    try:
        beside = {file.stem: file.name for file in path.parent.glob("*.y*ml")}
    except (OSError, ValueError):  # no name of a directory
        return ""
    close = difflib.get_close_matches(path.stem, beside, n=1)
    return f" Did you mean '{beside[close[0]]}'?" if close else ""


def names(kind: str) -> list[str]:
    """The names of all files of a kind, those of plug-ins too, sorted. Kinds are those of :func:`find`."""
    return sorted(_all_files(kind))


def shipped(kind: str) -> list[str]:
    """The names of those that ship, sorted."""
    return sorted(_files(kind, [PACKAGE]))


def _all_files(kind: str) -> dict[str, Path]:
    plugins = [plugin.folder for plugin in load_plugins() if plugin.folder]
    return _files(kind, [*_folders_without_plugins(kind), *plugins])


def _folders_without_plugins(kind: str) -> list[Path]:
    if kind not in WRITTEN_HERE:
        return [PACKAGE]
    return [Path(), PACKAGE] if kind == "encoder" else [PACKAGE, Path()]


def _files(kind: str, folders: list[Path]) -> dict[str, Path]:
    """The files of a kind below some folders, by name; the first folder wins."""
    by_name = {}
    for folder in reversed(folders):
        for file in folder.glob(FILES[kind]):
            by_name[file.parent.name if "*/" in FILES[kind] else file.stem] = file
    return by_name


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
