"""Trackers follow progress.csv: every row once, whatever happened to the tracker or to the training."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any

import pytest
from stable_baselines3.common.logger import Logger

from ogmp_sb3.runs.logs import STEP_COLUMN, TensorBoardWriter
from ogmp_sb3.runs.run_directory import MULTIRUN
from ogmp_sb3.runs.tracker_runs import RUNS, TrackedTraining
from ogmp_sb3.runs.trackers import check_installed, end_with, group_of, make_logger

SUMMARY = {"final/return": 5.0}


class Server:
    """What a tracker holds, which outlives the process of a training; it can be gone."""

    def __init__(self) -> None:
        self.runs: dict[str, dict[str, Any]] = {}
        self.gone = False
        self.asked = 0

    def ask(self) -> None:
        self.asked += 1
        if self.gone:
            raise ConnectionError("no route to host.\nCaused by many things.")


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Server:
    """In place of Weights & Biases."""
    server = Server()

    class Run:
        def begin(self, training: TrackedTraining, known: dict[str, str]) -> dict[str, str]:
            server.ask()
            known = known or {"id": f"run{len(server.runs)}"}
            self.run = server.runs.setdefault(known["id"], {"settings": training.settings, "rows": [], "ends": []})
            return known

        def log(self, numbers: dict[str, float], samples: int) -> None:
            server.ask()
            self.run["rows"].append((samples, numbers))

        def finish(self, summary: dict[str, float] | None, samples: int) -> None:
            server.ask()
            self.run["ends"].append((samples, summary))

    monkeypatch.setitem(RUNS, "wandb", Run)
    return server


def training(folder: Path) -> TrackedTraining:
    return TrackedTraining(folder=folder, task="dive", group="dive", settings={"task": {"rho": 0.5}})


def logger(folder: Path, resumed_at: int | None = None, *names: str) -> Logger:
    return make_logger(names or ("wandb",), training(folder), resumed_at)


def write(writer: Logger, *steps: int) -> None:
    """Rows that a training would write, each with its step as a value."""
    for step in steps:
        writer.record("a", float(step))
        writer.record(STEP_COLUMN, step)
        writer.dump(step)


def steps(server: Server, run: str = "run0") -> list[int]:
    rows = server.runs[run]["rows"]
    assert all(numbers == {"a": samples, STEP_COLUMN: samples} for samples, numbers in rows)
    return [samples for samples, _ in rows]


def test_a_finished_run_has_its_settings_every_row_and_the_summary(tmp_path: Path, server: Server) -> None:
    log = logger(tmp_path)
    write(log, 16, 32)
    end_with(log, SUMMARY)
    log.close()
    assert server.runs == {
        "run0": {
            "settings": {"task": {"rho": 0.5}},
            "rows": [(16, {"a": 16.0, STEP_COLUMN: 16.0}), (32, {"a": 32.0, STEP_COLUMN: 32.0})],
            "ends": [(32, SUMMARY)],
        }
    }
    assert json.loads((tmp_path / "trackers.json").read_text()) == {"wandb": {"id": "run0", "samples": 32}}


def test_a_resumed_training_goes_on_with_its_run_and_sends_no_row_twice(tmp_path: Path, server: Server) -> None:
    write(logger(tmp_path), 16, 32, 48)  # killed here; its last checkpoint is of sample 20
    log = logger(tmp_path, 20)
    write(log, 32, 48, 64)
    log.close()
    assert steps(server) == [16, 32, 48, 64]
    assert server.runs["run0"]["ends"] == [(64, None)]


def test_one_that_is_stopped_before_its_first_checkpoint_keeps_its_run(tmp_path: Path, server: Server) -> None:
    write(logger(tmp_path), 16, 32)
    write(logger(tmp_path), 16, 32, 48)
    assert steps(server) == [16, 32, 48]


def test_a_tracker_that_is_added_later_gets_the_rows_before_it(tmp_path: Path, server: Server) -> None:
    logger(tmp_path, None, "tensorboard").close()
    log = logger(tmp_path, None, "tensorboard")
    write(log, 16, 32, 48)
    log.close()
    write(logger(tmp_path, 40, "tensorboard", "wandb"), 48)
    assert steps(server) == [16, 32, 48]


def test_rows_that_a_tracker_could_not_take_come_later_and_it_is_said_once(tmp_path: Path, server: Server) -> None:
    log = logger(tmp_path)
    write(log, 16)
    server.gone = True
    with pytest.warns(
        UserWarning,
        match=r"^wandb: cannot be written to \(no route to host\); the training goes on, and tries again later\.$",
    ) as said:
        write(log, *range(32, 800, 16))
    assert len(said) == 1
    assert server.asked < 12  # it is not waited for at every row
    server.gone = False
    write(log, *range(800, 3200, 16))
    log.close()
    assert steps(server) == list(range(16, 3200, 16))


def test_what_a_tracker_never_took_is_said_at_the_end_and_sent_when_the_run_goes_on(
    tmp_path: Path, server: Server
) -> None:
    log = logger(tmp_path)
    write(log, 16)
    server.gone = True
    with pytest.warns(UserWarning):
        write(log, 32, 48)
    with pytest.warns(UserWarning, match=r"^wandb: could not be told of the end \(no route to host\); what .*csv,"):
        log.close()
    with pytest.warns(UserWarning, match="cannot be written to"):
        log = logger(tmp_path, 48)
    server.gone = False
    write(log, 64, 80)
    log.close()
    assert steps(server) == [16, 32, 48, 64, 80]


def test_a_tracker_that_is_not_there_at_the_beginning_is_a_sentence(tmp_path: Path, server: Server) -> None:
    server.gone = True
    with pytest.raises(ValueError, match=r"^'logger': wandb could not begin a run \(no route to host\)\. To train "):
        logger(tmp_path)


def test_where_one_tracker_cannot_begin_the_others_are_closed(
    tmp_path: Path, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[str] = []
    monkeypatch.setattr(TensorBoardWriter, "close", lambda self: closed.append(self.folder.name))
    server.gone = True
    with pytest.raises(ValueError, match="wandb could not begin a run"):
        logger(tmp_path, None, "tensorboard", "wandb")
    assert closed == [tmp_path.name]


def test_numbers_that_are_none_are_sent_and_empty_cells_are_not(tmp_path: Path, server: Server) -> None:
    log = logger(tmp_path, None, "tensorboard")
    log.record(STEP_COLUMN, 16)
    log.record("a", math.nan)
    log.dump(16)
    write(log, 32)
    log.record("b", 1)
    write(log, 48)
    log.close()
    logger(tmp_path, 48).close()
    rows = server.runs["run0"]["rows"]
    assert math.isnan(rows[0][1].pop("a"))
    assert [set(numbers) for _, numbers in rows] == [{STEP_COLUMN}, {STEP_COLUMN, "a"}, {STEP_COLUMN, "a", "b"}]


@pytest.mark.parametrize(
    "content", ["", "[]", "{", '{"wandb": 3}', '{"wandb": {"id": [1]}}', '{"wandb": {"samples": "many"}}']
)
def test_a_damaged_note_is_a_sentence(content: str, tmp_path: Path, server: Server) -> None:
    (tmp_path / "trackers.json").write_text(content)
    with pytest.raises(ValueError, match=r"trackers\.json") as caught:
        logger(tmp_path)
    assert "\n" not in str(caught.value)


def test_without_trackers_there_is_progress_csv_alone(tmp_path: Path) -> None:
    log = make_logger((), training(tmp_path), None)
    write(log, 16)
    log.close()
    assert [path.name for path in tmp_path.iterdir()] == ["progress.csv"]
    log = make_logger(("tensorboard",), training(tmp_path), None)
    assert isinstance(log.output_formats[1], TensorBoardWriter)
    log.close()


def test_a_missing_library_is_a_sentence_that_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    check_installed(["tensorboard"])
    with pytest.raises(ValueError, match=r"^'logger' is mlflow, .* missing: pip install \"ogmp_sb3\[mlflow\]\"\.$"):
        check_installed(["tensorboard", "mlflow"])


def test_jobs_of_a_sweep_are_grouped_by_it_and_other_runs_by_their_task(tmp_path: Path) -> None:
    sweep = tmp_path / "experiments" / "rho"
    sweep.mkdir(parents=True)
    (sweep / MULTIRUN).touch()
    assert group_of(sweep / "task.robot=a" / "b" / "rho=0.5", "dive") == "experiments/rho"
    assert group_of(tmp_path / "dive" / "now", "dive") == "dive"


def test_a_full_disk_keeps_no_row_from_a_tracker(tmp_path: Path, server: Server, monkeypatch) -> None:
    log = logger(tmp_path)
    monkeypatch.setattr("ogmp_sb3.runs.trackers.save_json", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write(log, 16, 32)
    assert steps(server) == [16, 32]
