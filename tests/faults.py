"""Faults that a machine can have, made on purpose: a kill at any access to a file, a disk that is full."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
    return sorted(path.name for path in folder.rglob(".*"))
