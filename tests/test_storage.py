"""Files that are whole or not there, whenever the process is killed; and files that are damaged are said to be."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch as th
from faults import hidden, killed_at

from ogmp_sb3.storage import (
    MANIFEST,
    alone,
    check_shapes,
    fresh,
    load_json,
    load_tensors,
    put_in_place,
    remove,
    save_json,
    save_tensors,
    tidy,
    verify,
    write_manifest,
)


def write(folder: Path, version: int) -> None:
    temporary = fresh(folder)
    save_json(temporary / "a.json", {"version": version})
    (temporary / "inner").mkdir()
    save_tensors(temporary / "inner" / "b.safetensors", {"version": th.tensor(version)})
    write_manifest(temporary)
    put_in_place(temporary, folder)


def version(folder: Path) -> int:
    verify(folder, "a.json", "inner/b.safetensors")
    found = {load_json(folder / "a.json")["version"], int(load_tensors(folder / "inner" / "b.safetensors")["version"])}
    (one,) = found
    return one


@pytest.mark.parametrize("there", [False, True])
def test_a_directory_killed_at_any_access_is_the_old_one_or_the_new_one(there: bool, tmp_path: Path) -> None:
    seen = []
    for access in range(100):
        folder = tmp_path / str(access) / "best"
        if there:
            write(folder, 1)
        with killed_at(access, tmp_path) as killed:
            write(folder, 2)
        tidy(folder.parent)
        seen.append(version(folder) if folder.exists() else 0)
        assert hidden(tmp_path) == []
        if not killed[0]:
            break
    assert seen[-1] == 2 and access > 10
    assert set(seen) == ({1, 2} if there else {0, 2})
    assert sorted(seen) == seen  # once the new one is in place it stays


def test_a_kill_before_and_after_makes_no_difference_to_the_next_write(tmp_path: Path) -> None:
    """Nobody tidies up between two kills."""
    folder = tmp_path / "best"
    write(folder, 0)
    for access in (12, 3, 14, 9, 13, 1, 15):
        with killed_at(access, tmp_path):
            write(folder, 1)
    write(folder, 2)
    assert version(folder) == 2
    tidy(tmp_path)
    assert hidden(tmp_path) == []


def test_a_directory_that_is_removed_is_whole_or_gone(tmp_path: Path) -> None:
    for access in range(100):
        folder = tmp_path / str(access) / "old"
        write(folder, 1)
        with killed_at(access, tmp_path) as killed:
            remove(folder)
        assert not folder.exists() or version(folder) == 1
        tidy(folder.parent)
        assert hidden(tmp_path) == []
        if not killed[0]:
            break
    assert access > 3


def test_tidying_leaves_what_is_not_of_its_names(tmp_path: Path) -> None:
    for name in (".best.tmp", ".mine.tmp", "best.tmp"):
        (tmp_path / name).mkdir()
    (tmp_path / ".best.yaml.tmp").write_text("")
    tidy(tmp_path, "best")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".best.yaml.tmp", ".mine.tmp", "best.tmp"]
    tidy(tmp_path, "best.yaml")
    assert not (tmp_path / ".best.yaml.tmp").exists()


def test_two_processes_cannot_write_in_one_directory_and_a_lock_goes_with_its_process(tmp_path: Path) -> None:
    code = "import os, sys; from ogmp_sb3.storage import alone\nwith alone(__import__('pathlib').Path(sys.argv[1])): "
    holder = [sys.executable, "-c", code + "print('has it', flush=True); sys.stdin.read()", str(tmp_path)]
    with subprocess.Popen(holder, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"has it\n"
        with pytest.raises(ValueError, match="another process is training there"), alone(tmp_path):
            pass
        process.kill()
        process.wait()
        with alone(tmp_path):
            assert list(tmp_path.iterdir()) == []


# ---- damage ----


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write(tmp_path / "whole", 1)
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
    assert caught.value.errno == errno.ENOSPC
    with pytest.raises(OSError) as caught:
        save_tensors(small_disk / "nowhere" / "a.safetensors", {"a": th.zeros(1)})
    assert caught.value.errno == errno.ENOENT
