"""The runs that a training has in Weights & Biases, MLflow and Trackio.

Where they are, and who may write there, is said as each of these libraries wants it, by its own environment variables:
``WANDB_MODE``, ``MLFLOW_TRACKING_URI``, ``TRACKIO_SERVER_URL`` and so on.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

T = TypeVar("T")

PROJECT = "ogmp_sb3"  # of runs for which the library's own variable names none
STOPPED = 130  # exit status of a training that was asked to stop
SECONDS = "30"  # that an answer may take where a library would wait for minutes, or at the end for ever
LONGEST = 6000  # characters of a parameter in MLflow
PARAMS, METRICS = 100, 1000  # that MLflow takes at once


@dataclass(frozen=True, kw_only=True)
class TrackedTraining:
    """What a tracker is told of a training."""

    folder: Path
    """the run directory, after which the run is named"""
    task: str
    """its name"""
    group: str
    """the sweep that it belongs to, or the task"""
    settings: dict[str, Any]
    """everything that was set, as plain data: the hyper-parameters"""


class TrackerRun(Protocol):
    """One run in a tracker."""

    def begin(self, training: TrackedTraining, known: dict[str, str]) -> dict[str, str]:
        """Begin the run, or go on with it.

        :param known: what this returned when the run began; empty: it begins
        :return: what finds the run again
        """

    def log(self, numbers: dict[str, float], samples: int) -> None:
        """Write numbers at a step."""

    def finish(self, summary: dict[str, float] | None, samples: int) -> None:
        """End the run.

        :param summary: final numbers; None: the training has stopped before its end
        """


class WandbRun:
    """A run of Weights & Biases; its files are in the run directory."""

    def begin(self, training: TrackedTraining, known: dict[str, str]) -> dict[str, str]:
        os.environ.setdefault("WANDB_FINISH_TIMEOUT", SECONDS)
        import wandb

        known = known or {"id": secrets.token_hex(4)}
        self.run: Any = wandb.init(
            id=known["id"],
            project=os.environ.get("WANDB_PROJECT", PROJECT),
            name=training.folder.name,
            group=training.group,
            tags=[training.task],
            config=training.settings,
            dir=str(training.folder),
            resume="allow",
            settings=wandb.Settings(console="off", quiet=True),
        )
        return known

    def log(self, numbers: dict[str, float], samples: int) -> None:
        self.run.log(numbers, step=samples)

    def finish(self, summary: dict[str, float] | None, samples: int) -> None:
        self.run.summary.update(summary or {})
        self.run.finish(exit_code=STOPPED if summary is None else 0)


class MlflowRun:
    """A run of MLflow."""

    def begin(self, training: TrackedTraining, known: dict[str, str]) -> dict[str, str]:
        os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
        os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", SECONDS)
        import mlflow

        named = "MLFLOW_TRACKING_URI" in os.environ
        self.client = mlflow.MlflowClient(None if named else known.get("uri"))
        if known:
            self.id = known["id"]
            self.client.update_run(self.id, status="RUNNING")
            return known
        tags = {"task": training.task, "group": training.group}
        self.id = self.client.create_run(self._experiment(), run_name=training.folder.name, tags=tags).info.run_id
        for params in _slices([*_params(training.settings).items()], PARAMS):
            self.client.log_batch(self.id, params=[mlflow.entities.Param(*param) for param in params])
        uri = mlflow.get_tracking_uri()
        local = uri.startswith(("sqlite:", "file:"))  # below the directory that the training began in
        return {"id": self.id, **({"uri": uri} if local else {})}

    def _experiment(self) -> str:
        """The experiment that runs are in, made if there is none yet; another job may make it at the same time."""
        import mlflow

        name = os.environ.get("MLFLOW_EXPERIMENT_NAME", PROJECT)
        found = self.client.get_experiment_by_name(name)
        try:
            return str(found.experiment_id if found else self.client.create_experiment(name))
        except mlflow.exceptions.MlflowException:
            found = self.client.get_experiment_by_name(name)
            if found is None:
                raise
            return str(found.experiment_id)

    def log(self, numbers: dict[str, float], samples: int) -> None:
        import mlflow

        now = int(1000 * time.time())
        metrics = [mlflow.entities.Metric(_name(key), value, now, samples) for key, value in numbers.items()]
        for some in _slices(metrics, METRICS):
            self.client.log_batch(self.id, metrics=some)

    def finish(self, summary: dict[str, float] | None, samples: int) -> None:
        if summary:
            self.log(summary, samples)
        self.client.set_terminated(self.id, status="KILLED" if summary is None else "FINISHED")


class TrackioRun:
    """A run of Trackio, which knows runs by their names."""

    def begin(self, training: TrackedTraining, known: dict[str, str]) -> dict[str, str]:
        import trackio

        project = os.environ.get("TRACKIO_PROJECT", PROJECT)
        known = known or {"name": _free_name(training.folder.name, project)}
        self.run: Any = trackio.init(
            project=project,
            name=known["name"],
            group=training.group,
            config=training.settings,
            resume="allow",
            embed=False,
        )
        return known

    def log(self, numbers: dict[str, float], samples: int) -> None:
        self.run.log(numbers, step=samples)

    def finish(self, summary: dict[str, float] | None, samples: int) -> None:
        if summary:
            self.run.log(summary, step=samples)
        self.run.finish()


RUNS: dict[str, type[TrackerRun]] = {"wandb": WandbRun, "mlflow": MlflowRun, "trackio": TrackioRun}


def _free_name(name: str, project: str) -> str:
    """The name for a new run in Trackio: with some digits more if another run has it."""
    import trackio

    try:
        taken = {run.name for run in trackio.Api().runs(project)}
    except ValueError:  # there is no such project yet
        return name
    return f"{name}-{secrets.token_hex(2)}" if name in taken else name


def _params(settings: dict[str, Any], above: str = "") -> dict[str, str]:
    """Nested settings as MLflow takes them: ``{"train.ppo.gamma": "0.97"}``."""
    params: dict[str, str] = {}
    for key, value in settings.items():
        name = f"{above}{key}"
        if isinstance(value, dict) and value:
            params |= _params(value, f"{name}.")
        else:
            params[_name(name)] = (value if isinstance(value, str) else json.dumps(value))[:LONGEST]
    return params


def _name(key: str) -> str:
    """A name that MLflow takes."""
    return re.sub(r"[^\w\-./ ]", "_", key)


def _slices(items: Sequence[T], length: int) -> Iterator[Sequence[T]]:
    return (items[k : k + length] for k in range(0, len(items), length))
