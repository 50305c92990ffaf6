"""What a training writes for people: progress.csv, TensorBoard, and a progress bar with the time left."""

from __future__ import annotations

import contextlib
import csv
import os
import socket
import sys
import time
import warnings
from io import BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter
from tqdm import tqdm

from ogmp_sb3.env import failed_step as unstable
from ogmp_sb3.files import reason, replacing

STEP_COLUMN = "time/total_timesteps"


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a ``progress.csv``; one that was being written when the machine stopped is left out.

    :raises ValueError: if it holds anything but numbers
    """
    try:
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines()
        reader = csv.DictReader(lines if text.endswith("\n") else lines[:-1])
        if (text.strip() or not text) and STEP_COLUMN not in (reader.fieldnames or ()):
            raise KeyError(STEP_COLUMN)
        rows = list(reader)
        for row in rows:
            for cell in row.values():
                float(cell or "nan")
    except (csv.Error, OSError, ValueError, KeyError, TypeError):
        raise ValueError(f"{path}: not readable as a log of numbers; without that file, a new one is begun.") from None
    return [row for row in rows if row[STEP_COLUMN]]


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
            _warn_of(self.path, error)

    def close(self) -> None:
        if not self._whole:
            with contextlib.suppress(OSError):  # said already
                self._rewrite()

    def _append(self, row: dict[str, Any]) -> None:
        with self.path.open("a", newline="", encoding="utf-8") as file:
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
            _warn_of(self.folder, error)

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


def _warn_of(path: Path, error: OSError) -> None:
    warnings.warn(f"{path}: a row could not be written ({reason(error)}); the training goes on.", stacklevel=3)


def make_logger(folder: Path, resumed_at: int = 0) -> Logger:
    """A logger for one run directory."""
    writers = [CsvWriter(folder / "progress.csv", resumed_at), TensorBoardWriter(folder, resumed_at)]
    return Logger(folder=str(folder), output_formats=writers)


def progress_bar(total: int, unit: str, done: int = 0) -> Any:
    """A bar with the time left; where no terminal is, a line every half minute."""
    interval = 0.5 if sys.stderr.isatty() else 30.0
    return tqdm(total=total, initial=done, unit=unit, unit_scale=True, mininterval=interval, dynamic_ncols=True)


class EpisodeStatistics(BaseCallback):
    """Logs the episodes that ended since the last log: return, length, distance, terms, causes, deviation, level.

    Episodes that began before an earlier fall are counted apart.

    It also decides when a row is written: whenever the samples pass a multiple of ``every``, so that a resumed run
    writes the same rows.

    :param every: samples between two rows
    """

    sums: dict[str, float]
    causes: dict[str, int]
    restarts: dict[str, int]

    def __init__(self, every: int) -> None:
        super().__init__()
        self.every = every
        self._forget()

    def state(self) -> dict[str, Any]:
        """What was counted since the last row, as plain data."""
        return {"sums": self.sums, "causes": self.causes, "restarts": self.restarts}

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on where :meth:`state` was taken."""
        self.sums, self.causes, self.restarts = state["sums"], state["causes"], state["restarts"]

    def _forget(self) -> None:
        self.sums, self.causes = {}, {}
        self.restarts = {"episodes": 0, "survived": 0}

    def _on_step(self) -> bool:
        for i in np.flatnonzero(self.locals["dones"]):
            info = self.locals["infos"][i]
            if "restart" in info:
                self.restarts["episodes"] += 1
                self.restarts["survived"] += int(info["TimeLimit.truncated"])
                continue
            for key, value in info["episode"].items():
                self.sums[key] = self.sums.get(key, 0.0) + value
            self.causes[info["termination"]] = self.causes.get(info["termination"], 0) + 1
        return True

    def _on_rollout_end(self) -> None:
        rollout = self.model.n_steps * self.model.n_envs  # type: ignore[attr-defined]
        if self.num_timesteps // self.every == (self.num_timesteps - rollout) // self.every:
            return
        episodes = sum(self.causes.values())
        names = {"r": "return", "l": "length"}
        for key, total in self.sums.items():
            if key != "t":
                self.logger.record(f"episode/{names.get(key, key)}", total / episodes)
        for cause, count in self.causes.items():
            self.logger.record(f"termination/{cause}", count / episodes)
        restarts = self.restarts["episodes"]
        if restarts:
            self.logger.record("restart/share", restarts / (restarts + episodes))
            self.logger.record("restart/survived", self.restarts["survived"] / restarts)
        self._forget()
        self.model.dump_logs()


class UnstableSteps(BaseCallback):
    """Counts the simulations that failed, and keeps the first of them to be replayed (``ogmp-check unstable=``).

    :param folder: where to keep them, at most :data:`~ogmp_sb3.env.failed_step.MOST`
    :param seed: of environment 0
    :param info: plain data: the task and its file, the versions
    """

    def __init__(self, folder: Path, seed: int, info: dict[str, Any]) -> None:
        super().__init__()
        self.folder, self.seed, self.info = folder, seed, info
        self.count = 0
        self._said = False

    def _on_step(self) -> bool:
        for row in np.flatnonzero(self.locals["dones"]).tolist():
            step = self.locals["infos"][row].get("unstable")
            if step is not None:
                self.count += 1
                self._keep(step, row)
        return True

    def _on_rollout_end(self) -> None:
        self.logger.record("train/unstable_episodes", self.count)

    def _keep(self, step: unstable.UnstableStep, row: int) -> None:
        if len(list(self.folder.glob("*.safetensors"))) >= unstable.MOST:
            return
        file = self.folder / f"{self.num_timesteps:012d}-{row}.safetensors"
        try:
            unstable.save_step(step, file, **self.info, num_timesteps=self.num_timesteps, seed=self.seed + row)
        except OSError as error:
            _warn_of(file, error)
            return
        if not self._said:
            text = f"A simulation failed at step {self.num_timesteps}: its episode ended, the others go on."
            warnings.warn(f"{text} To see why:  ogmp-check unstable={file}", stacklevel=2)
        self._said = True


class ProgressBar(BaseCallback):
    """Samples done, samples per second, time left, and how the episodes go.

    :param total: samples of the whole run
    """

    def __init__(self, total: int) -> None:
        super().__init__()
        self.total = total

    def _on_training_start(self) -> None:
        self.bar = progress_bar(self.total, "sample", self.num_timesteps)

    def _on_step(self) -> bool:
        self.bar.update(self.num_timesteps - self.bar.n)
        return True

    def _on_rollout_end(self) -> None:
        buffer = self.model.ep_info_buffer
        if buffer:
            reward, length = np.mean([e["r"] for e in buffer]), np.mean([e["l"] for e in buffer])
            self.bar.set_postfix_str(f"return {reward:.1f}, length {length:.0f}", refresh=False)

    def _on_training_end(self) -> None:
        self.bar.close()
