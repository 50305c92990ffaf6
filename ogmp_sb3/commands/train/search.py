"""Successive halving: all values of a key train a little, the better half of them twice as long, and so on.

Karnin, Koren and Somekh, "Almost optimal exploration in multi-armed bandits", ICML 2013. It needs runs that go on
where they stopped, which ours are. Policies are compared by the task's true objective under its test protocol, where
none has a bound: training returns of different bounds cannot be compared. The tracks are neither those of the
trainings nor those of a test.

It is a sweeper of Hydra's, ``hydra/sweeper=halving``, and runs its jobs on whatever launcher is chosen;
``+search=<key>`` is short for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, ValueType
from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.train.sweeper import ANOTHER, BUDGET, HOME, SearchSweeper
from ogmp_sb3.env.streams import Stream
from ogmp_sb3.evaluation.result_cache import ResultCache
from ogmp_sb3.runs.multirun import plain_key
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import Run, read_run

ROUNDS = 4  # how often jobs train and are compared; the last trains total_timesteps, each before it half of the next
EPISODES = 32  # of the test protocol, to compare jobs by
HALVING = {"key": "rho", "rounds": ROUNDS, "episodes": EPISODES}  # the settings of the sweeper
VALUES = {"rho": "0.05,0.1,0.2,0.3,0.4,0.5,0.6,0.8"}  # of keys that a command line need not give values
STREAM: Stream = "selection"  # of its episodes: what is reported of the jobs is measured on others
SCORES = "halving.jsonl"  # in the directory of the search
SHORT = "+search="
SWEEPER = "hydra/sweeper=halving"
SEARCHES = (SWEEPER, "hydra/sweeper=optuna")


def expanded(arguments: list[str]) -> list[str]:
    """A command line with ``+search=<key>`` in Hydra's words; one without stays as it is.

    :raises ValueError: if there are no values to compare
    """
    keys = [plain_key(argument.removeprefix(SHORT)) for argument in arguments if argument.startswith(SHORT)]
    if not keys:
        return arguments
    key = keys[-1]
    rest = [a for a in arguments if a not in ("-m", "--multirun") and not a.startswith(SHORT)]
    given = {plain_key(argument.partition("=")[0]) for argument in rest}
    words = ["-m", "+experiment=sweep", SWEEPER, f"hydra.sweeper.key={key}"]
    if key not in given:
        if key not in VALUES:
            raise ValueError(f"'{SHORT}{key}' needs the values that it compares: {key}=<value>,<value>,...")
        words.append(f"{key}={VALUES[key]}")
    if "hydra.sweep.dir" not in given:
        words.append(f"hydra.sweep.dir=runs/search/{key}/${{hydra.runtime.choices.task}}")
    return [*rest, *words]


class HalvingSweeper(SearchSweeper):
    """Hydra makes it from ``hydra.sweeper``.

    :param key: what varies, e.g. ``rho``; a key of the task with or without ``task.``
    :param rounds: how often jobs train and are compared
    :param episodes: of the test protocol, to compare jobs by
    :param params: values of keys, as on the command line, which goes before them
    """

    __module__ = HOME

    def __init__(self, key: str, rounds: int, episodes: int, params: Mapping[str, str]) -> None:
        super().__init__(params)
        self.key, self.rounds, self.episodes = plain_key(key), rounds, episodes

    def sweep(self, arguments: list[str]) -> None:
        """Run the search; one that was killed goes on with the same command.

        :param arguments: the command line without what is Hydra's own
        :raises ValueError: if there are no values to compare, or not plain ones
        """
        overrides = self._overrides(arguments, OverridesParser.create())
        self._check(overrides)
        total = self._total(overrides)
        grid = self._grid(overrides)
        values = list(dict.fromkeys(value for value, _ in grid))
        folder = self._folder()
        first: list[Run] = []
        for left in reversed(range(self.rounds)):
            budget = total // 2**left
            jobs = self._train([pair for value in values for pair in grid if pair[0] == value], budget)
            if not jobs:  # what failed is told when the sweep has ended
                return
            first = first or [job for of_value in jobs.values() for job in of_value]
            ranked = _ranked(folder, jobs, budget, self.episodes)
            values = [value for _, value in ranked[: max(1, (len(ranked) + 1) // 2)]]
            _show(ranked, len(values), f"after {budget:,} samples, {self.episodes} episodes each")
        spent = sum(read_run(job.path).samples for job in first)
        print(f"Best: {self.key}={values[0]}. {spent:,} samples; the full grid takes {len(first) * total:,}.")

    def _check(self, overrides: Sequence[Override]) -> None:
        """:raises ValueError: if there are no values to compare, or Hydra would have to work them out"""
        for key in (self.key, BUDGET):
            if sum(plain_key(override.key_or_group) == key for override in overrides) > 1:
                raise ValueError(f"'{key}' is given twice.")
        found = [override for override in overrides if plain_key(override.key_or_group) == self.key]
        if not found:
            raise ValueError(f"'{SHORT}{self.key}' needs the values that it compares: {self.key}=<value>,<value>,...")
        if found[-1].value_type not in (ValueType.SIMPLE_CHOICE_SWEEP, ValueType.ELEMENT):
            raise ValueError(
                f"'{self.key}={found[-1].get_value_string()}': a search takes plain values with commas between them, "
                f"e.g. {self.key}=0.1,0.3."
            )

    def _grid(self, overrides: Sequence[Override]) -> list[tuple[str, list[str]]]:
        """The value and the command line of every job, without its samples."""
        varied = [override for override in overrides if plain_key(override.key_or_group) != BUDGET]
        (jobs,) = BasicSweeper.split_arguments(varied, None)
        pairs = [{plain_key(text.partition("=")[0]): text.partition("=")[2] for text in job} for job in jobs]
        return [(pair[self.key], job) for pair, job in zip(pairs, jobs, strict=True)]

    def _train(self, grid: list[tuple[str, list[str]]], samples: int) -> dict[str, list[Run]]:
        """Run jobs on the launcher.

        :param grid: value and command line of each
        :return: the jobs of every value; a value of which one failed is out
        """
        folders = self._launch([[*job, f"{BUDGET}={samples}"] for _, job in grid])
        jobs: dict[str, list[Path | None]] = {}
        for (value, _), folder in zip(grid, folders, strict=True):
            jobs.setdefault(value, []).append(folder)
        return {value: [read_run(path) for path in paths if path] for value, paths in jobs.items() if all(paths)}


def check_one_task(arguments: list[str], tasks: list[str]) -> None:
    """:raises ValueError: if a search is over several tasks, whose objectives cannot be compared"""
    if len(tasks) > 1 and not set(SEARCHES).isdisjoint(arguments):
        raise ValueError(f"a search compares values on one task, found {len(tasks)}: search on each of them.")


def _ranked(
    folder: Path, jobs: Mapping[str, list[Run]], samples: int, episodes: int = EPISODES
) -> list[tuple[list[float], str]]:
    """Scores and values, the best first; a score that is known already is not computed again.

    :param folder: of the search
    :param jobs: of every value; its score is their mean, for they differ in the seed or another key
    :param samples: that they trained on
    """
    known = ResultCache(folder / SCORES)
    ranked = []
    for value, of_value in jobs.items():
        scores = []
        for job in of_value:
            scores.append(scored(known, folder, job, samples, episodes))
        ranked.append((np.mean(scores, axis=0).tolist(), value))
    return sorted(ranked, reverse=True, key=lambda entry: entry[0])


def scored(known: ResultCache, folder: Path, job: Run, samples: int, episodes: int) -> list[float]:
    """What a job is ranked by; computed now if it is not known.

    :param known: scores of the search
    :param folder: of the search
    :param job: which has trained
    :param samples: so many
    :param episodes: of the test protocol
    :raises ValueError: if it has trained on more, and the score is not known
    """
    name = job.path.resolve().relative_to(folder.resolve()).as_posix()
    settings = {"job": name, "run": job.fingerprint, "samples": samples, "episodes": episodes, "stream": STREAM}
    if settings not in known and _is_beyond(job, samples):
        raise ValueError(
            f"{job.path}: trained on {job.samples:,} samples already, where this search compares after "
            f"{samples:,}. {ANOTHER}"
        )
    scores: list[float] = known.remember(settings, lambda: _score(job, episodes))
    return scores


def _is_beyond(job: Run, samples: int) -> bool:
    """Whether a job has trained for far more samples than were asked for, which are rounded up to whole rollouts."""
    train = job.config.get("train", {})
    rollout: int = train.get("num_envs", 0) * train.get("ppo", {}).get("n_steps", 0)
    return job.samples >= max(2 * samples, samples + rollout)


def _score(job: Run, episodes: int) -> list[float]:
    from ogmp_sb3.evaluation.evaluated_policy import (  # brings plots, which a training does without
        EvaluatedPolicy,
        rank_key,
    )

    subject = EvaluatedPolicy(load_policy(job.path), [], job.path)
    return rank_key(subject.evaluation(episodes, seed=0, progress=lambda _: None, stream=STREAM))


def _show(ranked: list[tuple[list[float], str]], kept: int, title: str) -> None:
    table = Table("value", title=title, title_justify="left", min_width=len(title))
    for name in ("true objective", "return"):
        table.add_column(name, justify="right")
    table.add_column("")
    for place, (score, value) in enumerate(ranked):
        table.add_row(value, *(f"{number:.3f}" for number in score), "kept" if place < kept else "dropped")
    cli.console().print(table)
