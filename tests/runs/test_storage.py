"""Tensors, JSON and checksums: what is damaged is said to be."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
import torch as th

from helpers.faults import write_version
from ogmp_sb3.runs.atomic import reason
from ogmp_sb3.runs.storage import MANIFEST, check_shapes, load_json, load_tensors, save_tensors, verify


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_version(tmp_path / "whole", 1)
    return tmp_path / "whole"


def test_every_file_that_is_changed_or_missing_is_named(folder: Path) -> None:
    for name in ("a.json", "inner/b.safetensors"):
        content = (folder / name).read_bytes()
        for damage in (b"", content[:-1], content + b" ", content[:-1] + bytes([content[-1] ^ 1])):
            (folder / name).write_bytes(damage)
            with pytest.raises(ValueError, match=f"{Path(name).name}: damaged or missing"):
                verify(folder)
        (folder / name).unlink()
        with pytest.raises(ValueError, match=f"{Path(name).name}: damaged or missing"):
            verify(folder)
        (folder / name).write_bytes(content)
    verify(folder)


@pytest.mark.parametrize("name", ["/etc/hostname", "../a.json", "inner/../../a.json"])
def test_a_manifest_cannot_have_files_read_elsewhere(name: str, folder: Path) -> None:
    (folder / MANIFEST).write_text(json.dumps({name: "0"}))
    with pytest.raises(ValueError, match="is not a file of this directory"):
        verify(folder)


def test_a_manifest_must_name_what_is_needed(folder: Path) -> None:
    (folder / MANIFEST).write_text("{}")
    with pytest.raises(ValueError, match=r"manifest.json: does not name 'a.json'"):
        verify(folder, "a.json")


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"a": nan', "[" * 100_000, "\x00", '{"a": 1}\udcff'])
def test_json_that_is_no_mapping_is_a_sentence(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(ValueError, match=r"a.json: (not readable|expected a mapping)"):
        load_json(tmp_path / "a.json")


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"\xff" * 100, b"\x80\x04N.", b'{"__metadata__":{}}'])
def test_tensors_that_are_none_are_a_sentence(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.safetensors").write_bytes(content)
    with pytest.raises(ValueError, match=r"a.safetensors: not readable") as caught:
        load_tensors(tmp_path / "a.safetensors")
    assert "\n" not in str(caught.value)


def test_a_shape_that_does_not_fit_is_named() -> None:
    check_shapes({"a": (2, 3)}, {"a": th.zeros(2, 3), "b": th.zeros(1)})
    with pytest.raises(ValueError, match=r"'a' has the shape \(2, 3\), expected \(3, 2\)"):
        check_shapes({"a": (3, 2)}, {"a": th.zeros(2, 3)})
    with pytest.raises(ValueError, match=r"'c' has the shape None, expected \(1,\)"):
        check_shapes({"c": (1,)}, {})


@pytest.fixture
def small_disk(tmp_path: Path) -> Path:
    """A disk of 256 KiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("mounting a small disk needs root")
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", folder], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip(f"no small disk can be mounted here ({mounted.stderr.decode().strip()})")
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_tensors_on_a_full_disk_are_an_error_of_the_operating_system(small_disk: Path) -> None:
    with pytest.raises(OSError) as caught:
        save_tensors(small_disk / "a.safetensors", {"a": th.zeros(100_000)})
    assert caught.value.errno == errno.ENOSPC and caught.value.filename == str(small_disk / "a.safetensors")
    assert reason(caught.value) == f"No space left on device: the disk mounted at {small_disk} is full"
    with pytest.raises(OSError) as caught:
        save_tensors(small_disk / "nowhere" / "a.safetensors", {"a": th.zeros(1)})
    assert caught.value.errno == errno.ENOENT
