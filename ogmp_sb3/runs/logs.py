"""What a training writes as it goes: ``progress.csv``, the events of TensorBoard, and what it said, ``train.log``."""

from __future__ import annotations

import contextlib
import csv
import logging
import math
import os
import socket
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedWriter
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from stable_baselines3.common.logger import KVWriter
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from ogmp_sb3.runs.atomic import naming, reason, replacing

STEP_COLUMN = "time/total_timesteps"
LAST_BYTES = 8_192  # of a progress.csv that its last rows are looked for in: some fifteen
TRANSCRIPT = "train.log"  # in a run directory: what was said
LOG = logging.getLogger("ogmp_sb3")


def say(text: str, stream: TextIO | None = None) -> None:
    """Print a sentence, and put it into the transcript if there is one.

    :param stream: where to print; None: the standard output
    """
    print(text, file=stream, flush=True)  # also where it goes into a pipe
    LOG.info(text.strip())


@contextmanager
def transcript(folder: Path) -> Iterator[None]:
    """Write what is said in the body, its warnings and the error that ends it to ``train.log``.

    :param folder: the run directory
    """
    handler = _Transcript(folder / TRANSCRIPT, encoding="utf-8", delay=True)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    show, level, propagate = warnings.showwarning, LOG.level, LOG.propagate

    def showwarning(message: Warning | str, *args: Any, **kwargs: Any) -> None:
        show(message, *args, **kwargs)
        LOG.warning(str(message))

    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    LOG.propagate, warnings.showwarning = False, showwarning  # printed already
    try:
        yield
    except Exception:
        LOG.exception("")
        raise
    finally:
        LOG.propagate, warnings.showwarning = propagate, show
        LOG.setLevel(level)
        LOG.removeHandler(handler)
        handler.close()


class _Transcript(logging.FileHandler):
    """A file that a training can do without."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line."""
        with contextlib.suppress(OSError):  # of a file that cannot be opened
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:
        """Say nothing of a line that finds no room, where Python would show a traceback."""


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a ``progress.csv``; one that was being written when the machine stopped is left out.

    :raises ValueError: if it holds anything but numbers
    """
    with _a_log(path):
        return _rows(path.read_text(encoding="utf-8"))


def last_rows(path: Path) -> list[dict[str, str]]:
    """The last rows of a ``progress.csv``, without reading the others.

    :raises ValueError: if these hold anything but numbers
    """
    with _a_log(path), path.open("rb") as file:
        header = file.readline()
        behind = max(file.seek(0, os.SEEK_END) - LAST_BYTES, len(header))
        file.seek(behind)
        if behind > len(header):
            file.readline()  # the end of a row
        return _rows((header + file.read()).decode("utf-8"))


def _rows(text: str) -> list[dict[str, str]]:
    """The rows of a log, of which the last one may not be whole.

    :raises LookupError: if there is no column of samples
    :raises ValueError: if a cell is no number
    """
    lines = text.splitlines()
    reader = csv.DictReader(lines if text.endswith("\n") else lines[:-1])
    if (text.strip() or not text) and STEP_COLUMN not in (reader.fieldnames or ()):
        raise KeyError(STEP_COLUMN)
    rows = list(reader)
    for row in rows:
        for cell in row.values():
            float(cell or "nan")
    rows = [row for row in rows if row[STEP_COLUMN]]
    if not all(math.isfinite(float(row[STEP_COLUMN])) for row in rows):
        raise ValueError(STEP_COLUMN)
    return rows


@contextmanager
def _a_log(path: Path) -> Iterator[None]:
    """:raises ValueError: with a sentence, if what is read in the body is no log."""
    try:
        yield
    except (csv.Error, OSError, ValueError, KeyError, TypeError):
        raise ValueError(f"{path}: not readable as a log of numbers; without that file, a new one is begun.") from None


class CsvWriter(KVWriter):
    """``progress.csv``, continued where a resumed run stopped. A row that cannot be written waits for the next one.

    :param path: the file
    :param resumed_at: rows beyond this sample belong to what is run again, and go
    """

    def __init__(self, path: Path, resumed_at: int = 0) -> None:
        self.path = path
        self._whole = False
        self.rows: list[dict[str, Any]] = []
        if path.is_file() and resumed_at:
            self.rows = [row for row in read_rows(path) if float(row[STEP_COLUMN]) <= resumed_at]
        self.columns = list(self.rows[0]) if self.rows else []
        self._rewrite()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        row = {key: value for key, value in key_values.items() if "csv" not in (key_excluded.get(key) or ())}
        self.rows.append(row)
        new = [key for key in row if key not in self.columns]
        self.columns = sorted(self.columns + new) if new else self.columns
        try:
            if new or not self._whole:
                self._rewrite()
            else:
                self._append(row)
        except OSError as error:
            self._whole = False  # the file may end in half a row
            warn_of(self.path, error)

    def close(self) -> None:
        if not self._whole:
            with contextlib.suppress(OSError):  # warned of already
                self._rewrite()

    def _append(self, row: dict[str, Any]) -> None:
        with naming(self.path), self.path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self.columns).writerow(row)

    def _rewrite(self) -> None:
        with replacing(self.path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self.columns)
            writer.writeheader()
            writer.writerows(self.rows)
        self._whole = True


class TensorBoardWriter(KVWriter):
    """Numbers for TensorBoard, continued where a resumed run stopped.

    Unlike PyTorch's writer it has no thread of its own, in which a full disk would end as a traceback.

    :param folder: where the events go
    :param resumed_at: TensorBoard forgets earlier events beyond this sample, which is run again
    """

    def __init__(self, folder: Path, resumed_at: int = 0) -> None:
        self.folder = folder
        self._file: BufferedWriter | None = None
        self._open()
        self._add(step=resumed_at + 1, session_log=SessionLog(status=SessionLog.START))

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        summary = Summary()
        for key, value in key_values.items():
            if isinstance(value, int | float | np.number) and "tensorboard" not in (key_excluded.get(key) or ()):
                summary.value.add(tag=key, simple_value=float(value))
        try:
            if self._file is None:
                self._open()
            self._add(step=step, summary=summary)
        except OSError as error:
            self.close()  # nothing can be read behind half an event: go on in another file
            warn_of(self.folder, error)

    def close(self) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            self._file = None

    def _open(self) -> None:
        now = time.time()
        name = f"events.out.tfevents.{int(now):010d}.{socket.gethostname()}.{os.getpid()}.{time.monotonic_ns()}"
        self._file = (self.folder / name).open("wb")
        self._add(file_version="brain.Event:2")

    def _add(self, **content: Any) -> None:
        assert self._file is not None
        RecordWriter(self._file).write(Event(wall_time=time.time(), **content).SerializeToString())
        self._file.flush()


def warn_of(path: Path, error: OSError) -> None:
    """Warn that something was not written, which a training goes on without."""
    warnings.warn(f"{path}: a row could not be written ({reason(error)}); the training goes on.", stacklevel=3)
