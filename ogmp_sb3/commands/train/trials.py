"""The trials of a search on rungs, in a study of Optuna's that goes on where it stopped.

Optuna ends a trial that is pruned for good. Here its training goes on when it is promoted: a trial of the same values,
which has the scores of the rungs below already. What is drawn depends on the study alone, so that a search that was
killed and goes on draws what it would have drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ogmp_sb3.commands.train.rungs import Pruner, budgets, goes_on
from ogmp_sb3.commands.train.space import Space, Values
from ogmp_sb3.commands.train.sweeper import ANOTHER
from ogmp_sb3.config.strict import check_range

FILE, NAME = "study.journal", "search"  # in the directory of a search: the file and the study in it
SETTINGS = "settings"  # attribute of a study: what it was begun with
GOES_ON = "goes_on"  # attribute of a trial: it goes on with the training of one of this name
MOST = 100_000  # trials and rungs; more is a slip of the pen
REPEATS = 100  # draws in a row of what was tried, after which there is nothing else


@dataclass(frozen=True, kw_only=True)
class SearchConfig:
    """Settings of a search: ``hydra.sweeper``."""

    n_trials: int = 20
    """values to try"""
    n_jobs: int = 1
    """trials that train at once, on a launcher that can"""
    sampler: Literal["tpe", "random"] = "tpe"
    """what draws values: a tree-structured Parzen estimator, which learns from the scores, or chance alone"""
    pruner: Pruner | None = "halving"
    """which trials stop at a rung: halving, hyperband or median; null: none"""
    rungs: int = 3
    """how often a trial is compared; at the last it has trained total_timesteps"""
    reduction: int = 4
    """each rung has so many times the samples of the one before; of halving, one trial in so many goes on"""
    episodes: int = 32
    """of the test protocol, to compare trials by"""
    seed: int = 0
    """of what is drawn"""

    def __post_init__(self) -> None:
        for name in ("n_trials", "n_jobs", "rungs", "episodes"):
            check_range(name, getattr(self, name), 1, MOST)
        check_range("reduction", self.reduction, 2, MOST)
        check_range("seed", self.seed, 0, 2**31)


class Trials:
    """What a search has tried, and what it tries next.

    :param folder: of the search; a study that is there goes on
    :param space: what values are drawn from
    :param config: how
    :param total: samples at the last rung
    :raises ValueError: if another search is there, the file cannot be read, or the samples are too few
    """

    def __init__(self, folder: Path, space: Space, config: SearchConfig, total: int) -> None:
        self.space, self.config = space, config
        self.budgets = budgets(total, config.rungs if config.pruner else 1, config.reduction)
        self.values: dict[str, Values] = {}
        """by name, in the order they were drawn"""
        self.scores: dict[str, list[float]] = {}
        """by name, one for each rung that was reached"""
        self._combinations = space.combinations()
        self._failed: set[str] = set()  # since the search began, or went on
        self._study = _study(folder / FILE, self._settings())
        self._again = self._take_up()

    def _settings(self) -> dict[str, Any]:
        """What cannot change when a search goes on."""
        names = ("sampler", "pruner", "reduction", "episodes", "seed")
        return {**self.space.plain(), "samples": self.budgets, **{name: getattr(self.config, name) for name in names}}

    def _take_up(self) -> list[str]:
        """Learn what the study has.

        :return: those that did not end, or failed: they begin again
        """
        from optuna.trial import TrialState

        ended = set()
        for trial in self._study.get_trials(deepcopy=False):
            if trial.state == TrialState.WAITING:
                self._study.tell(self._study.ask(), state=TrialState.FAIL)
                continue
            if trial.state == TrialState.RUNNING:
                self._study.tell(trial.number, state=TrialState.FAIL)
            if trial.params.keys() != self.space.searched.keys():
                continue  # it was killed while it was drawn
            name = self.space.name(trial.params)
            self.values.setdefault(name, trial.params)
            reached = [trial.intermediate_values[step] for step in sorted(trial.intermediate_values)]
            self.scores[name] = max(self.scores.get(name, []), reached, key=len)
            if trial.state in (TrialState.PRUNED, TrialState.COMPLETE):
                ended.add(name)
        return [name for name in self.values if name not in ended]

    def filled(self, active: Mapping[str, Any]) -> dict[str, Any]:
        """The trials to train now, by name: those under way and, as far as there is room, others."""
        trials = dict(active)
        while len(trials) < self.config.n_jobs:
            following = self._following(trials)
            if following is None:
                break
            name, trial = following
            trials[name] = trial
        return trials

    def budget(self, name: str) -> int:
        """Samples of the rung that a trial trains to next."""
        return self.budgets[len(self.scores[name])]

    def report(self, name: str, trial: Any, score: float) -> None:
        """Note the score of the rung that a trial has reached."""
        trial.report(score, self.budget(name))
        self.scores[name].append(score)

    def fail(self, name: str, trial: Any) -> None:
        """End a trial whose training failed: it is out, and others take its place."""
        self._failed.add(name)
        self._drop(trial)

    def _drop(self, trial: Any) -> None:
        """End a trial of which nothing is to be learned."""
        from optuna.trial import TrialState

        self._study.tell(trial, state=TrialState.FAIL)

    def settled(self, name: str, trial: Any) -> bool:
        """End a trial at its rung if it is the last, or if others are better; whether it ended."""
        from optuna.trial import TrialState

        scores = self.scores[name]
        if len(scores) == len(self.budgets):
            self._study.tell(trial, scores[-1])
        elif scores and not self._goes_on(name):
            self._study.tell(trial, state=TrialState.PRUNED)
        else:
            return False
        return True

    def _goes_on(self, name: str, at_least_one: bool = False) -> bool:
        config = self.config
        scores = {other: reached for other, reached in self.scores.items() if other not in self._failed}
        return goes_on(config.pruner, scores, name, len(self.budgets), config.reduction, at_least_one)

    def _following(self, running: Mapping[str, Any]) -> tuple[str, Any] | None:
        """One more trial: of those to begin again, promoted, or new; None if there is none."""
        while self._again:
            name = self._again.pop(0)
            trial = self._ask(name)
            if not self.settled(name, trial):
                return name, trial
        full = len(self.values) >= min(self.config.n_trials, len(self._combinations or range(MOST)))
        name = self._promoted(running, at_least_one=full and not running)
        if name:
            return name, self._ask(name, {GOES_ON: name})
        return None if full else self._new()

    def _promoted(self, running: Mapping[str, Any], at_least_one: bool) -> str:
        """The candidate that stopped and would go on by now: of the highest rung, the best; empty for none."""
        stopped = [
            name
            for name, scores in self.scores.items()
            if 0 < len(scores) < len(self.budgets)
            and name not in running
            and name not in self._failed
            and self._goes_on(name, at_least_one)
        ]
        return max(stopped, key=lambda name: (len(self.scores[name]), self.scores[name][-1]), default="")

    def _new(self) -> tuple[str, Any] | None:
        """A trial of values that were not tried yet; None if none are found."""
        for attempt in range(REPEATS):
            generator = np.random.default_rng([self.config.seed, len(self.values), attempt])
            trial = self._drawn(int(generator.integers(2**31)))
            name = self.space.name(trial.params)
            if name not in self.values:
                self.values[name], self.scores[name] = trial.params, []
                return name, trial
            self._drop(trial)
            if self._combinations:
                untried = [v for v in self._combinations if self.space.name(v) not in self.values]
                self._study.enqueue_trial(untried[generator.integers(len(untried))])
        return None

    def _drawn(self, seed: int) -> Any:
        """A trial whose values the sampler draws, or that waits."""
        from optuna.samplers import RandomSampler, TPESampler

        several = self.config.n_jobs > 1
        tpe = self.config.sampler == "tpe"
        self._study.sampler = TPESampler(seed=seed, constant_liar=several) if tpe else RandomSampler(seed=seed)
        return self._study.ask(dict(self.space.searched))

    def _ask(self, name: str, attributes: dict[str, Any] | None = None) -> Any:
        """A trial of values that were tried before, with its scores."""
        self._study.enqueue_trial(self.values[name], user_attrs=attributes)
        trial = self._study.ask(dict(self.space.searched))
        for budget, score in zip(self.budgets, self.scores[name], strict=False):
            trial.report(score, budget)
        return trial


def _study(file: Path, settings: dict[str, Any]) -> Any:
    """The study in a file.

    :raises ValueError: if it is of another search, or cannot be read
    """
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        storage = JournalStorage(JournalFileBackend(str(file)))
        study = optuna.create_study(storage=storage, study_name=NAME, direction="maximize", load_if_exists=True)
    except (ValueError, KeyError, TypeError, AssertionError) as error:
        raise ValueError(f"{file}: not readable as a study of Optuna's ({' '.join(str(error).split())}).") from None
    if SETTINGS not in study.user_attrs:
        study.set_user_attr(SETTINGS, settings)
    before = study.user_attrs[SETTINGS]
    for name, value in settings.items():
        if before.get(name) != value:
            raise ValueError(
                f"{file}: of another search: {name!r} is {before.get(name)} there and {value} here. {ANOTHER}"
            )
    return study
