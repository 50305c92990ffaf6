"""What the trackers' libraries are told, with a stand-in for each; tests/whole/test_trackers.py has the real ones."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from ogmp_sb3.runs.tracker_runs import MlflowRun, TrackedTraining, TrackioRun, WandbRun

SETTINGS = {"task": {"rho": 0.5, "modes": {"jump": {"h": [0.1, 0.2]}, "pace": {}}}, "train": {"device": "cpu"}}


@pytest.fixture
def training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TrackedTraining:
    for name in ("WANDB_PROJECT", "MLFLOW_TRACKING_URI", "MLFLOW_EXPERIMENT_NAME", "TRACKIO_PROJECT"):
        monkeypatch.delenv(name, raising=False)
    for name in ("WANDB_FINISH_TIMEOUT", "MLFLOW_HTTP_REQUEST_MAX_RETRIES", "MLFLOW_HTTP_REQUEST_TIMEOUT"):
        monkeypatch.setenv(name, "1")
    return TrackedTraining(folder=tmp_path / "seed=1", task="dive", group="experiments/rho", settings=SETTINGS)


def stand_in(name: str, monkeypatch: pytest.MonkeyPatch) -> MagicMock:
    library = MagicMock()
    monkeypatch.setitem(sys.modules, name, library)
    return library


def test_wandb_is_told_of_its_run_its_rows_its_end(training: TrackedTraining, monkeypatch: pytest.MonkeyPatch) -> None:
    wandb = stand_in("wandb", monkeypatch)
    run = WandbRun()
    known = run.begin(training, {})
    (options,) = (call.kwargs for call in wandb.init.call_args_list)
    assert options.pop("settings") is wandb.Settings.return_value
    assert options == {
        "project": "ogmp_sb3",
        "name": "seed=1",
        "group": "experiments/rho",
        "tags": ["dive"],
        "config": SETTINGS,
        "dir": str(training.folder),
        "resume": "allow",
        "id": known["id"],
    }
    run.log({"a": 1.0}, 640)
    wandb.init.return_value.log.assert_called_once_with({"a": 1.0}, step=640)
    run.finish({"final/return": 5.0}, 640)
    wandb.init.return_value.summary.update.assert_called_once_with({"final/return": 5.0})
    wandb.init.return_value.finish.assert_called_once_with(exit_code=0)
    monkeypatch.setenv("WANDB_PROJECT", "mine")
    again = WandbRun()
    assert again.begin(training, known) == known
    assert wandb.init.call_args.kwargs["id"] == known["id"] and wandb.init.call_args.kwargs["project"] == "mine"
    again.finish(None, 640)
    assert wandb.init.return_value.finish.call_args.kwargs["exit_code"] > 0  # it was stopped
    assert WandbRun().begin(training, {}) != known


def mlflow_stand_in(monkeypatch: pytest.MonkeyPatch, uri: str) -> MagicMock:
    mlflow = stand_in("mlflow", monkeypatch)
    mlflow.exceptions.MlflowException = RuntimeError
    mlflow.get_tracking_uri.return_value = uri
    mlflow.entities.Metric.side_effect = lambda key, value, now, step: (key, value, step)
    mlflow.entities.Param.side_effect = lambda key, value: (key, value)
    mlflow.MlflowClient.return_value.create_run.return_value.info.run_id = "r1"
    mlflow.MlflowClient.return_value.get_experiment_by_name.return_value = SimpleNamespace(experiment_id="7")
    return mlflow


def calls(client: MagicMock, argument: str) -> list[Any]:
    return [call.kwargs[argument] for call in client.log_batch.call_args_list if argument in call.kwargs]


def test_mlflow_is_told_of_its_run_its_rows_its_end(training: TrackedTraining, monkeypatch: pytest.MonkeyPatch) -> None:
    mlflow = mlflow_stand_in(monkeypatch, "sqlite:////here/mlflow.db")
    client, run = mlflow.MlflowClient.return_value, MlflowRun()
    known = run.begin(training, {})
    assert known == {"id": "r1", "uri": "sqlite:////here/mlflow.db"}
    client.create_run.assert_called_once_with("7", run_name="seed=1", tags={"task": "dive", "group": "experiments/rho"})
    assert calls(client, "params") == [
        [
            ("task.rho", "0.5"),
            ("task.modes.jump.h", "[0.1, 0.2]"),
            ("task.modes.pace", "{}"),
            ("train.device", "cpu"),
        ]
    ]
    run.log({"episode/a:b": 1.0}, 640)
    run.finish({"final/return": 5.0}, 640)
    assert calls(client, "metrics") == [[("episode/a_b", 1.0, 640)], [("final/return", 5.0, 640)]]
    client.set_terminated.assert_called_once_with("r1", status="FINISHED")
    again = MlflowRun()
    assert again.begin(training, known) == known
    assert mlflow.MlflowClient.call_args.args == ("sqlite:////here/mlflow.db",)
    client.update_run.assert_called_once_with("r1", status="RUNNING")
    again.finish(None, 640)
    assert client.set_terminated.call_args.kwargs == {"status": "KILLED"}
    assert client.create_run.call_count == 1
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://there")
    MlflowRun().begin(training, known)
    assert mlflow.MlflowClient.call_args.args == (None,)  # the variable counts


def test_mlflow_takes_many_settings_in_parts_and_no_password_is_kept(
    training: TrackedTraining, monkeypatch: pytest.MonkeyPatch
) -> None:
    mlflow = mlflow_stand_in(monkeypatch, "http://user:password@there")
    many = TrackedTraining(
        folder=training.folder, task="t", group="g", settings={f"k{i}": "x" * 9000 for i in range(250)}
    )
    assert MlflowRun().begin(many, {}) == {"id": "r1"}
    parts = calls(mlflow.MlflowClient.return_value, "params")
    assert [len(part) for part in parts] == [100, 100, 50]
    assert all(len(value) == 6000 for part in parts for _, value in part)


def test_jobs_that_make_the_experiment_at_the_same_time_share_it(
    training: TrackedTraining, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = mlflow_stand_in(monkeypatch, "sqlite:///a").MlflowClient.return_value
    client.get_experiment_by_name.side_effect = [None, SimpleNamespace(experiment_id="8")]
    client.create_experiment.side_effect = RuntimeError("exists already")
    MlflowRun().begin(training, {})
    assert client.create_run.call_args.args == ("8",)
    client.get_experiment_by_name.side_effect = [None, None]
    with pytest.raises(RuntimeError, match="exists already"):
        MlflowRun().begin(training, {})


def test_trackio_is_told_of_its_run_its_rows_its_end(
    training: TrackedTraining, monkeypatch: pytest.MonkeyPatch
) -> None:
    trackio = stand_in("trackio", monkeypatch)
    trackio.Api.return_value.runs.side_effect = ValueError("no such project")
    run = TrackioRun()
    known = run.begin(training, {})
    expected = {"project": "ogmp_sb3", "name": "seed=1", "group": "experiments/rho", "config": SETTINGS}
    trackio.init.assert_called_once_with(**expected, resume="allow", embed=False)
    run.log({"a": 1.0}, 640)
    run.finish({"final/return": 5.0}, 640)
    rows = [(call.args[0], call.kwargs) for call in trackio.init.return_value.log.call_args_list]
    assert rows == [({"a": 1.0}, {"step": 640}), ({"final/return": 5.0}, {"step": 640})]
    trackio.init.return_value.finish.assert_called_once_with()
    trackio.Api.return_value.runs.side_effect = lambda project: [SimpleNamespace(name="seed=1")]
    assert TrackioRun().begin(training, known) == known
    other = TrackioRun().begin(training, {})["name"]
    assert other != "seed=1" and other.startswith("seed=1-")
