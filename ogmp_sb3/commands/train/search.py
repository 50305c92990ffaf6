"""Successive halving: all values of a key train a little, the better half of them twice as long, and so on.

Karnin, Koren and Somekh, "Almost optimal exploration in multi-armed bandits", ICML 2013. It needs runs that go on
where they stopped, which ours are. Policies are compared by the task's true objective under its test protocol, where
none has a bound: training returns of different bounds cannot be compared. The tracks are neither those of the
trainings nor those of a test.

It is a sweeper of Hydra's, ``hydra/sweeper=halving``, and runs its jobs on whatever launcher is chosen;
``+search=<key>`` is short for it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, ValueType
from hydra.core.plugins import Plugins
from hydra.plugins.launcher import Launcher
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf
from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.env.streams import Stream
from ogmp_sb3.evaluation.result_cache import ResultCache
from ogmp_sb3.runs.multirun import plain_key
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import FAILURE, MULTIRUN, Run, read_run

ROUNDS = 4  # how often jobs train and are compared; the last trains total_timesteps, each before it half of the next
EPISODES = 32  # of the test protocol, to compare jobs by
VALUES = {"rho": "0.05,0.1,0.2,0.3,0.4,0.5,0.6,0.8"}  # of keys that a command line need not give values
STREAM: Stream = "selection"  # of its episodes: what is reported of the jobs is measured on others
SCORES = "halving.jsonl"  # in the directory of the search
SHORT = "+search="
SWEEPER = "hydra/sweeper=halving"
HOME = "hydra._internal.core_plugins.ogmp_sb3"  # Hydra takes plug-ins from its own packages alone
BUDGET = "total_timesteps"  # the key that the search sets for every round


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


class HalvingSweeper(Sweeper):
    """Hydra makes it from ``hydra.sweeper``.

    :param key: what varies, e.g. ``rho``; a key of the task with or without ``task.``
    :param rounds: how often jobs train and are compared
    :param episodes: of the test protocol, to compare jobs by
    :param params: values of keys, as on the command line, which goes before them
    """

    __module__ = HOME

    config: DictConfig
    launcher: Launcher

    def __init__(self, key: str, rounds: int, episodes: int, params: Mapping[str, str]) -> None:
        self.key = plain_key(key)
        self.rounds, self.episodes, self.params = rounds, episodes, params
        self.launched = 0

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """What Hydra hands over before the sweep."""
        sys.modules.pop(HOME, None)  # processes that a launcher starts do not find it: they get the class itself
        self.hydra_context, self.config = hydra_context, config
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    def sweep(self, arguments: list[str]) -> None:
        """Run the search; one that was killed goes on with the same command.

        :param arguments: the command line without what is Hydra's own
        :raises ValueError: if there are no values to compare, or not plain ones
        """
        command_line = OverridesParser.create().parse_overrides(arguments)
        typed = {plain_key(override.key_or_group) for override in command_line}
        params = [f"{key}={value}" for key, value in self.params.items() if plain_key(key) not in typed]
        overrides = [*OverridesParser.create().parse_overrides(params), *command_line]
        self._check(overrides)
        total = self._total(overrides)
        grid = self._grid(overrides)
        values = list(dict.fromkeys(value for value, _ in grid))
        folder = Path(self.config.hydra.sweep.dir)
        folder.mkdir(parents=True, exist_ok=True)
        OmegaConf.save(self.config, folder / MULTIRUN)
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

    def _total(self, overrides: Sequence[Override]) -> int:
        """Samples of a job of the last round."""
        totals = [override for override in overrides if override.key_or_group == BUDGET]
        value = totals[-1].get_value_string() if totals and totals[-1].is_sweep_override() else self.config[BUDGET]
        return int(read(int, value, Where("ogmp-train", BUDGET)))

    def _train(self, grid: list[tuple[str, list[str]]], samples: int) -> dict[str, list[Run]]:
        """Run jobs on the launcher.

        :param grid: value and command line of each
        :return: the jobs of every value; a value of which one failed is out
        """
        batch = [[*job, f"{BUDGET}={samples}"] for _, job in grid]
        self.validate_batch_is_legal(batch)
        results = self.launcher.launch(batch, initial_job_idx=self.launched)
        self.launched += len(batch)
        folders: dict[str, list[Path]] = {}
        for (value, _), result in zip(grid, results, strict=True):
            _ = result.return_value  # raises what a job raised
            folder = Path(result.hydra_cfg.hydra.runtime.output_dir)  # type: ignore[union-attr]
            folders.setdefault(value, []).append(folder)
        right = {v: paths for v, paths in folders.items() if not any((path / FAILURE).is_file() for path in paths)}
        return {value: [read_run(path) for path in paths] for value, paths in right.items()}


def check_one_task(arguments: list[str], tasks: list[str]) -> None:
    """:raises ValueError: if a search is over several tasks, whose objectives cannot be compared"""
    if len(tasks) > 1 and SWEEPER in arguments:
        raise ValueError(f"a search compares values on one task, found {len(tasks)}: search on each of them.")


def register_sweeper() -> None:
    """Make the search known to Hydra."""
    Plugins.instance().register(HalvingSweeper)
    sys.modules[HOME] = sys.modules[__name__]
    target = f"{HalvingSweeper.__module__}.{HalvingSweeper.__name__}"
    node: dict[str, Any] = {"_target_": target, "key": "rho", "rounds": ROUNDS, "episodes": EPISODES, "params": {}}
    ConfigStore.instance().store(group="hydra/sweeper", name="halving", node=node, provider="ogmp_sb3")


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
            name = job.path.resolve().relative_to(folder.resolve()).as_posix()
            settings = {"job": name, "run": job.fingerprint, "samples": samples, "episodes": episodes}
            settings["stream"] = STREAM
            if settings not in known and _is_beyond(job, samples):
                raise ValueError(
                    f"{job.path}: trained on {job.samples:,} samples already, where this search compares after "
                    f"{samples:,}. Choose another directory: hydra.sweep.dir=..."
                )
            scores.append(known.remember(settings, lambda job=job: _score(job, episodes)))  # type: ignore[misc]
        ranked.append((np.mean(scores, axis=0).tolist(), value))
    return sorted(ranked, reverse=True, key=lambda entry: entry[0])


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
