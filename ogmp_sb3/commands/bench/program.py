"""``ogmp-bench``: how fast simulation, learner and whole training are, side by side with the alternatives."""

from __future__ import annotations

import platform
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Literal

import torch as th
from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.bench.gate import ELSEWHERE, TOLERANCE, bench_gate, compare, cpu, read_baseline, shown
from ogmp_sb3.commands.bench.learner import bench_learner
from ogmp_sb3.commands.bench.peer import bench_peer
from ogmp_sb3.commands.bench.physics import bench_physics
from ogmp_sb3.commands.bench.scaling import bench_scaling
from ogmp_sb3.commands.bench.simulation import bench_sim
from ogmp_sb3.commands.bench.timing import Numbers
from ogmp_sb3.commands.bench.training import bench_train
from ogmp_sb3.commands.named_run import named_run
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.scenes import TRAINING_ONLY, task_for_test
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.yaml_files import apply_overrides
from ogmp_sb3.report.plots.evaluations import plot_throughput
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.settings import thread_count, versions
from ogmp_sb3.runs.storage import save_json
from ogmp_sb3.sb3.hyperparameters import PPOConfig, default_ppo
from ogmp_sb3.sb3.policy import LstmPolicy

PROGRAM = "ogmp-bench"
PPO = "ppo."
TRAINS = ("learner", "train", "scaling")  # what follows a recipe


@dataclass(frozen=True, kw_only=True)
class BenchConfig:
    """Keys of the command line."""

    what: Literal["sim", "learner", "train", "scaling", "physics", "gate"] = cli.option(
        "sim, learner, train, scaling, physics or gate; the key may be left out"
    )
    task: str | None = cli.option("a task by name or the path of a YAML file; null: parkour, or that of 'run'", None)
    num_envs: int = cli.option("environments of the comparison", 64)
    steps: int = cli.option("control steps (sim) or samples (train) of one repeat; 0: 150, or one rollout", 0)
    repeats: int = cli.option("repeats; medians are reported", 5)
    run: str | None = cli.option(
        "policy: its training goes on (train, scaling), its motions are replayed (physics); null: an untrained one",
        None,
    )
    stock: bool = cli.option("train: also measure sb3-contrib's RecurrentPPO", True)
    peer: Literal["rsl_rl"] | None = cli.option("learner: compare with that of rsl_rl; null: with sb3-contrib's", None)
    baseline: str | None = cli.option("gate: file of an earlier gate that may not be fallen behind", None)
    robot: str | None = cli.option(cli.ROBOT, None)
    trust: bool = cli.option(cli.TRUST, False)
    json: str | None = cli.option("file for the numbers; a picture of them is put beside it", None)

    def __post_init__(self) -> None:
        for name in ("num_envs", "repeats"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}.")
        for field in fields(self):
            used = USED_BY.get(field.name, ALL_BUT_GATE)
            if getattr(self, field.name) != field.default and self.what not in used:
                raise ValueError(f"'{field.name}' is for {_listed(used)}, not for '{self.what}'.")
        if self.baseline and self.json:
            raise ValueError("'baseline' compares with a file and 'json' makes one: give one of them.")
        if self.steps < 0:
            raise ValueError(f"'steps' must be at least 0 (0: a default), found {self.steps}.")


ALL_BUT_GATE = ("sim", "learner", "train", "scaling", "physics")
USED_BY = {
    "what": (*ALL_BUT_GATE, "gate"),
    "json": (*ALL_BUT_GATE, "gate"),
    "steps": ("sim", "train"),
    "run": ("train", "scaling", "physics"),
    "trust": ("train", "scaling", "physics"),
    "stock": ("train",),
    "peer": ("learner",),
    "baseline": ("gate",),
}
"""What uses a key; the other keys are for all but the gate, which always measures the same."""


def _listed(names: tuple[str, ...]) -> str:
    quoted = [f"'{name}'" for name in names]
    return f"{quoted[0]} alone" if len(names) == 1 else f"{', '.join(quoted[:-1])} and {quoted[-1]}"


HELP = cli.usage(
    PROGRAM,
    "measure speed as ratios within one run, medians over repeats.",
    [
        "ogmp-bench sim",
        "ogmp-bench learner json=learner.json",
        "ogmp-bench learner peer=rsl_rl",
        "ogmp-bench train stock=false run=parkour",
        "ogmp-bench train stock=false physics_dt=0.005 ppo.n_epochs=3",
        "ogmp-bench scaling",
        "ogmp-bench physics run=runs/parkour/2026-01-31_12-00-00",
        "ogmp-bench gate baseline=benchmarks/gate.json",
    ],
    BenchConfig,
)


