"""Successive halving: all values of a key train a little, the better half of them twice as long, and so on.

Karnin, Koren and Somekh, "Almost optimal exploration in multi-armed bandits", ICML 2013. It needs runs that go on
where they stopped, which ours are. Policies are compared by the task's true objective under its test protocol, where
none has a bound: training returns of different bounds cannot be compared.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import read_value, read_yaml
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy, rank_key
from ogmp_sb3.evaluation.result_cache import ResultCache
from ogmp_sb3.runs.multirun import plain_key, read_sweep, setting
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import Run, read_run
from ogmp_sb3.sb3.hyperparameters import DEFAULTS

ROUNDS = 4  # how often jobs train and are compared; the last trains total_timesteps, each before it half of the next
EPISODES = 32  # of the test protocol, to compare jobs by
VALUES = {"rho": "0.05,0.1,0.2,0.3,0.4,0.5,0.6,0.8"}  # of keys that a command line need not give values
SCORES = "halving.jsonl"  # in the directory of the search
OWN = ("total_timesteps", "hydra.sweep.dir")  # keys that the search sets for every round


def search(key: str, arguments: list[str], multirun: Callable[[list[str]], object]) -> None:
    """Run a search; one that was killed goes on with the same command.

    :param key: what varies, e.g. ``rho``; a key of the task with or without ``task.``
    :param arguments: the command line without the search
    :param multirun: runs ``ogmp-train`` with a command line
    :raises ValueError: if there are no values to compare
    """
    key = typed = plain_key(key)
    own: dict[str, str] = {}
    rest, task = [], ""
    for argument in arguments:
        name, sign, value = argument.partition("=")
        typed = name if plain_key(name) == key else typed
        task = Path(value).stem if name == "task" else task
        if not sign or plain_key(name) not in (key, *OWN):
            rest.append(argument)
        elif plain_key(name) in own:
            raise ValueError(f"'{plain_key(name)}' is given twice.")
        else:
            own[plain_key(name)] = value
    if key not in {**VALUES, **own}:
        raise ValueError(f"'+search={key}' needs the values that it compares: {key}=<value>,<value>,...")
    values = [_plain_value(key, value) for value in {**VALUES, **own}[key].split(",")]
    samples = _value("total_timesteps", own.get("total_timesteps", str(read_yaml(DEFAULTS)["total_timesteps"])))
    total = read(int, samples, Where("ogmp-train", "total_timesteps"))
    folder = Path(own.get("hydra.sweep.dir", Path("runs", "search", key, task)))
    first: list[Run] = []
    for left in reversed(range(ROUNDS)):
        budget = total // 2**left
        varied = f"{typed}={','.join(values)}"
        multirun([*rest, "-m", "+experiment=sweep", varied, f"total_timesteps={budget}", f"hydra.sweep.dir={folder}"])
        jobs = read_sweep(folder, asked=True)
        first = first or jobs
        ranked = _ranked(folder, key, values, jobs, budget)
        values = [value for _, value in ranked[: max(1, (len(ranked) + 1) // 2)]]
        _show(ranked, len(values), f"after {budget:,} samples, {EPISODES} test episodes each")
    spent = sum(read_run(job.path).samples for job in first)
    print(f"Best: {key}={values[0]}. {spent:,} samples; the full grid takes {len(first) * total:,}.")


def _ranked(folder: Path, key: str, values: list[str], jobs: list[Run], samples: int) -> list[tuple[list[float], str]]:
    """Scores and values, the best first; a score that is known already is not computed again.

    The score of a value is the mean of its jobs, which differ in the seed or another key of the command line.
    """
    known = ResultCache(folder / SCORES)
    ranked = []
    for value in values:
        scores = []
        for job in jobs:
            if _word(setting(job, key)) == value:
                name = job.path.relative_to(folder).as_posix()
                settings = {"job": name, "run": job.fingerprint, "samples": samples, "episodes": EPISODES}
                if settings not in known and _is_beyond(job, samples):
                    raise ValueError(
                        f"{job.path}: trained on {job.samples:,} samples already, where this search compares after "
                        f"{samples:,}. Choose another directory: hydra.sweep.dir=..."
                    )
                scores.append(known.remember(settings, lambda job=job: _score(job, EPISODES)))  # type: ignore[misc]
        if not scores:
            raise ValueError(f"{folder}: holds no job with {key}={value}.")
        ranked.append((np.mean(scores, axis=0).tolist(), value))
    return sorted(ranked, reverse=True, key=lambda entry: entry[0])


def _is_beyond(job: Run, samples: int) -> bool:
    """Whether a job has trained for far more samples than were asked for, which are rounded up to whole rollouts."""
    train = job.config.get("train", {})
    rollout: int = train.get("num_envs", 0) * train.get("ppo", {}).get("n_steps", 0)
    return job.samples >= max(2 * samples, samples + rollout)


def _score(job: Run, episodes: int) -> list[float]:
    subject = EvaluatedPolicy(load_policy(job.path), [], job.path)
    return rank_key(subject.evaluation(episodes, seed=0, progress=lambda _: None))


def _plain_value(key: str, text: str) -> str:
    """One value of the key that varies.

    :raises ValueError: for an expression of Hydra's, such as ``range(1,3)``
    """
    value = _value(key, text)
    if any(mark in text for mark in "()[]{}"):
        raise ValueError(f"'{key}={text}': a search takes plain values with commas between them, e.g. {key}=0.1,0.3.")
    return _word(value)


def _value(key: str, text: str) -> object:
    try:
        return read_value(text)
    except ValueError as error:
        raise ValueError(f"'{key}={text}' has a value that is not YAML ({error}).") from None


def _word(value: object) -> str:
    """As on a command line."""
    return "null" if value is None else str(value)


def _show(ranked: list[tuple[list[float], str]], kept: int, title: str) -> None:
    table = Table("value", title=title, title_justify="left", min_width=len(title))
    for name in ("true objective", "return"):
        table.add_column(name, justify="right")
    table.add_column("")
    for place, (score, value) in enumerate(ranked):
        table.add_row(value, *(f"{number:.3f}" for number in score), "kept" if place < kept else "dropped")
    cli.console().print(table)
