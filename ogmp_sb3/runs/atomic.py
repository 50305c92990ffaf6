"""Atomic writes of files and directories, and a lock: a killed process leaves no half-written file.

A process can be killed between any two of its calls. So a file or directory is written under a name that nobody reads
and then renamed; a directory that is to go is renamed first; and :func:`tidy` puts right what a kill has left.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ogmp_sb3.machine import FULL, full_disks, mount_point

LOCK = ".lock"  # in a directory that one process at a time may write in


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name a file in the errors of the operating system about it, which it leaves out where a disk is full.

    :raises OSError: what the body raises
    """
    try:
        yield
    except OSError as error:
        error.filename = error.filename or str(path)
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file to write to, which takes the place of ``path`` at the end; if writing fails, the old one stays.

    :raises OSError: if it cannot be written
    """
    temporary = _beside(path, "tmp")
    try:
        with naming(path):
            yield temporary
            _sync(temporary)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    temporary.replace(path)


def fresh(folder: Path) -> Path:
    """An empty directory to write ``folder`` in, until :func:`put_in_place`."""
    temporary = _beside(folder, "tmp")
    remove(temporary)
    temporary.mkdir(parents=True)
    return temporary


def put_in_place(temporary: Path, folder: Path) -> None:
    """Make a finished directory take the place of ``folder``, which may exist.

    Killed at any moment, either the old one or the new one is there, at the latest after :func:`tidy`.
    """
    for path in [*temporary.rglob("*"), temporary]:
        _sync(path)
    old = _beside(folder, "old")
    if folder.exists():
        remove(old)
        folder.rename(old)
    temporary.rename(folder)
    _sync(folder.parent)
    remove(old)


def remove(folder: Path) -> None:
    """Remove a directory, if it is there, so that no half of it is ever seen under its name."""
    gone = _beside(folder, "gone")
    shutil.rmtree(gone, ignore_errors=True)
    if folder.exists():
        folder.rename(gone)
        shutil.rmtree(gone, ignore_errors=True)


def tidy(parent: Path, pattern: str = "*") -> None:
    """Clean up after a killed process: a replaced directory comes back or goes, unfinished ones go.

    :param pattern: names of what is written there
    """
    for old in parent.glob(f".{pattern}.old"):
        folder = parent / old.name[1 : -len(".old")]
        if folder.exists():
            remove(old)
        else:
            old.rename(folder)
    for ending in ("tmp", "gone"):
        for unfinished in parent.glob(f".{pattern}.{ending}"):
            if unfinished.is_dir():
                shutil.rmtree(unfinished, ignore_errors=True)
            else:
                unfinished.unlink()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a directory against other writing processes; the lock is released when its process ends, however it ends.

    :raises ValueError: if another process is there, or nothing can be written there
    """
    try:
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)  # network file systems lock only for writing
    except OSError as error:
        raise ValueError(f"{folder}: nothing can be written there ({reason(error)}).") from None
    try:
        _lock(descriptor, folder)
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, folder: Path) -> None:
    for last in (False, True):
        try:
            return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if last:
                raise ValueError(f"{folder}: another process is training there.") from None
            time.sleep(0.2)  # it may have been a look of occupied()
        except OSError:
            warnings.warn(f"{folder}: cannot be locked here; no other training must write there.", stacklevel=4)
            return None


def occupied(folder: Path) -> bool:
    """Whether a process holds the lock of a directory (:func:`locked`)."""
    try:
        descriptor = os.open(folder / LOCK, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return False
    except OSError as error:
        return isinstance(error, BlockingIOError)
    finally:
        os.close(descriptor)


def reason(error: OSError) -> str:
    """What went wrong with a file, in the words of the operating system; and which disk is full, if one is."""
    text = error.strerror or str(error)
    if error.errno not in FULL:
        return text
    disks = [mount_point(Path(error.filename))] if error.filename else full_disks()
    places = " and ".join(f"the disk mounted at {disk}" for disk in disks)
    return f"{text}: {places} {'is' if len(disks) == 1 else 'are'} full" if disks else text


def _beside(folder: Path, ending: str) -> Path:
    """``.<name>.<ending>``, also for a name that is of this form already."""
    name = folder.name.removeprefix(".").removesuffix(".tmp").removesuffix(".old")
    return folder.with_name(f".{name}.{ending}")


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
