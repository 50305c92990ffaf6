"""What a training writes for people: progress.csv, TensorBoard, and a progress bar with the time left."""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

STEP_COLUMN = "time/total_timesteps"


class CsvWriter(KVWriter):
    """``progress.csv``, continued where a resumed run stopped.

    :param path: the file
    :param resumed_at: rows beyond this sample belong to what is run again, and go
    """

    def __init__(self, path: Path, resumed_at: int = 0) -> None:
        self.path = path
        self.rows: list[dict[str, Any]] = []
        if path.is_file() and resumed_at:
            with path.open(newline="", encoding="utf-8") as file:
                self.rows = [row for row in csv.DictReader(file) if float(row[STEP_COLUMN] or 0) <= resumed_at]
        self.columns = list(self.rows[0]) if self.rows else []
        self._rewrite()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        row = {key: value for key, value in key_values.items() if "csv" not in (key_excluded.get(key) or ())}
        self.rows.append(row)
        new = [key for key in row if key not in self.columns]
        if new:
            self.columns = sorted(self.columns + new)
            self._rewrite()
        else:
            with self.path.open("a", newline="", encoding="utf-8") as file:
                csv.DictWriter(file, self.columns).writerow(row)

    def close(self) -> None:
        pass

    def _rewrite(self) -> None:
        temporary = self.path.with_suffix(".csv.tmp")
        with temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self.columns)
            writer.writeheader()
            writer.writerows(self.rows)
        temporary.replace(self.path)


class TensorBoardWriter(TensorBoardOutputFormat):
    """SB3's writer, continued where a resumed run stopped.

    :param folder: where the events go
    :param resumed_at: TensorBoard forgets earlier events beyond this sample, which is run again
    """

    def __init__(self, folder: Path, resumed_at: int = 0) -> None:
        self.writer = SummaryWriter(str(folder), purge_step=resumed_at + 1 if resumed_at else None)
        self._is_closed = False


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

    It also decides when a row is written: whenever the samples pass a multiple of ``every``, so that a resumed run
    writes the same rows.

    :param every: samples between two rows
    """

    def __init__(self, every: int) -> None:
        super().__init__()
        self.every = every
        self.sums: dict[str, float] = {}
        self.causes: dict[str, int] = {}

    def _on_step(self) -> bool:
        for i in np.flatnonzero(self.locals["dones"]):
            info = self.locals["infos"][i]
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
        self.sums, self.causes = {}, {}
        self.model.dump_logs()


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
