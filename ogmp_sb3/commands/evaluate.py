"""``ogmp-eval``: how good a policy is, by the paper's test protocol, with confidence intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.config.catalogue import shown_path
from ogmp_sb3.config.scenes import task_for_test
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.evaluation.episodes import evaluate_cell, measure, play_episodes
from ogmp_sb3.evaluation.epsilon import estimate_epsilon
from ogmp_sb3.evaluation.grid import Grid, read_grid
from ogmp_sb3.evaluation.robustness import Disturbance, as_rows, disturbances, episode_sets, play_disturbed
from ogmp_sb3.evaluation.statistics import Summary, as_text
from ogmp_sb3.guidance.course import extent
from ogmp_sb3.report.page import write_csv
from ogmp_sb3.report.panels import shown
from ogmp_sb3.report.plots.evaluations import plot_grids, plot_robustness
from ogmp_sb3.runs.callbacks import progress_bar
from ogmp_sb3.runs.policies import LoadedPolicy, load_policy
from ogmp_sb3.runs.run_directory import default_out
from ogmp_sb3.runs.settings import versions
from ogmp_sb3.runs.storage import save_json

PROGRAM = "ogmp-eval"
EPISODES, CELL_EPISODES = 100, 10
SLOWEST = 0.1  # m/s: an endless episode slower than this is over
MAX_DISTANCE = 200.0  # m
ESTIMATE = "an estimate, biased by the oracle and the rho of the training"  # what epsilon is


@dataclass(frozen=True, kw_only=True)
class EvalConfig:
    """Keys of the command line."""

    run: str = cli.option("run directory, checkpoint directory, or name of a shipped policy")
    episodes: int | None = cli.option(
        f"how many episodes; null: {EPISODES}, and {CELL_EPISODES} for each cell of a grid", None
    )
    seed: int = cli.option("episode i is seeded with seed + i", 0)
    protocol: Literal["paper", "endless"] = cli.option("paper: as in the task file; endless: to a fall", "paper")
    max_distance: float = cli.option("endless: an episode is over this far along the track, m", MAX_DISTANCE)
    scene: str | None = cli.option("modes to command, a shipped scene or a YAML file; null: the task's own", None)
    grid: str | None = cli.option("two parameters of a mode to vary, e.g. jump.w,jump.h", None)
    robustness: bool = cli.option("disturb the policy, one disturbance at a time, 'episodes' at each size", False)
    epsilon: bool = cli.option("how far states stray from the reference of each oracle, by mode", False)
    out: str | None = cli.option("directory for the numbers and pictures; null: <run>/evaluation", None)
    trust: bool = cli.option(cli.TRUST, False)
    task: str | None = cli.option(cli.ZIP_TASK, None)

    def __post_init__(self) -> None:
        if self.episodes is not None and self.episodes < 1:
            raise ValueError(f"'episodes' must be at least 1, found {self.episodes}.")
        if self.seed < 0:
            raise ValueError(f"'seed' must be at least 0, found {self.seed}.")
        if self.max_distance <= 0:
            raise ValueError(f"'max_distance' must be above 0, found {self.max_distance:g}.")
        given = [name for name in ("grid", "robustness", "epsilon") if getattr(self, name)]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(map(repr, given))} are different evaluations: give one of them.")
        if self.protocol == "endless" and (self.grid or self.epsilon):
            raise ValueError(f"'{given[0]}' plays the task's own protocol, not 'protocol=endless'.")
        if self.protocol == "paper" and self.max_distance != MAX_DISTANCE:
            raise ValueError("'max_distance' is for 'protocol=endless' alone.")


HELP = cli.usage(
    PROGRAM,
    "evaluate a policy with its deterministic actions.",
    [
        "ogmp-eval run=runs/parkour/2026-01-31_12-00-00",
        "ogmp-eval run=parkour episodes=500 seed=1 out=evaluation",
        "ogmp-eval run=parkour protocol=endless max_distance=100",
        "ogmp-eval run=parkour scene=pace_to_jump",
        "ogmp-eval run=parkour grid=jump.w,jump.h",
        "ogmp-eval run=parkour grid=leap.w:0.1:0.6:5,leap.run_up:0.2:0.6:4",
        "ogmp-eval run=parkour robustness=true randomisation.push.speed=0.5",
        "ogmp-eval run=parkour epsilon=true",
        "ogmp-eval run=parkour oracle=lqr modes.jump.h=[0.35,0.45]",
    ],
    EvalConfig,
    "any other key of the task file, e.g. modes.leap.w=0.5, evaluation.episode_steps=800",
)


def training_task(loaded: LoadedPolicy, overrides: list[str], config: EvalConfig) -> TaskConfig:
    """The task as in training, with the user's overrides.

    :raises KeyError: for an unknown key or scene
    :raises ValueError: for a value that is out of range, or one that the evaluation would not use
    """
    for override in overrides:
        if config.robustness and override.startswith("evaluation.randomisation"):
            raise ValueError(
                f"'{override}': 'robustness' disturbs one thing at a time; its ranges are 'randomisation'."
            )
    used = ("randomisation",) if config.robustness else ()
    return task_for_test(loaded.task_data, loaded.task_path, overrides, config.scene, PROGRAM, used)


def protocol_task(trained: TaskConfig, config: EvalConfig) -> TaskConfig:
    """A task under the protocol wanted.

    :param trained: of :func:`training_task`
    :raises ValueError: if the protocol is not for such a task
    """
    task = trained.for_evaluation()
    if config.protocol == "endless":
        if extent(task).timed:
            raise ValueError(f"'protocol=endless' is for tracks: the modes of '{task.name}' take a time.")
        steps = math.ceil(config.max_distance / SLOWEST / task.control_dt)
        metrics = tuple(name for name in task.evaluation.metrics if name != "episode_length_fraction")  # of no limit
        evaluation = replace(task.evaluation, metrics=metrics)
        task = replace(task, track=replace(task.track, length=None), episode_steps=steps, evaluation=evaluation)
    return task


def show(title: str, metrics: dict[str, Summary], console: Console) -> None:
    """Print metrics as a table."""
    table = Table(title=title, title_justify="left")
    for column in ("metric", "mean", "std", "95 % interval", "n"):
        table.add_column(column, justify="left" if column == "metric" else "right")
    for name, summary in metrics.items():
        mean, std = as_text([summary["mean"]]), as_text([summary["std"]])
        table.add_row(name, mean, std, as_text(summary["ci95"], 3, " .. "), str(summary["n"]))
    console.print(table)


def _run(arguments: list[str]) -> None:
    config, overrides = cli.parse(EvalConfig, arguments, PROGRAM, cli.task_keys(TaskConfig))
    loaded = load_policy(config.run, config.trust, config.task)
    trained = training_task(loaded, overrides, config)
    task = protocol_task(trained, config)
    out = Path(config.out) if config.out else default_out(config.run, loaded.name, "evaluation")
    report: dict[str, Any] = {
        "run": shown_path(loaded.path),
        "policy": loaded.digest,
        "task": task.name,
        "protocol": config.protocol,
        "overrides": overrides,
        "scene": config.scene,
        "seed": config.seed,
        "num_timesteps": loaded.info.get("num_timesteps"),
        "physics_dt": task.physics_dt,
        "versions": versions(),
    }
    if config.grid:
        _grid(read_grid(config.grid, task, loaded.task), loaded, task, config, report, out)
    elif config.robustness:
        _robustness(disturbances(trained), loaded, task, config, report, out)
    elif config.epsilon:
        _epsilon(loaded, task, config, report, out)
    else:
        _metrics(loaded, task, config, report, out)


def _metrics(loaded: LoadedPolicy, task: TaskConfig, config: EvalConfig, report: dict[str, Any], out: Path) -> None:
    episodes = config.episodes or EPISODES
    with progress_bar(episodes, "episode") as bar:
        records = play_episodes(loaded.policy, task, episodes, config.seed, _distance(config), bar.update)
    report |= measure(task, records)
    _save(report, out / "metrics.json")
    console = cli.console()
    show(f"{task.name}, {episodes} episodes, physics step {task.physics_dt} s", report["metrics"], console)
    for group, metrics in report["groups"].items():
        show(group, metrics, console)
    ended = ", ".join(f"{cause} {count}" for cause, count in report["terminations"].items())
    console.print(f"Ended by: {ended}. Median distance {report['median_distance_m']:.2f} m.")
    console.print(f"{out / 'metrics.json'}")


def _grid(
    grid: Grid, loaded: LoadedPolicy, task: TaskConfig, config: EvalConfig, report: dict[str, Any], out: Path
) -> None:
    episodes = config.episodes or CELL_EPISODES
    with progress_bar(len(grid.cells) * episodes, "episode") as bar:
        metrics = [
            evaluate_cell(loaded.policy, task, grid.mode, cell, episodes, config.seed, bar.update)
            for cell in grid.cells
        ]
    report["grid"] = grid.as_data(metrics)
    _save(report, out / "grid.json")
    plot_grids([report["grid"]], "return", out / "grid.png")
    cli.console().print(f"{out / 'grid.png'}, {out / 'grid.json'}")


def _robustness(
    found: list[Disturbance],
    loaded: LoadedPolicy,
    task: TaskConfig,
    config: EvalConfig,
    report: dict[str, Any],
    out: Path,
) -> None:
    episodes = config.episodes or EPISODES
    with progress_bar(episodes * episode_sets(found), "episode") as bar:
        report["robustness"] = play_disturbed(
            found, loaded.policy, task, episodes, config.seed, _distance(config), bar.update
        )
    _save(report, out / "robustness.json")
    write_csv(out / "robustness.csv", as_rows(report["robustness"]))
    plot_robustness(report["robustness"], out / "robustness.png")
    cli.console().print(f"{out / 'robustness.png'}, {out / 'robustness.csv'}, {out / 'robustness.json'}")


def _epsilon(loaded: LoadedPolicy, task: TaskConfig, config: EvalConfig, report: dict[str, Any], out: Path) -> None:
    episodes = config.episodes or EPISODES
    with progress_bar(episodes, "episode") as bar:
        found = estimate_epsilon(loaded.policy, task, episodes, config.seed, bar.update)
    trained = {"oracle": loaded.task.oracle, "rho": loaded.task.rho}
    report["epsilon"] = {"what": ESTIMATE, "trained_with": trained, **found}
    _save(report, out / "epsilon.json")
    _show_epsilon(report["epsilon"], cli.console())
    cli.console().print(f"{out / 'epsilon.json'}")


def _distance(config: EvalConfig) -> float | None:
    return config.max_distance if config.protocol == "endless" else None


def _save(report: dict[str, Any], file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    save_json(file, report)


def _show_epsilon(found: dict[str, Any], console: Console) -> None:
    trained = found["trained_with"]
    title = f"epsilon, an estimate biased by the training with {trained['oracle']}, rho {shown(trained['rho'])}"
    table = Table(title=title, title_justify="left")
    for column in ("oracle", "mode", "median", "95 %", "max", "steps"):
        table.add_column(column, justify="left" if column in ("oracle", "mode") else "right")
    for oracle, modes in found["oracles"].items():
        for mode, spread in modes.items():
            numbers = (f"{spread[name]:.3f}" for name in ("median", "p95", "max"))
            table.add_row(oracle, mode, *numbers, f"{spread['steps']:,}")
    console.print(table)
    left_out = f"{found['left_out']} others ended before their time and are left out"
    console.print(f"Unit: {found['unit']}. {found['episodes']} episodes; {left_out}.")


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
