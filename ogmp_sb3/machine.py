"""What the machine has for us: places that can be written, compiled code that is kept, and matplotlib without a screen.

In a container the package may be read-only and the user without a home; a home may be full; a notebook sets
``MPLBACKEND`` for every program that it starts. None of this matters to a training, so it must not end one.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import stat
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numba

if sys.platform == "win32":
    sys.tracebacklimit = 0  # the sentence says it all
    raise ImportError("ogmp_sb3 needs Linux: on Windows, install it within WSL 2.")

PACKAGE = Path(__file__).parent
COMPILED = ("env", "guidance", "sb3")  # packages with compiled functions
PRIVATE = f"ogmp_sb3-{os.getuid()}"  # name of a directory among the temporary files
FULL = (errno.ENOSPC, errno.EDQUOT)  # of a disk, and of a user's share of it
NEEDED = 1 << 20  # bytes: room for the machine code of a function, or for a small policy


def cpu_count() -> int:
    """How many CPUs this process may use; on a system that does not tell, how many there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_writable(folder: Path) -> None:
    """Write a file in a directory, or in the nearest above it that there is, and leave no trace of it.

    :raises OSError: naming the directory, if a file of a megabyte cannot be written there
    """
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    try:
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(bytes(NEEDED))
    except OSError as error:
        raise OSError(error.errno, os.strerror(error.errno or 0), str(there)) from None


def can_write(folder: Path) -> bool:
    """Whether :func:`check_writable` finds nothing wrong."""
    try:
        check_writable(folder)
    except OSError:
        return False
    return True


def mount_point(path: Path) -> Path:
    """Where the disk that a file lies on, or would lie on, is mounted."""
    return next(above for above in (path.absolute(), *path.absolute().parents) if os.path.ismount(above))


def full_disks() -> list[Path]:
    """Where those of the disks are mounted that a program writes on unasked and that have no room."""
    home = _xdg("XDG_CACHE_HOME", "~/.cache")
    kept = getattr(numba.config, "CACHE_DIR", None) or PACKAGE
    places = (Path(), home, os.environ.get("TMPDIR") or "/tmp", kept)
    return sorted({mount_point(Path(place)) for place in places if place is not None and not _has_room(Path(place))})


def _has_room(folder: Path) -> bool:
    try:
        check_writable(folder)
    except OSError as error:
        return error.errno not in FULL
    return True


def private_folder() -> Path | None:
    """A directory among the temporary files that is this user's alone, for what usually lies in the home.

    Machine code that is read from a file is run. So a directory of this name that another user has made, or that
    others may write, is not used.
    """
    for parent in map(Path, filter(None, (os.environ.get("TMPDIR"), "/tmp", "/var/tmp", "/dev/shm"))):
        folder = parent / PRIVATE
        with contextlib.suppress(OSError):
            with contextlib.suppress(FileExistsError):
                folder.mkdir(mode=0o700)
            if _is_guarded(parent) and _is_own(folder) and can_write(folder):
                return folder
    return None


def _is_guarded(parent: Path) -> bool:
    """Whether no other user can put something else in the place of what lies in a directory."""
    mode = parent.stat().st_mode
    return bool(mode & stat.S_ISVTX) or not mode & (stat.S_IWGRP | stat.S_IWOTH)


def _is_own(folder: Path) -> bool:
    found = folder.lstat()  # of a link, that of the link
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not stat.S_IMODE(found.st_mode) & 0o077


def _xdg(variable: str, default: str) -> Path | None:
    """A directory of the user's by the XDG specification; None if there is no home."""
    folder = Path(os.environ.get(variable) or os.path.expanduser(default))
    return folder if folder.is_absolute() else None


def keep_compiled_code() -> bool:
    """Have numba keep machine code where it can be written: where it does by itself, else in the home, else in
    :func:`private_folder`.

    :return: False if nowhere, after a warning
    """
    settings: Any = numba.config
    wanted = settings.CACHE_DIR
    usual = [Path(wanted)] if wanted else [PACKAGE / name / "__pycache__" for name in COMPILED]
    if all(map(can_write, usual)):
        return True
    home = _xdg("XDG_CACHE_HOME", "~/.cache")
    for folder in (home if home and can_write(home) else None, private_folder()):
        if folder is not None:
            settings.CACHE_DIR = str(folder / "numba")  # of this process alone: others look for themselves
            return True
    warnings.warn(
        "compiled code can be kept nowhere, so every start takes half a minute longer: "
        "set NUMBA_CACHE_DIR to a directory that can be written.",
        stacklevel=2,
    )
    return False


compiled: Any = functools.partial(numba.njit, cache=keep_compiled_code(), error_model="numpy")
"""``numba.njit`` for this package: ``@compiled`` or ``@compiled(fastmath=True)``.

A division by 0 is infinite or NaN, as in NumPy: to look out for it would keep the compiler from vectorising.
"""


def import_matplotlib() -> None:
    """Import matplotlib also where ``MPLBACKEND`` names no backend that is installed, and where there is no home.

    What draws here needs no backend. One that is there stays: it is the user's, as in a notebook.
    """
    _give_matplotlib_a_home()
    wanted = os.environ.get("MPLBACKEND")
    if not wanted or "matplotlib" in sys.modules:
        return  # it chooses a backend when it is used
    del os.environ["MPLBACKEND"]
    try:
        import matplotlib

        with contextlib.suppress(ValueError):
            matplotlib.rcParams["backend"] = wanted  # as it does itself
    finally:
        os.environ["MPLBACKEND"] = wanted


def _give_matplotlib_a_home() -> None:
    """Set ``MPLCONFIGDIR`` if matplotlib would have to look through all fonts at every start, with a warning."""
    given = os.environ.get("MPLCONFIGDIR")
    if given and Path(given).parent.name != PRIVATE:  # one of ours may have come from another machine
        return
    homes = (_xdg("XDG_CONFIG_HOME", "~/.config"), _xdg("XDG_CACHE_HOME", "~/.cache"))
    if all(home is not None and can_write(home / "matplotlib") for home in homes):
        return
    folder = private_folder()
    if folder is not None:
        os.environ["MPLCONFIGDIR"] = str(folder / "matplotlib")
