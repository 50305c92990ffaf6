"""Run directories in every state, made by hand."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest

from helpers.run_directories import make_run, write_log
from ogmp_sb3.runs.atomic import locked
from ogmp_sb3.runs.logs import STEP_COLUMN
from ogmp_sb3.runs.run_directory import FAILURE, read_log, read_run, samples_text


@pytest.mark.parametrize(
    ("total", "steps", "checkpoint", "config", "trains", "state"),
    [
        (1000, 900, 1024, True, False, "finished"),
        (1000, 500, 0, True, True, "running"),
        (1000, 500, 256, True, False, "stopped"),
        (1000, 500, 0, True, False, "failed"),
        (1000, 0, 0, False, False, "failed"),
        (1000, 0, 0, False, True, "running"),
    ],
)
def test_the_state_of_a_run(
    total: int, steps: int, checkpoint: int, config: bool, trains: bool, state: str, tmp_path: Path
) -> None:
    path = make_run(tmp_path / "run", ["task=parkour"], total, steps, checkpoint, config)
    with locked(path) if trains else contextlib.nullcontext():
        run = read_run(path)
    assert run.state == state
    assert run.samples == max(steps, checkpoint)


def test_a_run_that_has_just_failed_says_why(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", ["rho=-1"], config=False)
    (path / FAILURE).write_text("'rho' must be above 0")
    assert (read_run(path).state, read_run(path).problem) == ("failed", "'rho' must be above 0")


def test_the_log_has_the_numbers_of_the_file_and_nan_where_a_cell_is_empty(tmp_path: Path) -> None:
    write_log(tmp_path / "progress.csv", [16, 32, 48], a__b=[0.1, "", 1e-9], c=[1, 2, 3])
    with (tmp_path / "progress.csv").open("a") as file:
        file.write("\n")
    log = read_log(tmp_path / "progress.csv")
    np.testing.assert_array_equal(log[STEP_COLUMN], [16, 32, 48])
    np.testing.assert_array_equal(log["a/b"], [0.1, np.nan, 1e-9])


def test_a_log_that_is_none_is_a_sentence(tmp_path: Path) -> None:
    write_log(tmp_path / "progress.csv", [16], a=["many"])
    with pytest.raises(ValueError, match=r"progress.csv: not readable as a log of numbers"):
        read_log(tmp_path / "progress.csv")


def test_the_final_value_is_the_mean_of_the_last_rows(tmp_path: Path) -> None:
    run = read_run(make_run(tmp_path / "run", [], steps=1000))
    assert run.final("episode/return") == np.mean([600, 700, 800, 900, 1000])
    assert np.isnan(run.final("episode/level"))


def test_the_time_of_a_training_leaves_out_pauses_and_what_was_trained_again(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", [])
    assert read_run(path).seconds == 0.0
    # stopped after 30 s, when 25 s were logged; the clock of the log begins anew where it went on
    write_log(path / "progress.csv", [1, 2, 3, 4, 5], time__time_elapsed=[10.0, 25.0, 8.0, "", 20.0])
    assert read_run(path).seconds == pytest.approx(25.0 + 20.0)


@pytest.mark.parametrize(
    ("samples", "text"), [(0, "0"), (512, "512"), (30_000, "30.0k"), (1_563_648, "1.56M"), (16_001_024, "16.0M")]
)
def test_samples_are_written_as_people_say_them(samples: int, text: str) -> None:
    assert samples_text(samples) == text
