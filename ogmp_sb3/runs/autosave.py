"""Save a training as it goes: checkpoints at intervals and on request, and the best policy."""

from __future__ import annotations

import math
import signal
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from ogmp_sb3.config.messages import Where
from ogmp_sb3.runs.atomic import reason, remove
from ogmp_sb3.runs.callbacks import EpisodeStatistics, UnstableSteps
from ogmp_sb3.runs.checkpoint import copy_policy, load_trainer, policy_weights, save_checkpoint, try_checkpoint
from ogmp_sb3.runs.learner_state import check_numbers
from ogmp_sb3.runs.logs import say
from ogmp_sb3.runs.run_directory import BEST, CHECKPOINTS, checkpoint_dirs, checkpoint_info, entry, tidy_run
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.sb3.policy_average import PolicyAverage
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO

Score = tuple[float, float]
"""By what the best policy is chosen: the curriculum's level in tenths first, then the mean return."""
NOTHING: Score = (-1.0, -1e9)  # below all scores


class StopTraining(Exception):
    """Raised between two updates after a signal to stop."""


class Checkpoints(BaseCallback):
    """Saves between updates: every ``checkpoint_interval`` samples, and when asked to stop.

    :param run_dir: the run directory
    :param config: the run
    :param info: goes into every policy.json
    :param statistics: of the logs, saved with every checkpoint
    :param unstable: counts the simulations that failed, also saved
    :param average: whose weights are those of the policy that is kept; None: the last ones are
    """

    def __init__(
        self,
        run_dir: Path,
        config: TrainConfig,
        info: dict[str, Any],
        statistics: EpisodeStatistics,
        unstable: UnstableSteps,
        average: PolicyAverage | None = None,
    ) -> None:
        super().__init__()
        self.run_dir, self.config, self.info = run_dir, config, info
        self.statistics, self.unstable, self.average = statistics, unstable, average
        self.best, self.best_at = NOTHING, 0  # score, and the samples it was reached at
        self.kept_at: int | None = None  # samples of the last checkpoint that was written
        self.stop_requested = False
        self.then: list[Callable[[], object]] = []  # what is to be done when the training is saved

    def request_stop(self, signum: int, frame: FrameType | None) -> None:
        """Signal handler: finish the update, save, stop."""
        if self.stop_requested:
            raise KeyboardInterrupt
        self.stop_requested = True
        again = "press Ctrl-C" if signum == signal.SIGINT else f"send {signal.Signals(signum).name}"
        say(f"\nStopping after this update; {again} again to quit at once.", sys.stderr)

    def request_save(self, then: Callable[[], object]) -> None:
        """Save after the present update, then call a function."""
        self.then.append(then)

    def hand_on(self) -> None:
        """Call what waits for the training to be saved."""
        while self.then:
            self.then.pop(0)()

    def _on_training_start(self) -> None:
        self.tried_at = self.num_timesteps
        assert isinstance(self.model, RecurrentPPO)
        try:
            try_checkpoint(self.model, self._folder(self.num_timesteps))
        except OSError as error:
            raise ValueError(f"{self.run_dir}: no checkpoint can be written there ({reason(error)}).") from None

    def _on_rollout_start(self) -> None:
        if self.stop_requested:
            raise StopTraining
        if self.then or self.num_timesteps - self.tried_at >= self.config.checkpoint_interval:
            try:
                self.save()
            except OSError as error:
                warnings.warn(
                    f"{self._not_written(error)}; the training goes on, {self._what_is_there()}.", stacklevel=2
                )
            self.hand_on()

    def _on_step(self) -> bool:
        return True

    def save(self) -> None:
        """Write a checkpoint, drop the oldest beyond ``keep_checkpoints``, and keep the best apart.

        :raises OSError: if it cannot be written; then everything before it is still there
        """
        model = self.model
        assert isinstance(model, RecurrentPPO)
        steps, score = model.num_timesteps, _score(model)
        self.tried_at = steps
        best, best_at = (score, steps) if score > self.best else (self.best, self.best_at)
        statistics = {**self.statistics.plain(), "best": best, "best_at": best_at}
        statistics["unstable_episodes"] = self.unstable.count
        info = {**self.info, "num_timesteps": steps, "return": mean_return(model)}
        weights = self.average.weights if self.average else None
        try:
            if steps != self.kept_at:
                save_checkpoint(model, self._folder(steps), info, statistics, weights)
                self.best, self.best_at, self.kept_at = best, best_at, steps
            complete_best(self.run_dir, self.best_at)
        except OSError:
            tidy_run(self.run_dir)
            raise
        for old in checkpoint_dirs(self.run_dir)[: -self.config.keep_checkpoints]:
            remove(old)

    def save_last(self) -> None:
        """Write the checkpoint that a run ends with.

        :raises ValueError: if it cannot be written
        """
        try:
            self.save()
        except OSError as error:
            go_on = f"Make room, then go on with: ogmp-train resume={self.run_dir}"
            raise ValueError(f"{self._not_written(error)}. {go_on}") from None

    def summary(self) -> dict[str, float]:
        """What the training came to: the last and the best policy; without a return that no episode has given yet."""
        level, best = self.best
        returns = {"final/return": mean_return(self.model), "best/return": best}  # type: ignore[arg-type]
        known = {key: value for key, value in returns.items() if value > NOTHING[1]}
        return {"final/samples": self.num_timesteps, "best/samples": self.best_at, "best/level": level, **known}

    def _not_written(self, error: OSError) -> str:
        """What :meth:`save` could not write, and why."""
        failed = self.run_dir / BEST if self.kept_at == self.num_timesteps else self._folder(self.num_timesteps)
        return f"{failed}: not written ({reason(error)})"

    def _what_is_there(self) -> str:
        if self.kept_at == self.num_timesteps:
            return f"the best policy is in {self._folder(self.best_at)}"
        return "there is none yet" if self.kept_at is None else f"the last one is of step {self.kept_at}"

    def restore(self, checkpoint: Path) -> None:
        """Go on from a checkpoint. Newer ones, which are damaged, are set aside; a best policy that a kill has kept
        from being copied is copied.

        :raises ValueError: if the checkpoint is damaged or does not fit
        """
        assert isinstance(self.model, RecurrentPPO)
        statistics, where = load_trainer(self.model, checkpoint), Where(str(checkpoint / "trainer.json"), "statistics")
        entries = {"sums": dict[str, Any], "causes": dict[str, int], "restarts": dict[str, int]}
        counted = {key: entry(statistics, key, kind, where) for key, kind in entries.items()}
        try:
            check_numbers(counted["sums"], where / "sums")
        except TypeError as error:
            raise ValueError(str(error)) from None
        self.statistics.set_plain(counted)
        self.best = entry(statistics, "best", Score, where)
        if self.average is not None:
            self.average.weights = policy_weights(checkpoint)
        counts = {"unstable_episodes": 0, "best_at": 0, **statistics}  # older checkpoints have neither
        self.unstable.count, self.best_at = (entry(counts, key, int, where) for key in ("unstable_episodes", "best_at"))
        self.kept_at = int(checkpoint.name)
        for folder in checkpoint_dirs(self.run_dir):
            if folder.name > checkpoint.name:
                aside = folder.with_name(f"damaged-{folder.name}")
                remove(aside)
                folder.rename(aside)
        complete_best(self.run_dir, self.best_at)

    def _folder(self, steps: int) -> Path:
        return self.run_dir / CHECKPOINTS / f"{steps:012d}"


def complete_best(run_dir: Path, best_at: int) -> None:
    """Copy the best policy out of its checkpoint, unless that was done; a kill or a full disk may have come before it.

    :param best_at: samples of the best policy, as the last checkpoint says
    :raises OSError: if it cannot be written
    """
    checkpoint = run_dir / CHECKPOINTS / f"{best_at:012d}"
    if checkpoint.is_dir() and _samples(run_dir / BEST) != best_at:
        copy_policy(checkpoint, run_dir / BEST)


def _samples(folder: Path) -> Any:
    """The samples of a policy; None if there is none that can be read."""
    try:
        return checkpoint_info(folder).get("num_timesteps")
    except ValueError:
        return None


def mean_return(model: RecurrentPPO) -> float:
    """Mean return of the last episodes; -1e9 before the first one has ended, or where a reward was not finite."""
    returns = [episode["r"] for episode in model.ep_info_buffer or []]
    mean = float(np.mean(returns)) if returns else -1e9
    return mean if math.isfinite(mean) else -1e9


def _score(model: RecurrentPPO) -> Score:
    levels = [episode["level"] for episode in model.ep_info_buffer or []]
    return round(float(np.mean(levels)), 1) if levels else 0.0, mean_return(model)
