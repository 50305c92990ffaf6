"""``ogmp-bench``: how fast simulation, learner and whole training are, side by side with the alternatives."""

from __future__ import annotations

import platform
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import torch as th
from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.bench.learner import bench_learner, bench_train
from ogmp_sb3.commands.bench.physics import bench_physics
from ogmp_sb3.commands.bench.simulation import bench_sim
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.scenes import TRAINING_ONLY, task_for_test
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.report.plots.evaluations import plot_throughput
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.settings import thread_count, versions
from ogmp_sb3.runs.storage import save_json

PROGRAM = "ogmp-bench"


@dataclass(frozen=True, kw_only=True)
class BenchConfig:
    """Keys of the command line."""

    what: Literal["sim", "learner", "train", "physics"] = cli.option(
        "sim, learner, train or physics; the key may be left out"
    )
    task: str | None = cli.option("a task by name or the path of a YAML file; null: parkour, or that of 'run'", None)
    num_envs: int = cli.option("environments of the comparison", 64)
    steps: int = cli.option("control steps (sim) or samples (train) of one repeat; 0: 150, or four rollouts", 0)
    repeats: int = cli.option("repeats; medians are reported", 5)
    run: str | None = cli.option("physics: policy whose motions on its task are replayed; null: noise", None)
    robot: str | None = cli.option(cli.ROBOT, None)
    trust: bool = cli.option(cli.TRUST, False)
    json: str | None = cli.option("file for the numbers; a picture of them is put beside it", None)

    def __post_init__(self) -> None:
        for name in ("num_envs", "repeats"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}.")
        if self.run and self.what != "physics":
            raise ValueError(f"'run' is for 'physics' alone, not for '{self.what}'.")
        if self.steps and self.what in ("learner", "physics"):
            raise ValueError(f"'steps' is for 'sim' and 'train', not for '{self.what}'.")
        if self.steps < 0:
            raise ValueError(f"'steps' must be at least 0 (0: a default), found {self.steps}.")


HELP = cli.usage(
    PROGRAM,
    "measure speed as ratios within one run, medians over repeats.",
    [
        "ogmp-bench sim",
        "ogmp-bench learner json=learner.json",
        "ogmp-bench train steps=8192 repeats=3",
        "ogmp-bench physics run=runs/parkour/2026-01-31_12-00-00",
    ],
    BenchConfig,
)


def _run(arguments: list[str]) -> None:
    arguments = [a if "=" in a else f"what={a}" for a in arguments]
    config, overrides = cli.parse(BenchConfig, arguments, PROGRAM, cli.task_keys(TaskConfig))
    th.set_num_threads(thread_count("auto"))
    if config.json:
        Path(config.json).parent.mkdir(parents=True, exist_ok=True)
    if config.run:
        loaded = load_policy(config.run, config.trust, config.task, config.robot)
        task = task_for_test(loaded.task_data, loaded.task_path, overrides, None, PROGRAM, TRAINING_ONLY)
        numbers = bench_physics(task, loaded.policy, config.num_envs, config.repeats)
    else:
        robot = [f"robot={config.robot}"] if config.robot else []
        task = load_task(config.task or "parkour", [*overrides, *robot])
        if config.what == "physics":
            numbers = bench_physics(task, None, config.num_envs, config.repeats)
        elif config.what == "sim":
            numbers = bench_sim(task, config.num_envs, config.steps or 150, config.repeats)
        elif config.what == "learner":
            numbers = bench_learner(task, config.num_envs, config.repeats)
        else:
            numbers = bench_train(task, config.num_envs, config.steps, config.repeats)
    table = Table(title=f"{PROGRAM} {config.what}, {platform.processor() or platform.machine()}", title_justify="left")
    table.add_column("what")
    table.add_column("value", justify="right")
    for name, value in numbers.items():
        table.add_row(name, f"{value:,.3f}" if value < 100 else f"{value:,.0f}")
    cli.console().print(table)
    if config.json:
        cores = thread_count("auto")
        report = {"config": asdict(config), "overrides": overrides, "numbers": numbers, "cores": cores}
        save_json(Path(config.json), {**report, "versions": versions()})
        if any("per_second" in name for name in numbers):
            plot_throughput(f"{PROGRAM} {config.what}, {cores} cores", numbers, Path(config.json).with_suffix(".png"))


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
