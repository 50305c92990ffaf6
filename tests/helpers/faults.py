"""Faults that a machine can have, made on purpose: a kill at any access to a file, a disk that is full."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch as th

from ogmp_sb3.runs.atomic import LOCK, fresh, put_in_place
from ogmp_sb3.runs.storage import load_json, load_tensors, save_json, save_tensors, verify, write_manifest

WATCHED = ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.truncate", "shutil.rmtree", "shutil.copyfile")
NO_SPACE = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class Killed(BaseException):
    """The process would be gone here."""


class _Killer:
    """Raises at the n-th access to a file below a directory, and at every one after it."""

    folder: str | None = None
    left = 0

    def __call__(self, event: str, arguments: tuple[object, ...]) -> None:
        if self.folder is None or event not in WATCHED:
            return
        if any(str(argument).startswith(self.folder) for argument in arguments if isinstance(argument, str | Path)):
            self.left -= 1
            if self.left < 0:
                raise Killed


_killer = _Killer()
sys.addaudithook(_killer)


class _Guard:
    """Refuses what would change anything below a directory, as if it were another user's; root may do everything."""

    folder: str | None = None

    def __call__(self, event: str, arguments: tuple[object, ...]) -> None:
        if self.folder is None or event not in WATCHED:
            return
        if event == "open" and not int(str(arguments[2])) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            return
        for path in (str(argument) for argument in arguments if isinstance(argument, str | Path)):
            if path.startswith(self.folder):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)


_guard = _Guard()
sys.addaudithook(_guard)


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """In the body nothing below a directory can be written."""
    _guard.folder = str(folder)
    try:
        yield
    finally:
        _guard.folder = None


@contextmanager
def killed_at(access: int, folder: Path) -> Iterator[list[bool]]:
    """Run the body until its ``access``-th access to a file below ``folder``; the list tells whether it came so far."""
    happened = [False]
    _killer.folder, _killer.left = str(folder), access
    try:
        yield happened
    except Killed:
        happened[0] = True
    finally:
        _killer.folder = None


def hidden(folder: Path) -> list[str]:
    """Names of what is half done or put aside."""
    return sorted(path.name for path in folder.rglob(".*") if path.name != LOCK)


def write_version(folder: Path, version: int) -> None:
    """A directory with a number in it, all or nothing."""
    temporary = fresh(folder)
    save_json(temporary / "a.json", {"version": version})
    (temporary / "inner").mkdir()
    save_tensors(temporary / "inner" / "b.safetensors", {"version": th.tensor(version)})
    write_manifest(temporary)
    put_in_place(temporary, folder)


def read_version(folder: Path) -> int:
    """The number of a directory that is whole."""
    verify(folder, "a.json", "inner/b.safetensors")
    found = {load_json(folder / "a.json")["version"], int(load_tensors(folder / "inner" / "b.safetensors")["version"])}
    (one,) = found
    return one
