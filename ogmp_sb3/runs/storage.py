"""Tensors and JSON on disk, nothing that can run code, and their checksums."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import torch as th
from omegaconf import OmegaConf
from safetensors import SafetensorError
from safetensors.torch import load, save

from ogmp_sb3.runs.atomic import naming, replacing

MANIFEST = "manifest.json"


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
    with naming(path):
        path.write_bytes(save(whole))  # save_file would let nobody else read it, whatever the umask says


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
        actual = tuple(tensors[name].shape) if name in tensors else None
        if actual != shape:
            raise ValueError(f"'{name}' has the shape {actual}, expected {shape}")


def save_json(path: Path, data: dict[str, Any]) -> None:
    """Write plain data, all or nothing."""
    with replacing(path) as file:
        file.write_text(json.dumps(data, indent=1), encoding="utf-8")


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


def checksum(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_yaml(path: Path, data: dict[str, Any]) -> None:
    """Write plain data as YAML, all or nothing."""
    with replacing(path) as file:
        OmegaConf.save(OmegaConf.create(data), file)