def _run(arguments: list[str]) -> None:
    arguments = [a if "=" in a else f"what={a}" for a in arguments]
    config, overrides = cli.parse(BenchConfig, arguments, PROGRAM, (*cli.task_keys(TaskConfig), "ppo"))
    th.set_num_threads(thread_count("auto"))
    if config.what == "gate" and overrides:
        raise ValueError(f"the gate always measures the same task, found '{overrides[0]}'.")
    if config.baseline is not None:
        _compare_with(Path(config.baseline))
        return
    if config.json:
        Path(config.json).parent.mkdir(parents=True, exist_ok=True)
    numbers, subject = (bench_gate(), "one thread") if config.what == "gate" else _measured(config, overrides)
    title = f"{PROGRAM} {config.what}, {subject}, {platform.processor() or platform.machine()}"
    _print(title, ("what", "value"), [(name, shown(value)) for name, value in numbers.items()])
    if config.json:
        cores = thread_count("auto")
        report = {"config": asdict(config), "overrides": overrides, "numbers": numbers, "cores": cores}
        save_json(Path(config.json), {**report, "cpu": cpu(), "versions": versions()})
        if any("per_second" in name for name in numbers):
            plot_throughput(f"{PROGRAM} {config.what}, {cores} cores", numbers, Path(config.json).with_suffix(".png"))


def _compare_with(file: Path) -> None:
    """Print every measure of the gate beside its baseline.

    :raises SystemExit: with 1, if one has fallen behind
    """
    baseline, differences = read_baseline(file)
    tolerance = ELSEWHERE if differences else TOLERANCE
    rows = compare(baseline, tolerance)
    cells = [(row.name, shown(row.baseline), shown(row.now), row.allowed) for row in rows]
    _print(f"{PROGRAM} gate, one thread", ("measure", "baseline", "now", "allowed"), cells)
    if differences:
        cli.console().print(f"{tolerance:.0%} are allowed, as {file} is from elsewhere: {', '.join(differences)}.")
    behind = [row for row in rows if not row.passes]
    for row in behind:
        print(f"{PROGRAM}: {row.name} is {shown(row.now)}, {row.allowed} is allowed.", file=sys.stderr)
    if behind:
        print(f"{PROGRAM}: if that is meant, make the baseline anew: {PROGRAM} gate json={file}", file=sys.stderr)
        raise SystemExit(1)


def _print(title: str, columns: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    table = Table(title=title, title_justify="left")
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row)
    cli.console().print(table)


def _recipe(overrides: list[str]) -> PPOConfig:
    """The default recipe with some of its values replaced."""
    return read(PPOConfig, apply_overrides(asdict(default_ppo()), overrides, PROGRAM), Where(PROGRAM, "ppo"))


def _measured(config: BenchConfig, given: list[str]) -> tuple[Numbers, str]:
    """The numbers of a benchmark, and what they are of."""
    overrides = [key for key in given if not key.startswith(PPO)]
    if given != overrides and config.what not in TRAINS:
        raise ValueError(f"keys of ppo are for {_listed(TRAINS)}, not for '{config.what}'.")
    recipe = _recipe([key.removeprefix(PPO) for key in given if key.startswith(PPO)])
    policy: LstmPolicy | None = None
    if config.run:
        run = named_run(PROGRAM, config.run)
        loaded = load_policy(run, config.trust, config.task, config.robot)
        policy = loaded.policy
        task = task_for_test(loaded.task_data, loaded.task_path, overrides, None, PROGRAM, TRAINING_ONLY)
    else:
        robot = [f"robot={config.robot}"] if config.robot else []
        task = load_task(config.task or "parkour", [*overrides, *robot])
    subject = f"{task.name}, {f'policy {config.run}' if config.run else 'untrained'}"
    if config.what == "physics":
        return bench_physics(task, policy, config.num_envs, config.repeats), subject
    if config.what == "sim":
        return bench_sim(task, config.num_envs, config.steps or 150, config.repeats), subject
    if config.what == "scaling":
        return bench_scaling(task, config.num_envs, config.repeats, recipe, policy), subject
    if config.what == "train":
        numbers = bench_train(task, config.num_envs, config.steps, config.repeats, recipe, policy, config.stock)
        return numbers, subject
    if config.peer is not None:
        numbers = bench_peer(task, config.num_envs, config.repeats, recipe)
        return numbers, f"shapes of {task.name}, CPU seconds of one thread"
    return bench_learner(task, config.num_envs, config.repeats, recipe), subject


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
