"""Files and directories that are whole or not there, whenever the process is killed, and locks."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from helpers.faults import hidden, killed_at, read_version, write_version
from ogmp_sb3.runs.atomic import LOCK, locked, occupied, remove, replacing, tidy


@pytest.mark.parametrize("there", [False, True])
def test_a_directory_killed_at_any_access_is_the_old_one_or_the_new_one(there: bool, tmp_path: Path) -> None:
    seen = []
    for access in range(100):
        folder = tmp_path / str(access) / "best"
        if there:
            write_version(folder, 1)
        with killed_at(access, tmp_path) as killed:
            write_version(folder, 2)
        tidy(folder.parent)
        seen.append(read_version(folder) if folder.exists() else 0)
        assert hidden(tmp_path) == []
        if not killed[0]:
            break
    assert seen[-1] == 2 and access > 10
    assert set(seen) == ({1, 2} if there else {0, 2})
    assert sorted(seen) == seen  # once the new one is in place it stays


def test_a_kill_before_and_after_makes_no_difference_to_the_next_write(tmp_path: Path) -> None:
    """Nobody tidies up between two kills."""
    folder = tmp_path / "best"
    write_version(folder, 0)
    for access in (12, 3, 14, 9, 13, 1, 15):
        with killed_at(access, tmp_path):
            write_version(folder, 1)
    write_version(folder, 2)
    assert read_version(folder) == 2
    tidy(tmp_path)
    assert hidden(tmp_path) == []


def test_a_directory_that_is_removed_is_whole_or_gone(tmp_path: Path) -> None:
    for access in range(100):
        folder = tmp_path / str(access) / "old"
        write_version(folder, 1)
        with killed_at(access, tmp_path) as killed:
            remove(folder)
        assert not folder.exists() or read_version(folder) == 1
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
    code = "import sys; from ogmp_sb3.runs.atomic import locked\nwith locked(__import__('pathlib').Path(sys.argv[1])): "
    holder = [sys.executable, "-c", code + "print('has it', flush=True); sys.stdin.read()", str(tmp_path)]
    with subprocess.Popen(holder, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"has it\n"
        assert occupied(tmp_path)
        with pytest.raises(ValueError, match="another process is training there"), locked(tmp_path):
            pass
        process.kill()
        process.wait()
        assert not occupied(tmp_path)
        with locked(tmp_path):
            assert occupied(tmp_path)
        assert not occupied(tmp_path)


def test_a_look_at_a_directory_keeps_nobody_out(tmp_path: Path) -> None:
    with locked(tmp_path):
        pass
    descriptor = os.open(tmp_path / LOCK, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_SH)
    timer = threading.Timer(0.05, os.close, [descriptor])
    timer.start()
    with locked(tmp_path):
        timer.join()


def test_a_file_system_without_locks_is_said_to_be_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.warns(UserWarning, match="cannot be locked here"), locked(tmp_path):
        assert not occupied(tmp_path)


def test_where_nothing_can_be_written_nobody_is_alone(tmp_path: Path) -> None:
    with (
        pytest.raises(ValueError, match=r"nowhere: nothing can be written there \(No such file"),
        locked(tmp_path / "nowhere"),
    ):
        pass


def test_a_file_killed_at_any_access_is_the_old_one_or_the_new_one(tmp_path: Path) -> None:
    file, seen = tmp_path / "a.json", []
    for access in range(100):
        file.write_text("old")
        with killed_at(access, tmp_path) as killed, replacing(file) as temporary:
            temporary.write_text("new")
        seen.append(file.read_text())
        if not killed[0]:
            break
    assert seen == sorted(seen, reverse=True) and set(seen) == {"old", "new"}
    tidy(tmp_path)
    assert hidden(tmp_path) == []


def test_a_file_that_cannot_be_written_leaves_the_old_one_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("old")
    with pytest.raises(OSError) as caught, replacing(tmp_path / "a.json") as temporary:
        temporary.write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert caught.value.filename == str(tmp_path / "a.json")  # the operating system names none
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    assert (tmp_path / "a.json").read_text() == "old"
