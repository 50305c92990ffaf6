"""Trainings that are followed by the real trackers, each without a network; skipped where the library is missing."""

from __future__ import annotations

import importlib.util
import json
import logging
import os
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from helpers.programs import SMALL, program, progress
from ogmp_sb3.runs.run_directory import checkpoint_dirs

COMMAND = ["task=dive", "rho=0.4", *SMALL, "checkpoint_interval=256"]


def train(name: str, folder: Path, samples: int) -> None:
    arguments = [*COMMAND, f"logger=[tensorboard,{name}]", f"total_timesteps={samples}", "hydra.run.dir=run"]
    done = program("train", *arguments, cwd=folder)
    assert done.returncode == 0, done.stderr


def without(name: str) -> pytest.MarkDecorator:
    missing = importlib.util.find_spec(name) is None
    return pytest.mark.skipif(missing, reason=f"needs the package '{name}': the extra '{name}'")


def leveldb_records(log: bytes) -> Iterator[bytes]:
    """The records of a log of LevelDB, whose blocks of 32 KiB no header of a part crosses."""
    place, record = 7, b""
    while place + 7 <= len(log):
        left = 32768 - place % 32768
        if left < 7:
            place += left
            continue
        end = place + 7 + int.from_bytes(log[place + 4 : place + 6], "little")
        record += log[place + 7 : end]
        if log[place + 6] in (1, 4):  # whole, or the last part
            yield record
            record = b""
        place = end


def wandb_records(run: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What lies in the run directory to be synchronised later."""
    from wandb.proto import wandb_internal_pb2

    found: dict[str, Any] = {"steps": [], "ids": set(), "config": {}, "summary": {}}
    for file in sorted(run.glob("wandb/offline-run-*/*.wandb")):
        for data in leveldb_records(file.read_bytes()):
            record = wandb_internal_pb2.Record()
            record.ParseFromString(data)
            if record.HasField("run"):
                found["ids"].add(record.run.run_id)
                found |= {"name": record.run.display_name, "group": record.run.run_group}
                found["config"] |= {item.key: json.loads(item.value_json) for item in record.run.config.update}
            if record.HasField("history"):
                found["steps"].append(record.history.step.num)
            for item in record.summary.update:
                key = item.key or "/".join(item.nested_key)
                found["summary"][key] = json.loads(item.value_json)
    return found


def mlflow_records(run: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    import mlflow

    client = mlflow.MlflowClient(f"sqlite:///{run.parent / 'mlflow.db'}")
    (experiment,) = [e for e in client.search_experiments() if e.name == "ogmp_sb3"]
    (found,) = client.search_runs([experiment.experiment_id])
    history = client.get_metric_history(found.info.run_id, "time/total_timesteps")
    return {
        "steps": sorted(metric.step for metric in history),
        "ids": {found.info.run_id},
        "name": found.info.run_name,
        "group": found.data.tags["group"],
        "config": {"task": {"rho": float(found.data.params["task.rho"])}},
        "summary": found.data.metrics,
        "status": found.info.status,
    }


def trackio_records(run: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    import trackio

    project = os.environ["TRACKIO_PROJECT"]
    found = list(trackio.Api().runs(project))
    database = Path(os.environ["TRACKIO_DIR"]) / f"{project}.db"
    with sqlite3.connect(database) as connection:
        rows = [
            (step, json.loads(metrics)) for step, metrics in connection.execute("SELECT step, metrics FROM metrics")
        ]
        configs = [json.loads(config) for (config,) in connection.execute("SELECT config FROM configs")]
    return {
        "steps": sorted(step for step, metrics in rows if "time/total_timesteps" in metrics),
        "ids": {one.id for one in found},
        "name": found[0].name,
        "group": configs[0]["_Group"],
        "config": configs[0],
        "summary": {key: value for _, metrics in rows for key, value in metrics.items()},
    }


@pytest.fixture(scope="module")
def trackio_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trackio reads the variable once, when it is imported."""
    return tmp_path_factory.mktemp("trackio")


@pytest.fixture(autouse=True)
def offline(tmp_path: Path, trackio_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("TRACKIO_DIR", str(trackio_dir))
    monkeypatch.setenv("TRACKIO_PROJECT", tmp_path.name)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)


Records = Callable[[Path, pytest.MonkeyPatch], dict[str, Any]]


@pytest.mark.parametrize(
    ("name", "records"),
    [
        pytest.param("wandb", wandb_records, marks=without("wandb")),
        pytest.param("mlflow", mlflow_records, marks=without("mlflow")),
        pytest.param("trackio", trackio_records, marks=without("trackio")),
    ],
)
def test_a_training_that_was_cut_short_goes_on_in_the_same_run_with_every_row_once_and_trains_as_without(
    name: str, records: Records, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program("train", *COMMAND, "total_timesteps=768", "logger=null", "hydra.run.dir=plain", cwd=tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("ogmp_sb3.runs.autosave.Checkpoints.save_last", lambda self: None)  # killed before it
        train(name, tmp_path, 384)
    assert [int(folder.name) for folder in checkpoint_dirs(tmp_path / "run")] == [256]
    assert progress(tmp_path / "run")[-1] == 384
    train(name, tmp_path, 768)
    found = records(tmp_path / "run", monkeypatch)
    assert found["steps"] == progress(tmp_path / "run")
    assert len(found["ids"]) == 1
    assert (found["name"], found["group"], found["config"]["task"]["rho"]) == ("run", "dive", 0.4)
    assert found["summary"]["final/samples"] == 768
    assert found.get("status", "FINISHED") == "FINISHED"
    assert logging.getLogger("ogmp_sb3").disabled is False
    with_tracker, plain = (checkpoint_dirs(tmp_path / run)[-1] / "policy.safetensors" for run in ("run", "plain"))
    assert with_tracker.read_bytes() == plain.read_bytes()


@without("trackio")
def test_runs_of_one_name_are_two_in_trackio(tmp_path: Path) -> None:
    import trackio

    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        train("trackio", tmp_path / folder, 128)
    names = [run.name for run in trackio.Api().runs(tmp_path.name)]
    assert len(set(names)) == 2 and all(name.startswith("run") for name in names)


@without("mlflow")
def test_mlflow_goes_on_from_another_directory_and_without_a_server_the_training_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train("mlflow", tmp_path, 256)
    (tmp_path / "elsewhere").mkdir()
    resume = [f"resume={tmp_path / 'run'}", "total_timesteps=384"]
    done = program("train", *resume, cwd=tmp_path / "elsewhere")
    assert done.returncode == 0, done.stderr
    assert mlflow_records(tmp_path / "run", monkeypatch)["steps"][-1] == 384
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    with pytest.warns(UserWarning, match="^mlflow: cannot be written to .* the training goes on"):
        done = program("train", resume[0], "total_timesteps=512", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert int(checkpoint_dirs(tmp_path / "run")[-1].name) == 512
    assert mlflow_records(tmp_path / "run", monkeypatch)["steps"][-1] == 384
