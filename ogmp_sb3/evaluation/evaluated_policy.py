"""A trained policy with its evaluations, which are kept in a file, and its motion traces."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ogmp_sb3.config.scenes import task_for_test
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.streams import Stream
from ogmp_sb3.evaluation.endless import endless
from ogmp_sb3.evaluation.episodes import Progress, play_episodes
from ogmp_sb3.evaluation.evaluate import Evaluation, evaluate, measure
from ogmp_sb3.evaluation.grid import Grid, ModeCell, evaluate_cells, limits
from ogmp_sb3.evaluation.result_cache import ResultCache
from ogmp_sb3.evaluation.statistics import estimates_as_data
from ogmp_sb3.evaluation.traces import Trace, make_trace
from ogmp_sb3.machine import can_write
from ogmp_sb3.runs.policies import LoadedPolicy
from ogmp_sb3.runs.settings import RECORDED, versions

RESULTS = Path("evaluation") / "results.jsonl"
METRICS = Path("evaluation") / "metrics.json"  # what ogmp-eval leaves there
Protocol = tuple[str, float | None]  # name, and the distance along the track at which an episode ends, m
PAPER: Protocol = ("paper", None)
KEPT = 2  # what is kept of an evaluation; 1: not the numbers of each episode, nor in which modes robots fell
NOT_DECIDING = {"python", "machine", *RECORDED} - {"ogmp_sb3", "mujoco"}  # the versions of plug-ins are


class EvaluatedPolicy:
    """A trained policy and its evaluations.

    :param loaded: the policy
    :param overrides: of the task, ``key=value``
    :param folder: where its results are kept: the run directory, or another one for a policy without a run
    :param spare: where new results are kept if nothing can be written in ``folder``
    """

    def __init__(self, loaded: LoadedPolicy, overrides: list[str], folder: Path, spare: Path | None = None) -> None:
        self.loaded = loaded
        self.overrides = overrides
        self.task = self._task([])
        self._folder = folder
        kept = folder / RESULTS
        elsewhere = spare is not None and not _can_append(kept)
        self._results = ResultCache(spare / RESULTS, kept) if spare and elsewhere else ResultCache(kept)
        self._settings = {"policy": loaded.digest, "versions": _deciding(versions()), "overrides": overrides}

    @property
    def samples(self) -> int | None:
        """Samples the policy was trained on, if it says so."""
        return self.loaded.info.get("num_timesteps")

    def evaluation(self, episodes: int, seed: int, progress: Progress, stream: Stream = "test") -> Evaluation:
        """The evaluation under the task's test protocol: kept, left by ``ogmp-eval``, or measured now.

        The return is always among the metrics.
        """

        def play() -> Evaluation:
            return evaluate(self.loaded, self._test(), episodes, seed, progress, stream)

        left = PAPER if stream == "test" else None
        return self._kept(self._asked(episodes, seed, stream), left, play)

    def evaluation_steps(self, episodes: int, seed: int) -> int:
        """How many control steps :meth:`evaluation` takes at most: none if it is known."""
        known = self._is_known(self._asked(episodes, seed, "test"), PAPER)
        return 0 if known else episodes * self.task.evaluation.episode_steps

    def endless(self, episodes: int, seed: int, max_distance: float, progress: Progress) -> Evaluation:
        """The evaluation on tracks without end: kept, left by ``ogmp-eval``, or measured now.

        :param max_distance: an episode also ends this far along the track, m
        """
        task = endless(self._test(), max_distance)

        def play() -> Evaluation:
            return measure(task, play_episodes(self.loaded, task, episodes, seed, max_distance, progress))

        return self._kept(self._asked_endless(episodes, seed, max_distance), ("endless", max_distance), play)

    def endless_steps(self, episodes: int, seed: int, max_distance: float) -> int:
        """How many control steps :meth:`endless` takes at most: none if it is known."""
        known = self._is_known(self._asked_endless(episodes, seed, max_distance), ("endless", max_distance))
        return 0 if known else episodes * endless(self._test(), max_distance).episode_steps

    def _kept(self, settings: dict[str, Any], left: Protocol | None, play: Callable[[], Evaluation]) -> Evaluation:
        """An evaluation: kept under its settings, else left by ``ogmp-eval``, else measured now.

        :param left: what ``ogmp-eval`` may have left it under; None: it never does
        :param play: measures it
        """

        def compute() -> dict[str, Any]:
            return (self._evaluated(settings, left) or play()).as_data()

        return Evaluation.from_data(self._results.remember(settings, compute))

    def _is_known(self, settings: dict[str, Any], left: Protocol | None) -> bool:
        return settings in self._results or self._evaluated(settings, left) is not None

    def grids(self, grids: Sequence[Grid], episodes: int, seed: int, progress: Progress) -> list[dict[str, Any]]:
        """The metrics over grids of mode parameters, as in ``grid.json``; of every cell they are kept as soon as known.

        :param episodes: of each cell
        """
        unknown = self._unknown_cells(grids, episodes, seed)
        measured = evaluate_cells(self.loaded, self._test(), unknown, episodes, seed, progress)
        for cell, metrics in zip(unknown, measured, strict=True):
            self._results.keep(self._asked(episodes, seed, "test", cell), estimates_as_data(metrics))
        return [
            grid.as_data([self._results[self._asked(episodes, seed, "test", (grid.mode, cell))] for cell in grid.cells])
            for grid in grids
        ]

    def grids_steps(self, grids: Sequence[Grid], episodes: int, seed: int) -> int:
        """How many control steps :meth:`grids` takes at most: none for cells that are known."""
        return len(self._unknown_cells(grids, episodes, seed)) * episodes * self.task.evaluation.episode_steps

    def _unknown_cells(self, grids: Sequence[Grid], episodes: int, seed: int) -> list[ModeCell]:
        cells = [(grid.mode, cell) for grid in grids for cell in grid.cells]
        return [cell for cell in cells if self._asked(episodes, seed, "test", cell) not in self._results]

    def _asked(self, episodes: int, seed: int, stream: Stream, cell: ModeCell | None = None) -> dict[str, Any]:
        """What the metrics depend on: those of the task, or of a cell of a grid."""
        asked = {**self._settings, "episodes": episodes, "seed": seed, "stream": stream}
        return {**asked, "kept": KEPT} if cell is None else {**asked, "mode": cell[0], "cell": limits(cell[1])}

    def _asked_endless(self, episodes: int, seed: int, max_distance: float) -> dict[str, Any]:
        asked = {"episodes": episodes, "seed": seed, "protocol": "endless", "max_distance": max_distance}
        return {**self._settings, **asked, "kept": KEPT}

    def traces(self, episodes: int, seed: int, title: str = "", overrides: tuple[str, ...] = ()) -> list[Trace]:
        """Motion traces of whole episodes under the test protocol; ``rho`` among the overrides ends them.

        :param title: of the traces; empty for their seeds
        :param overrides: of the task, beside those of the subject
        """
        trained = self._task(list(overrides))
        task = trained.for_evaluation()
        if any(override.startswith("rho=") for override in overrides):
            task = replace(task, rho=trained.rho)
        records = play_episodes(self.loaded, task, episodes, seed)
        return [make_trace(record, trained, title or f"seed {seed + i}") for i, record in enumerate(records)]

    def _task(self, overrides: list[str]) -> TaskConfig:
        """The task as it was in training, with overrides."""
        loaded, overrides = self.loaded, [*self.overrides, *overrides]
        return task_for_test(loaded.task_data, loaded.task_path, overrides, None, "ogmp-report", ("rho",))

    def _test(self) -> TaskConfig:
        """The task under its test protocol, the return among its metrics."""
        metrics = dict.fromkeys((*self.task.evaluation.metrics, "return"))
        return replace(self.task.for_evaluation(), evaluation=replace(self.task.evaluation, metrics=tuple(metrics)))

    def _evaluated(self, asked: dict[str, Any], protocol: Protocol | None) -> Evaluation | None:
        """What ``ogmp-eval`` measured of this policy under the same settings, or None.

        :param protocol: that it may have measured under; None: none
        """
        if protocol is None:
            return None
        try:
            report = json.loads((self._folder / METRICS).read_text(encoding="utf-8"))
            settings = {**report, "versions": _deciding(report["versions"])}
            same = (
                all(settings[key] == value for key, value in self._settings.items())
                and (report["protocol"], report["max_distance"]) == protocol
                and (report["scene"], report["stream"]) == (None, "test")
                and (report["seed"], report["episodes"]) == (asked["seed"], asked["episodes"])
                and "return" in report["metrics"]
                and "values" in report
            )
            return Evaluation.from_data(report) if same else None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None


def _can_append(file: Path) -> bool:
    if not file.exists():
        return can_write(file.parent)
    try:
        file.open("ab").close()
    except OSError:
        return False
    return True


def rank_key(evaluation: Evaluation) -> list[float]:
    """What policies are ranked by: the true objective, then the return, which tells apart those that reach nothing."""
    return [evaluation.metrics[name].mean for name in ("true_objective", "return")]


def _deciding(packages: dict[str, str]) -> dict[str, str]:
    """Of the versions of packages, those that an evaluation depends on."""
    return {name: version for name, version in packages.items() if name not in NOT_DECIDING}
