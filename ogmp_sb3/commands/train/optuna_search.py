"""A search by Optuna over any keys: values are drawn, train to a rung, are compared, and go on or stop.

It is a sweeper of Hydra's, ``hydra/sweeper=optuna``, and runs its jobs on whatever launcher is chosen. Policies are
compared as by :mod:`ogmp_sb3.commands.train.search`: by the task's true objective, on tracks that no test has.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from hydra.core.override_parser.overrides_parser import OverridesParser
from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.train.command_line import read_by_hydra
from ogmp_sb3.commands.train.search import scored
from ogmp_sb3.commands.train.space import check_space, read_space
from ogmp_sb3.commands.train.start import mistake
from ogmp_sb3.commands.train.sweeper import BUDGET, HOME, SearchSweeper
from ogmp_sb3.commands.train.trials import SearchConfig, Trials
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.evaluation.result_cache import ResultCache
from ogmp_sb3.runs.multirun import SEED, plain_key
from ogmp_sb3.runs.run_directory import read_run

SWEEPER = "hydra/sweeper=optuna"
SCORES = "optuna.jsonl"  # in the directory of the search
TIE = 1e-6  # the most that the return adds to the true objective, to tell apart those that reach the same


def with_folder(arguments: list[str]) -> list[str]:
    """A command line of a search with a directory named after its keys, unless it has one: the same command goes on."""
    if SWEEPER not in arguments or any(argument.startswith("hydra.sweep.dir=") for argument in arguments):
        return arguments
    overrides = [override for argument in arguments if (override := read_by_hydra(argument)) is not None]
    keys = [plain_key(override.key_or_group) for override in overrides if override.is_sweep_override()]
    name = "+".join(sorted(set(keys) - {SEED})) or "nothing"
    return [*arguments, f"hydra.sweep.dir=runs/search/{name}/${{hydra.runtime.choices.task}}"]


class OptunaSweeper(SearchSweeper):
    """Hydra makes it from ``hydra.sweeper``.

    :param params: values of keys, as on the command line, which goes before them
    :param settings: those of :class:`~ogmp_sb3.commands.train.trials.SearchConfig`
    """

    __module__ = HOME

    def __init__(self, params: Mapping[str, str], **settings: Any) -> None:
        super().__init__(params)
        self.settings = settings

    def sweep(self, arguments: list[str]) -> None:
        """Run the search; one that was killed goes on with the same command.

        :param arguments: the command line without what is Hydra's own
        :raises KeyError: for an unknown name in a job
        :raises TypeError: for a setting or a value of the wrong type
        :raises ValueError: if Optuna is missing, a setting is out of range, there is nothing to search, values cannot
            be trained with, or another search is in the directory
        """
        cli.require("optuna", "optuna")
        config = read(SearchConfig, self.settings, Where("ogmp-train", "hydra.sweeper"))
        parser = OverridesParser.create(config_loader=self.hydra_context.config_loader)
        overrides = self._overrides(arguments, parser)
        space = read_space(overrides)
        check_space(space, lambda job: mistake(self.config, job))
        folder = self._folder()
        trials = Trials(folder, space, config, self._total(overrides))
        active: dict[str, Any] = {}
        while active := trials.filled(active):
            scores = self._train(folder, trials, list(active))
            for name, score in scores.items():
                if score is None:
                    trials.fail(name, active.pop(name))
                else:
                    trials.report(name, active[name], score)
            active = {name: trial for name, trial in active.items() if not trials.settled(name, trial)}
        _show(trials)

    def _train(self, folder: Path, trials: Trials, names: list[str]) -> dict[str, float | None]:
        """Train trials to their next rung.

        :return: the score of each, None where a job failed
        """
        known, episodes = ResultCache(folder / SCORES), trials.config.episodes
        jobs = [(name, job) for name in names for job in trials.space.command_lines(trials.values[name])]
        folders = self._launch([[*job, f"{BUDGET}={trials.budget(name)}"] for name, job in jobs])
        scores: dict[str, list[float | None]] = {name: [] for name in names}
        for (name, _), path in zip(jobs, folders, strict=True):
            rank = scored(known, folder, read_run(path), trials.budget(name), episodes) if path else None
            scores[name].append(None if rank is None else objective(*rank))
        return {
            name: None if None in of_seeds else float(np.mean(of_seeds))  # type: ignore[arg-type]
            for name, of_seeds in scores.items()
        }


def objective(reached: float, return_: float) -> float:
    """What a search maximises: the true objective and, for those that reach the same, a little of the return."""
    return reached + TIE * return_ / (1.0 + abs(return_))


def _show(trials: Trials) -> None:
    """A table of the trials, the best first, and the best of those that trained to the end."""
    tried = [name for name, scores in trials.scores.items() if scores]
    if not tried:  # what failed is told when the sweep has ended
        return
    ranked = sorted(tried, key=lambda name: (len(trials.scores[name]), trials.scores[name][-1]), reverse=True)
    table = Table(*map(plain_key, trials.space.searched), title=f"{len(tried)} trials", title_justify="left")
    for name in ("samples", "objective"):
        table.add_column(name, justify="right")
    for name in ranked:
        scores, texts = trials.scores[name], trials.space.texts(trials.values[name])
        values = [text.partition("=")[2] for text in texts]
        table.add_row(*values, f"{trials.budgets[len(scores) - 1]:,}", f"{scores[-1]:.3f}")
    cli.console().print(table)
    seeds, total = len(trials.space.seeds), trials.budgets[-1]
    spent = seeds * sum(trials.budgets[len(trials.scores[name]) - 1] for name in tried)
    best = " ".join(trials.space.texts(trials.values[ranked[0]]))
    print(f"Best: {best}. {spent:,} samples; all trials to the end take {seeds * len(tried) * total:,}.")
