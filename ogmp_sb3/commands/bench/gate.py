"""Whether anything has become slower than a baseline: ``ogmp-bench gate``.

The times are ratios to bare work that is done in turns with what is measured, with one thread, so they hardly depend
on the speed of the machine or on what else it does. The counts do not depend on it at all.
"""

from __future__ import annotations

import gc
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from torch import nn

from ogmp_sb3.commands.bench.learner import learner, update
from ogmp_sb3.commands.bench.random_env import RandomEnv
from ogmp_sb3.commands.bench.simulation import bare_replay, record, untrained_actions
from ogmp_sb3.commands.bench.timing import Numbers, times_bare
from ogmp_sb3.commands.bench.training import Training, at_bare_dt
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.runs.settings import versions
from ogmp_sb3.runs.storage import load_json
from ogmp_sb3.sb3.hyperparameters import default_ppo
from ogmp_sb3.sb3.threads import torch_threads
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

TASK = "parkour"
TOLERANCE = 0.10  # how far a measure may fall behind its baseline
ELSEWHERE = 0.25  # if the baseline is from another machine
TRIES = 3  # a measure that falls short is taken again; the best counts
ENDINGS = 0.05  # share of the steps that end an episode, for the learner


def sim_over_bare_physics(num_envs: int = 64, steps: int = 25, repeats: int = 5) -> float:
    """``OgmpVecEnv.step`` against bare physics of the same run."""
    task = load_task(TASK)
    recording = record(task, num_envs, steps)
    _, replay = bare_replay(task, recording, threads=1)

    def play(pause: Callable[[], None]) -> None:
        for action in recording.actions:
            env.step(action)
            pause()

    ratios = []
    for _ in range(repeats):
        env, bare = OgmpVecEnv(task, num_envs, seed=0, threads=1), replay()
        env.reset()
        ratios.append(times_bare(play, lambda bare=bare: next(bare)))  # type: ignore[misc]
    return _share(ratios, steps)


