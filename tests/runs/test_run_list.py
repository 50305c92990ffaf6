"""One line about each run, from as little of its files as will do."""

from __future__ import annotations

import contextlib
import math
import os
from pathlib import Path

import pytest
import yaml

from helpers.run_directories import make_run, write_log
from ogmp_sb3.runs.atomic import locked
from ogmp_sb3.runs.run_directory import FAILURE, read_run
from ogmp_sb3.runs.run_folders import RunFolder
from ogmp_sb3.runs.run_list import summarise


def test_a_summary_says_what_reading_all_of_the_run_does(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", ["task=parkour", "rho=0.5"], total=100_000, steps=60_000, checkpoint=59_904)
    run, summary = read_run(path), summarise(RunFolder(path, None))
    assert (tmp_path / "run" / "progress.csv").stat().st_size > 8192  # more than is read
    assert (summary.state, summary.samples, summary.total) == (run.state, run.samples, 100_000)
    assert (summary.state, summary.samples) == ("stopped", 60_000)
    assert summary.returned == run.final("episode/return") == 59_800
    assert (summary.task, summary.rho, summary.overrides) == ("parkour", 0.5, ("task=parkour", "rho=0.5"))


@pytest.mark.parametrize(
    ("total", "steps", "checkpoint", "failed", "trains", "state"),
    [
        (1000, 1000, 1024, False, False, "finished"),
        (1000, 500, 256, False, True, "running"),
        (1000, 500, 256, False, False, "stopped"),
        (1000, 500, 0, False, False, "failed"),
        (1000, 500, 256, True, False, "failed"),
        (1000, 500, 256, True, True, "running"),  # its next attempt
    ],
)
def test_the_state_is_read_from_lock_checkpoints_and_failure(
    total: int, steps: int, checkpoint: int, failed: bool, trains: bool, state: str, tmp_path: Path
) -> None:
    path = make_run(tmp_path / "run", [], total, steps, checkpoint)
    if failed:
        (path / FAILURE).write_text("the disk\nwas full")
    with locked(path) if trains else contextlib.nullcontext():
        summary = summarise(RunFolder(path, None))
        assert summary.state == read_run(path).state == state
    assert summary.problem == ("the disk was full" if state == "failed" and failed else "")


def test_a_run_that_was_never_begun_has_what_was_typed(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", ["task=ok/walk.yaml", "+task.rho=-1"], config=False)
    summary = summarise(RunFolder(path, None))
    assert (summary.task, summary.rho, summary.total, summary.state) == ("walk", "-1", None, "failed")
    assert math.isnan(summary.returned)


DAMAGES = {
    "config.yaml": [
        "\0\1", b"\xff\xfe\xff", "", "[]", "a: b: c", "task: 3", "train: {total_timesteps: many}", "&a [*a]",
        "{" * 3000,
        "task: {rho: {}}\ntrain: {total_timesteps: 5}", "task: {}\ntrain: {total_timesteps: 5}\noverrides: 3",
        "train: {total_timesteps: 5}\ntask: {}\ntask_file: 3", "a: !!bool maybe", "a: !!python/object:os.system 1",
        "task: {}\ntrain: {total_timesteps: 5}\noverrides: [3]", "when: 2026-99-99", None,
    ],
    "progress.csv": ["a,b\n1,2\n", b"\xff\xff\n", "time/total_timesteps\nmany\n", "time/total_timesteps\nnan\n",
        "time/total_timesteps\n1e999\n", "time/total_timesteps\n1,2,3\n", "\0", None],
    ".hydra/overrides.yaml": ["{}", "[[1]]", "[", b"\xff", None],
}  # fmt: skip


@pytest.mark.parametrize(
    ("file", "content"), [(file, content) for file, contents in DAMAGES.items() for content in contents]
)
def test_a_file_that_cannot_be_read_makes_a_damaged_row(file: str, content: str | bytes | None, tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", ["task=dive"], steps=500, checkpoint=256)
    (path / file).unlink()
    if content is None:
        (path / file).mkdir()
    else:
        (path / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    summary = summarise(RunFolder(path, None))
    assert summary.state == "damaged", content
    assert summary.problem.startswith(f"{path / file}: ")
    assert "\n" not in summary.problem


def test_a_link_to_nowhere_is_no_traceback(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", ["task=dive"], config=False)
    (path / "progress.csv").symlink_to(tmp_path / "nowhere.csv")
    assert summarise(RunFolder(path, None)).state == "failed"


def test_a_row_that_is_being_written_is_left_out(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", [], steps=300, checkpoint=256)
    write_log(path / "progress.csv", [100, 200], episode__return=[1.0, 3.0])
    with (path / "progress.csv").open("a") as file:
        file.write("300,9")
    assert (summarise(RunFolder(path, None)).samples, summarise(RunFolder(path, None)).returned) == (256, 2.0)


def test_the_time_it_was_begun_is_that_of_its_config(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", [])
    os.utime(path / "config.yaml", (1234, 1234))
    assert RunFolder(path, None).begun == 1234
    data = yaml.safe_load((path / "config.yaml").read_text())
    assert data["train"]["total_timesteps"] == summarise(RunFolder(path, None)).total
