"""When, where and from which code a training began."""

from __future__ import annotations

import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest

from ogmp_sb3.runs import provenance as module
from ogmp_sb3.runs.provenance import code_commit, provenance


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=somebody", "-c", "user.email=somebody@example.org"]
    return subprocess.run(
        ["git", "-C", str(folder), *who, *arguments], check=True, capture_output=True, text=True
    ).stdout.strip()


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone with a package in it."""
    git(tmp_path, "init", "-q")
    package = tmp_path / "package"
    package.mkdir()
    (package / "code.py").write_text("one = 1\n")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "one")
    return package


def test_the_commit_of_a_clone_is_named(clone: Path) -> None:
    assert code_commit(clone) == git(clone, "rev-parse", "HEAD")[:12]


def test_changed_code_is_said_to_be_changed_and_other_files_are_not_asked_for(clone: Path) -> None:
    commit = code_commit(clone)
    (clone.parent / "notes.txt").write_text("mine\n")
    assert code_commit(clone) == commit
    (clone / "code.py").write_text("one = 2\n")
    assert code_commit(clone) == f"{commit}, with changes"


def test_an_installed_package_has_no_commit_even_below_somebody_elses_clone(clone: Path) -> None:
    inner = clone / "venv" / "ogmp_sb3"
    inner.mkdir(parents=True)
    assert code_commit(inner) == ""


def test_without_git_there_is_no_commit(clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert code_commit(clone) == ""


def test_date_and_machine_are_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PACKAGE", tmp_path)
    (tmp_path / "cpuinfo").write_text("processor\t: 0\nmodel name\t: Fast 3000 @ 1:2 GHz\n")
    monkeypatch.setattr(module, "CPUS", tmp_path / "cpuinfo")
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1, 5})
    found = provenance()
    assert set(found) == {"date", "machine"}
    assert found["machine"].startswith("Fast 3000 @ 1:2 GHz, 3 CPUs, ")
    written = datetime.strptime(found["date"], "%Y-%m-%d %H:%M UTC").replace(tzinfo=UTC)
    assert abs((datetime.now(UTC) - written).total_seconds()) < 120


def test_a_machine_that_names_no_processor_gives_its_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CPUS", tmp_path / "nothing")
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    assert provenance()["machine"].startswith("riscv64, ")