def learner_over_bare_lstm(num_envs: int = 32, repeats: int = 5) -> float:
    """The default recipe's update against bare passes of its LSTMs, forward and backward, over whole rollouts."""
    recipe = default_ppo()
    env = RandomEnv(load_task(TASK), num_envs, ENDINGS)
    model = learner(env, recipe)
    batches = max(1, round(recipe.n_steps * num_envs / recipe.batch_size))
    size, layers = recipe.lstm_hidden_size, recipe.n_lstm_layers
    lstms = [nn.LSTM(env.batch.observation_size, size, layers) for _ in ("actor", "critic")]
    rollout = th.randn(recipe.n_steps, max(1, num_envs // batches), env.batch.observation_size)

    def bare() -> None:
        for lstm in lstms:
            lstm(rollout)[0].sum().backward()

    def train(pause: Callable[[], None]) -> None:
        with _after(model.policy.optimizer, "step", pause):
            body()

    ratios = []
    for _ in range(repeats):
        body = update(model)
        ratios.append(times_bare(train, bare))
    return _share(ratios, recipe.n_epochs * batches)


def training_over_bare_physics(num_envs: int = 32, repeats: int = 3) -> float:
    """A whole training by the default recipe, of an untrained policy, against bare physics of 2 ms."""
    task = load_task(TASK)
    bare_task, training = at_bare_dt(task), Training(task, num_envs, default_ppo(), threads=1)
    _, replay = bare_replay(bare_task, record(bare_task, num_envs, training.recipe.n_steps), threads=1)
    bare = chain.from_iterable(replay() for _ in count())

    def train(pause: Callable[[], None]) -> None:
        with _after(training.model.env, "step_wait", pause), _after(training.model.policy.optimizer, "step", pause):
            training.run(training.rollout)

    training.run(training.rollout)  # what is made once, is
    return _share([times_bare(train, lambda: next(bare)) for _ in range(repeats)], training.recipe.n_steps)


def calls_per_step(num_envs: int = 64, steps: int = 30) -> float:
    """Functions that are called in a control step of all environments, resets included, compiled ones as well."""
    env, actions = _stepped(num_envs, steps)
    calls = 0

    def counted(frame: Any, event: str, function: Any) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    for action in actions:
        sys.setprofile(counted)
        env.step(action)
        sys.setprofile(None)
    return calls / steps


def memory_kb_per_step(num_envs: int = 64, steps: int = 30) -> float:
    """The most that a control step of all environments holds of what it allocates, median over steps, KB."""
    env, actions = _stepped(num_envs, steps)
    held = []
    gc.collect()
    gc.disable()
    tracemalloc.start()
    try:
        for action in actions:
            tracemalloc.reset_peak()
            before, _ = tracemalloc.get_traced_memory()
            env.step(action)
            held.append(tracemalloc.get_traced_memory()[1] - before)
    finally:
        tracemalloc.stop()
        gc.enable()
    return float(np.median(held)) / 1024


def _stepped(num_envs: int, steps: int) -> tuple[OgmpVecEnv, np.ndarray]:
    """Environments that have made some steps already, and actions for as many more."""
    task = load_task(TASK)
    env, actions = OgmpVecEnv(task, num_envs, seed=0, threads=1), untrained_actions(task, 2 * steps, num_envs)
    env.reset()
    for action in actions[:steps]:
        env.step(action)
    return env, actions[steps:]


def _share(ratios: list[np.ndarray], bare: int) -> float:
    """The bare work's share of the whole, by CPU time or by the clock, whichever is less: a sleep takes no CPU.

    :param ratios: of the repeats, see :func:`~ogmp_sb3.commands.bench.timing.times_bare`
    :param bare: how many runs of the bare work the whole comes to
    """
    return float(np.min(bare / np.median(ratios, axis=0)))


@contextmanager
def _after(holder: Any, name: str, pause: Callable[[], None]) -> Iterator[None]:
    """Pause after each call of a method."""
    method = getattr(holder, name)

    def with_pause(*args: Any, **kwargs: Any) -> Any:
        result = method(*args, **kwargs)
        pause()
        return result

    setattr(holder, name, with_pause)
    try:
        yield
    finally:
        setattr(holder, name, method)


MEASURES: dict[str, tuple[Callable[[], float], bool]] = {
    "sim_over_bare_physics": (sim_over_bare_physics, True),
    "learner_over_bare_lstm": (learner_over_bare_lstm, True),
    "training_over_bare_physics": (training_over_bare_physics, True),
    "calls_per_step": (calls_per_step, False),
    "memory_kb_per_step": (memory_kb_per_step, False),
}
"""What is measured; whether more is better"""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measure beside its baseline."""

    name: str
    """of the measure"""
    baseline: float
    """what it was"""
    now: float
    """what it is, at best"""
    limit: float
    """how far it may have gone"""
    more_is_better: bool
    """whether the limit is the least or the greatest value"""

    @property
    def passes(self) -> bool:
        """Whether it is within its limit."""
        return self.now >= self.limit if self.more_is_better else self.now <= self.limit

    @property
    def allowed(self) -> str:
        """The limit in words."""
        return f"at {'least' if self.more_is_better else 'most'} {shown(self.limit)}"


def bench_gate() -> Numbers:
    """All measures once, with one thread: a baseline."""
    with torch_threads(1):
        return {name: take() for name, (take, _) in MEASURES.items()}


def compare(baseline: Numbers, tolerance: float) -> list[Row]:
    """All measures beside a baseline; one that falls short is taken again, as other work may have come between.

    :param baseline: by name, see :data:`MEASURES`
    :param tolerance: how far a measure may fall behind, as a share of it
    """
    rows = []
    with torch_threads(1):
        for name, (take, more_is_better) in MEASURES.items():
            best = max if more_is_better else min
            limit = baseline[name] * (1 - tolerance if more_is_better else 1 + tolerance)
            row = Row(name=name, baseline=baseline[name], now=take(), limit=limit, more_is_better=more_is_better)
            for _ in range(TRIES - 1):
                if not row.passes:
                    row = Row(**{**vars(row), "now": best(row.now, take())})
            rows.append(row)
    return rows


def shown(value: float) -> str:
    """A number of the table."""
    return f"{value:,.3f}" if value < 100 else f"{value:,.0f}"


def cpu() -> str:
    """What the CPU of this machine is, as far as it says so."""
    known = ("vendor_id", "cpu family", "model", "model name")
    lines = (line.partition(":") for line in Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines())
    return ", ".join(f"{key.strip()} {value.strip()}" for key, _, value in lines if key.strip() in known)


def read_baseline(file: Path) -> tuple[Numbers, list[str]]:
    """The measures of a baseline, and in what its machine differs from this one.

    :raises ValueError: if it is no baseline, or one of other measures
    """
    data, where = load_json(file), Where(str(file))
    numbers = read(dict[str, float], data.get("numbers"), where / "numbers")
    if set(numbers) != set(MEASURES) or not all(0 < value < np.inf for value in numbers.values()):
        raise ValueError(
            f"{file}: 'numbers' must be those of a gate ({', '.join(MEASURES)}), each above 0; "
            f"make it anew: ogmp-bench gate json={file}."
        )
    there = {"cpu": data.get("cpu"), **read(dict[str, str], data.get("versions"), where / "versions")}
    here = {"cpu": cpu(), **versions(), "ogmp_sb3": there.get("ogmp_sb3")}
    return numbers, [f"{name} {value}" for name, value in there.items() if value != here.get(name)]
