"""Plug-ins: installed packages that bring modes, oracles, terms, tasks, robots and policies of their own.

A plug-in is an entry point of the group ``ogmp_sb3.plugins``, and names a module. Importing the module registers
functions (:mod:`ogmp_sb3.config.registry`); tasks, scenes, robots, encoders and policies beside it are found by name
(:data:`FILES`). :func:`load_plugins` loads all of them, when something is named that does not ship.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

from ogmp_sb3.config import registry
from ogmp_sb3.config.registry import KINDS, NameTaken

GROUP = "ogmp_sb3.plugins"
FILES = {
    "task": "tasks/*.yaml",
    "scene": "tasks/scenes/*.yaml",
    "robot": "robots/*/robot.yaml",
    "encoder": "encoders/*/encoder.json",
    "policy": "policies/*/policy.json",
}
"""What is found by name: where its files are, below what ships and below a plug-in's folder."""
SHIPPED = Path(__file__).parents[1]


@dataclass(frozen=True)
class Plugin:
    """An installed plug-in."""

    name: str
    """of its entry point"""
    distribution: str
    """what was installed"""
    version: str
    """of the distribution"""
    folder: Path | None = None
    """where its files are; None: it is a single file, or broken"""
    error: str | None = None
    """why it is broken"""

    def __str__(self) -> str:
        return f"plug-in '{self.name}' of {self.distribution} {self.version}"


def installed() -> list[EntryPoint]:
    """The entry points of all plug-ins, in the order of their names."""
    return sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value))


def load(entry: EntryPoint, taken: Iterable[Path]) -> Plugin:
    """Import a plug-in. Whatever its module raises comes through.

    :param entry: its entry point
    :param taken: folders whose files have their names already
    :raises NameTaken: if one of its files or functions has a name that is taken
    :raises TypeError: if the entry point does not name a module
    """
    module = entry.load()
    if not isinstance(module, ModuleType) or module.__file__ is None:
        raise TypeError(f"'{entry.value}' must name a module, or a package with an __init__.py")
    file = Path(module.__file__)
    if file.name != "__init__.py" and "." not in module.__name__:
        return plugin_of(entry)
    _check_files(file.parent, taken)
    return plugin_of(entry, folder=file.parent)


def plugin_of(entry: EntryPoint, folder: Path | None = None, error: Exception | None = None) -> Plugin:
    """What is known of a plug-in."""
    assert entry.dist is not None
    reason = None if error is None else " ".join(f"{type(error).__name__}: {error}".split())
    if isinstance(error, ImportError) and str(error.name).partition(".")[0] == "ogmp_sb3":  # a module that has moved
        reason = f"{reason}; import from ogmp_sb3.extend"
    return Plugin(entry.name, entry.dist.name, entry.dist.version, folder, reason)


def _check_files(folder: Path, taken: Iterable[Path]) -> None:
    for pattern in FILES.values():
        for file in sorted(folder.glob(pattern)):
            for other in (path / file.relative_to(folder) for path in taken if path != folder):
                if other.is_file():
                    raise NameTaken(f"{file} has the name of {other}.")


_plugins: list[Plugin] | None = None  # None: not looked for yet


def load_plugins() -> list[Plugin]:
    """Import every installed plug-in, once. Of a broken one nothing stays registered.

    :raises NameTaken: if one wants a name that is taken
    """
    global _plugins
    if _plugins is None:
        _plugins = []  # before the first is loaded, for it may look names up
        try:
            for entry in installed():
                _plugins.append(_load(entry, [SHIPPED, *(p.folder for p in _plugins if p.folder)]))
        except NameTaken:
            _plugins = None
            raise
    return _plugins


def _load(entry: EntryPoint, folders: list[Path]) -> Plugin:
    before = [dict(kind._functions) for kind in KINDS]
    try:
        return load(entry, folders)
    except Exception as error:
        for kind, functions in zip(KINDS, before, strict=True):
            kind._functions = functions
        plugin = plugin_of(entry, error=error)
        if isinstance(error, NameTaken):
            raise NameTaken(f"{plugin}: {error}") from None
        return plugin


def loaded_plugins() -> list[Plugin]:
    """The plug-ins that are loaded now."""
    return [plugin for plugin in _plugins or [] if not plugin.error]


def broken_plugins() -> str:
    """Why a name may be unknown, as sentences; empty if no plug-in is broken."""
    broken = (plugin for plugin in load_plugins() if plugin.error)
    return "".join(f" And {plugin} is broken ({plugin.error})." for plugin in broken)


registry.set_loader(broken_plugins)
