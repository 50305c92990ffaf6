"""Where the log of a training goes beside ``progress.csv``: TensorBoard, Weights & Biases, MLflow, Trackio.

``progress.csv`` is the log; a tracker follows it. So a tracker has every row once: rows that it was sent before a kill
are not sent again, those that it could not take come with the next one, and one that is added when a run goes on gets
the rows before it, too.
"""

from __future__ import annotations

import contextlib
import importlib.util
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter, Logger

from ogmp_sb3.config.messages import Where, first_line
from ogmp_sb3.config.strict import read
from ogmp_sb3.runs.logs import STEP_COLUMN, CsvWriter, TensorBoardWriter
from ogmp_sb3.runs.run_directory import LOG, MULTIRUN, TRACKERS
from ogmp_sb3.runs.settings import TENSORBOARD
from ogmp_sb3.runs.storage import load_json, save_json
from ogmp_sb3.runs.tracker_runs import RUNS, TrackedTraining, TrackerRun

DEEPEST = 4  # directories between a multirun and its jobs
MOST = 64  # rows between two tries to reach a tracker


def check_installed(names: Iterable[str]) -> None:
    """:raises ValueError: naming the extra, if the library of a tracker is not installed"""
    for name in names:
        if name != TENSORBOARD and importlib.util.find_spec(name) is None:
            raise ValueError(f"'logger' is {name}, whose package is missing: pip install \"ogmp_sb3[{name}]\".")


def make_logger(names: Iterable[str], training: TrackedTraining, resumed_at: int | None) -> Logger:
    """The logger of a training.

    :param names: of trackers
    :param resumed_at: samples of the checkpoint that it goes on from; None: it begins
    :raises ValueError: if a tracker cannot begin a run for a training that begins
    """
    table = CsvWriter(training.folder / LOG, resumed_at or 0)
    writers: list[KVWriter] = [table]
    for name in names:
        try:
            writers.append(_writer(name, training, table, resumed_at))
        except (ValueError, OSError):
            Logger(None, writers).close()
            raise
    return Logger(folder=str(training.folder), output_formats=writers)


def _writer(name: str, training: TrackedTraining, table: CsvWriter, resumed_at: int | None) -> KVWriter:
    if name == TENSORBOARD:
        return TensorBoardWriter(training.folder, resumed_at or 0)
    writer = TrackerWriter(name, RUNS[name](), training, table)
    writer.begin(must=resumed_at is None)
    return writer


def end_with(logger: Logger, summary: dict[str, float]) -> None:
    """Have trackers show a training as finished when the logger is closed.

    :param summary: final numbers
    """
    for writer in logger.output_formats:
        if isinstance(writer, TrackerWriter):
            writer.summary = summary


def group_of(run_dir: Path, task: str) -> str:
    """What a run is grouped with: the last two names of its multirun's directory, or the task of one that is alone."""
    above = run_dir.absolute().parents[:DEEPEST]
    return next(("/".join(folder.parts[-2:]) for folder in above if (folder / MULTIRUN).is_file()), task)


class TrackerWriter(KVWriter):
    """Sends the rows of ``progress.csv`` to a tracker. One that fails is tried again with later rows, ever more rarely.

    :param name: of the tracker
    :param run: in the tracker
    :param training: that the run is of
    :param table: ``progress.csv``, which is written first
    """

    def __init__(self, name: str, run: TrackerRun, training: TrackedTraining, table: CsvWriter) -> None:
        self.name, self.run, self.training, self.table = name, run, training, table
        self.summary: dict[str, float] | None = None
        self.file = training.folder / TRACKERS
        known = _known(self.file, name)
        self.known = {key: str(value) for key, value in known.items() if key != "samples"}
        self.samples = int(known.get("samples", 0))  # of the last row that was sent
        self.begun = self.warned = False
        self.wait, self.waited = 1, 0  # rows until the next try, and since the last

    def begin(self, must: bool) -> None:
        """Begin the run in the tracker.

        :raises ValueError: if that fails, and it must not
        """
        try:
            self._send()
        except Exception as error:
            if must:
                text = f"'logger': {self.name} could not begin a run ({first_line(error)})."
                raise ValueError(f"{text} To train without it: logger=null, or another tracker.") from None
            self._failed(error)

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        self.waited += 1
        if self.waited < self.wait:
            return
        try:
            self._send()
        except Exception as error:  # whatever a library raises: the training is worth more
            self._failed(error)

    def close(self) -> None:
        try:
            self._send()
            self.run.finish(self.summary, self.samples)
        except Exception as error:
            text = f"{self.name}: could not be told of the end ({first_line(error)}); what it has not got yet is in"
            warnings.warn(f"{text} {self.table.path}, and is sent when the run goes on.", stacklevel=1)

    def _send(self) -> None:
        """Send what is left, after the run was begun."""
        if not self.begun:
            self.known = self.run.begin(self.training, self.known)
            self.begun = True
            self._keep()
        for row in self._left():
            self.run.log({key: float(value) for key, value in row.items() if value not in ("", None)}, _samples(row))
            self.samples = _samples(row)
            self._keep()
        self.wait, self.waited = 1, 0

    def _left(self) -> list[dict[str, Any]]:
        """The rows that were not sent yet."""
        return [row for row in self.table.rows if _samples(row) > self.samples]

    def _keep(self) -> None:
        """Note which run this is, and which of its rows was sent last."""
        with contextlib.suppress(OSError):  # of a full disk progress.csv warns
            data = load_json(self.file) if self.file.is_file() else {}
            save_json(self.file, {**data, self.name: {**self.known, "samples": self.samples}})

    def _failed(self, error: Exception) -> None:
        if not self.warned:
            text = (
                f"{self.name}: cannot be written to ({first_line(error)}); the training goes on, and tries again later."
            )
            warnings.warn(text, stacklevel=1)
        self.warned = True
        self.wait, self.waited = min(2 * self.wait, MOST), 0


def _known(file: Path, name: str) -> dict[str, Any]:
    """What is noted of the run in a tracker; empty if there is none yet.

    :raises ValueError: if the file is damaged
    """
    data = load_json(file) if file.is_file() else {}
    try:
        known = read(dict[str, str | int], data.get(name, {}), Where(str(file), name))
        read(int, known.get("samples", 0), Where(str(file), f"{name}.samples"))
    except TypeError as error:
        raise ValueError(str(error)) from None
    return known


def _samples(row: dict[str, Any]) -> int:
    return int(float(row[STEP_COLUMN]))
