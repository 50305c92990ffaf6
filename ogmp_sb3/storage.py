"""Files that are whole or not there: directories put in place at once, checksums, tensors and JSON without pickle.

A process can be killed between any two of its calls. So a directory is written under a name that nobody reads and
then renamed; one that is to go is renamed first; and :func:`tidy` puts right what a kill has left.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

import torch as th
from safetensors import SafetensorError
from safetensors.torch import load, save_file

MANIFEST = "manifest.json"
_ERROR_CODE = re.compile(r"(?:os error|code:) (\d+)")  # how Rust writes the number of a system error


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
    """Put right what a kill has left in a directory: a replaced one comes back or goes, unfinished ones go.

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
def alone(folder: Path) -> Iterator[None]:
    """Be the only process that writes in a directory; a lock goes with its process, however that ends.

    :raises ValueError: if another process is there
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise ValueError(f"{folder}: another process is training there.") from None
    except OSError:
        pass  # a file system without locks
    try:
        yield
    finally:
        os.close(descriptor)


def write_manifest(folder: Path) -> None:
    """Write the checksums of all files of a directory into it."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    save_json(folder / MANIFEST, {file.relative_to(folder).as_posix(): checksum(file) for file in files})


def verify(folder: Path, *required: str) -> None:
    """Check that every file of a directory with a manifest is there and as it was written.

    :param required: files that the manifest must name
    :raises ValueError: naming the first that is not
    """
    sums = load_json(folder / MANIFEST)
    for name in required:
        if name not in sums:
            raise ValueError(f"{folder / MANIFEST}: does not name '{name}'.")
    for name, expected in sums.items():
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts:
            raise ValueError(f"{folder / MANIFEST}: '{name}' is not a file of this directory.")
        file = folder / path
        if not file.is_file() or checksum(file) != expected:
            raise ValueError(f"{file}: damaged or missing (its checksum is not that of {MANIFEST}).")


def save_tensors(path: Path, tensors: dict[str, th.Tensor]) -> None:
    """Write tensors as safetensors.

    :raises OSError: if the file cannot be written
    """
    # Parts that are shared (the features extractor stands in the policy under several names) are written out.
    whole = {name: tensor.detach().clone().contiguous() for name, tensor in tensors.items()}
    try:
        save_file(whole, path)
    except SafetensorError as error:
        code = _ERROR_CODE.search(str(error))
        number = int(code.group(1)) if code else 0
        raise OSError(number, os.strerror(number) if number else str(error), str(path)) from None


def load_tensors(path: Path) -> dict[str, th.Tensor]:
    """Read safetensors; nothing in such a file can run.

    :raises ValueError: if the file is damaged or missing
    """
    try:
        return load(path.read_bytes())  # not mapped: nothing depends on the file any more
    except (SafetensorError, OSError, ValueError, KeyError) as error:
        raise ValueError(f"{path}: not readable ({' '.join(str(error).split())}).") from None


def check_shapes(expected: Mapping[str, tuple[int, ...]], tensors: Mapping[str, th.Tensor]) -> None:
    """:raises ValueError: naming the first tensor that is missing or has another shape."""
    for name, shape in expected.items():
        found = tuple(tensors[name].shape) if name in tensors else None
        if found != shape:
            raise ValueError(f"'{name}' has the shape {found}, expected {shape}")


def save_json(path: Path, data: dict[str, Any]) -> None:
    """Write plain data."""
    path.write_text(json.dumps(data, indent=1), encoding="utf-8")


def load_json(path: Path) -> dict[str, Any]:
    """Read a mapping of plain data.

    :raises ValueError: if the file is damaged or missing
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError(f"{path}: not readable (nested too deeply).") from None
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: not readable ({error}).") from None
    if not isinstance(data, dict):
        raise ValueError(f"{path}: expected a mapping.")
    return data


def reason(error: OSError) -> str:
    """What went wrong with a file, in the words of the operating system: ``No space left on device``."""
    return error.strerror or str(error)


def _beside(folder: Path, ending: str) -> Path:
    """``.<name>.<ending>``, also for a name that is of this form already."""
    name = folder.name.removeprefix(".").removesuffix(".tmp").removesuffix(".old")
    return folder.with_name(f".{name}.{ending}")


def checksum(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
