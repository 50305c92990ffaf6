"""What a training counts and shows as it goes: episodes, failed simulations, the time left."""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from ogmp_sb3.env.failed_step import UnstableStep
from ogmp_sb3.runs.failed_steps import MOST, save_step
from ogmp_sb3.runs.logs import say, warn_of

TIMED = 30.0  # s of training by which the time that it takes is estimated


def progress_bar(total: int, unit: str, done: int = 0) -> Any:
    """A bar with the time left; where no terminal is, a line every half minute."""
    return tqdm(total=total, initial=done, unit=unit, unit_scale=True, mininterval=_refresh(), dynamic_ncols=True)


def steps_bar(total: int, title: str = "") -> Any:
    """A bar over the control steps that episodes take at most, with the time left; nothing where there are none.

    The steps of an episode that ends early are done with at once. So the time left is by the mean pace so far, and no
    pace is shown: it would be of steps that nobody has played, too.

    :param total: control steps
    """
    text = "{l_bar}{bar}| {n_fmt}/{total_fmt} control steps [{elapsed}<{remaining}]"
    style: dict[str, Any] = {"bar_format": text, "smoothing": 0.0, "unit_scale": True, "dynamic_ncols": True}
    return tqdm(total=total, desc=title or None, mininterval=_refresh(), disable=total == 0, **style)


def _refresh() -> float:
    """Time between two looks of a bar, s."""
    return 0.5 if sys.stderr.isatty() else 30.0


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

    def plain(self) -> dict[str, Any]:
        """What was counted since the last row, as plain data."""
        return {"sums": self.sums, "causes": self.causes, "restarts": self.restarts}

    def set_plain(self, plain: dict[str, Any]) -> None:
        """Put back what :meth:`plain` gave."""
        self.sums, self.causes, self.restarts = plain["sums"], plain["causes"], plain["restarts"]

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

    def _keep(self, step: UnstableStep, row: int) -> None:
        if len(list(self.folder.glob("*.safetensors"))) >= MOST:
            return
        file = self.folder / f"{self.num_timesteps:012d}-{row}.safetensors"
        try:
            save_step(step, file, **self.info, num_timesteps=self.num_timesteps, seed=self.seed + row)
        except OSError as error:
            warn_of(file, error)
            return
        if not self._said:
            text = f"A simulation failed at step {self.num_timesteps}: its episode ended, the others go on."
            warnings.warn(f"{text} To see why:  ogmp-check unstable={file}", stacklevel=2)
        self._said = True


class Pace(BaseCallback):
    """Says once how long the rest will take, by the pace of the first updates.

    The first update is not counted, for code is compiled and threads are started in it. What follows may be slower or
    faster: a better policy falls less, and other programs come and go.

    :param total: samples of the whole run
    """

    def __init__(self, total: int) -> None:
        super().__init__()
        self.total = total
        self._rollouts = 0
        self._from: tuple[float, int] | None = None  # time (s) and samples that are counted from

    def _on_rollout_start(self) -> None:
        self._rollouts += 1
        if self._rollouts == 2:
            self._from = time.monotonic(), self.num_timesteps
        elif self._from is not None:
            seconds, samples = time.monotonic() - self._from[0], self.num_timesteps - self._from[1]
            if seconds >= TIMED:
                self._from = None
                with tqdm.external_write_mode():
                    say(pace_text(samples / seconds, self.total - self.num_timesteps))

    def _on_step(self) -> bool:
        return True


def pace_text(pace: float, remaining: int) -> str:
    """How long the rest of a training takes.

    :param pace: samples per second
    :param remaining: samples
    """
    minutes = round(remaining / pace / 60.0)
    left = f"{minutes // 60} h {minutes % 60:02} min" if minutes >= 60 else f"{minutes} min" if minutes else "a minute"
    return f"{pace:,.0f} samples/s so far: about {left} for the other {remaining:,}, if the pace stays so."


class ProgressBar(BaseCallback):
    """Samples done, samples per second, time left, and how the episodes go.

    :param total: samples of the whole run
    """

    def __init__(self, total: int) -> None:
        super().__init__()
        self.total = total
        self.bar: Any = None

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
        self.close()

    def close(self) -> None:
        """Leave the line of the bar, also where a mistake has ended the training."""
        if self.bar is not None:
            self.bar.close()
