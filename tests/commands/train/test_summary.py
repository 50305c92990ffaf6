"""What a multirun came to, in a table."""

from __future__ import annotations

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from helpers.run_directories import make_run
from ogmp_sb3.commands.train.summary import Summary, summary
from ogmp_sb3.runs.multirun import read_sweep


def columns(folder: Path) -> dict[str, list[str]]:
    return {str(column.header): [str(cell) for cell in column.cells] for column in summary(read_sweep(folder)).columns}


def test_every_job_is_named_by_what_the_jobs_differ_in(tmp_path: Path) -> None:
    make_run(tmp_path / "a", ["task=parkour", "rho=0.3", "seed=0"], steps=1000, checkpoint=1000)
    make_run(tmp_path / "b", ["task=parkour", "rho=null", "seed=0"], config=False)
    assert columns(tmp_path) == {
        "rho": ["0.3", "null"],
        "state": ["finished", "failed"],
        "samples": ["1.00k", "0"],
        "training return": ["800.0", ""],  # the mean of 600, 700, ..., 1000
    }


def test_a_job_alone_is_named_by_its_directory(tmp_path: Path) -> None:
    make_run(tmp_path / "only", ["task=parkour"])
    assert columns(tmp_path)["job"] == ["only"]


def test_at_the_end_the_table_and_the_command_that_compares_are_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "my sweep"
    make_run(folder / "a", ["rho=0.3"], steps=1000)
    Summary().on_multirun_end(OmegaConf.create({"hydra": {"sweep": {"dir": str(folder)}}}))
    table, _, last = capsys.readouterr().out.rstrip().rpartition("\n")
    assert "training return" in table
    assert last == f"To compare them on test tracks:  ogmp-report 'sweep={folder}'"


def test_a_multirun_in_which_nothing_began_says_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Summary().on_multirun_end(OmegaConf.create({"hydra": {"sweep": {"dir": str(tmp_path)}}}))
    assert capsys.readouterr().out == ""
