"""``ogmp-eval``: how good a policy is, by the paper's test protocol, with confidence intervals."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.console import Console
from rich.table import Table

from ogmp_sb3 import cli, registry
from ogmp_sb3.checkpoints import LoadedPolicy, load_policy
from ogmp_sb3.config import apply_overrides, apply_scene, task_from_data
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.episodes import play_episodes
from ogmp_sb3.logs import progress_bar
from ogmp_sb3.metrics import EpisodeRecord, Summary, summarise
from ogmp_sb3.plotting import plot_grid, plot_robustness
from ogmp_sb3.ranges import Range
from ogmp_sb3.robustness import disturbance_sweeps, episode_sets, play_sweeps, write_csv

PROGRAM = "ogmp-eval"
SLOWEST = 0.1  # m/s: an endless episode slower than this is over
CELL_EPISODES = 10
GRID_POINTS = 7


@dataclass(frozen=True, kw_only=True)
class EvalConfig:
    """Keys of the command line."""

    run: str = cli.option("run directory, checkpoint directory, or name of a shipped policy")
    episodes: int = cli.option("how many episodes", 100)
    seed: int = cli.option("episode i is seeded with seed + i", 0)
    protocol: Literal["paper", "endless"] = cli.option("paper: as in the task file; endless: to a fall", "paper")
    max_distance: float = cli.option("endless: an episode is over this far along the track, m", 200.0)
    scene: str | None = cli.option("modes to command, a shipped scene or a YAML file; null: the task's own", None)
    grid: str | None = cli.option(f"mode parameters to vary, {CELL_EPISODES} episodes a cell: jump.w,jump.h", None)
    robustness: bool = cli.option("disturb the policy, one disturbance at a time, 'episodes' at each size", False)
    out: str | None = cli.option("directory for metrics.json and pictures; null: <run>/evaluation", None)

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ValueError(f"'episodes' must be at least 1, found {self.episodes}.")
        if self.seed < 0:
            raise ValueError(f"'seed' must be at least 0, found {self.seed}.")
        if self.max_distance <= 0:
            raise ValueError(f"'max_distance' must be above 0, found {self.max_distance:g}.")
        if self.robustness and self.grid:
            raise ValueError("'robustness' and 'grid' are two evaluations: give one of them.")


HELP = cli.usage(
    PROGRAM,
    "evaluate a policy with its deterministic actions.",
    [
        "ogmp-eval run=runs/parkour/2026-01-31_12-00-00",
        "ogmp-eval run=parkour episodes=500 seed=1 out=evaluation",
        "ogmp-eval run=parkour protocol=endless max_distance=100",
        "ogmp-eval run=parkour scene=pace_to_jump",
        "ogmp-eval run=parkour grid=jump.w,jump.h",
        "ogmp-eval run=parkour grid=leap.w:0.1:0.6:6,leap.run_up:0.2:0.6:5",
        "ogmp-eval run=parkour robustness=true randomisation.push.speed=0.5",
        "ogmp-eval run=parkour oracle=lqr modes.jump.h=[0.35,0.45]",
    ],
    EvalConfig,
    "any other key of the task file, e.g. modes.leap.w=0.5, evaluation.episode_steps=800",
)


def evaluate(task: TaskConfig, records: list[EpisodeRecord]) -> dict[str, Summary]:
    """Every metric of the task over a set of episodes, with the true objective."""
    names = task.evaluation.metrics
    found = {name: summarise(registry.metrics.get(name)(r) for r in records) for name in names}
    found["true_objective"] = summarise(registry.objectives.get(task.objective)(r) for r in records)
    return found


def by_word(task: TaskConfig, records: list[EpisodeRecord]) -> dict[str, dict[str, Summary]]:
    """The metrics by each value of the word parameters of an episode's first mode (dive: by direction)."""
    groups: dict[str, list[EpisodeRecord]] = {}
    for record in records:
        for key, value in record.modes[0].items():
            if key != "mode" and isinstance(value, str):
                groups.setdefault(f"{key}={value}", []).append(record)
    return {group: evaluate(task, members) for group, members in sorted(groups.items())}


def training_task(loaded: LoadedPolicy, overrides: list[str], config: EvalConfig) -> TaskConfig:
    """The task as in training, with the user's overrides."""
    data = apply_overrides(copy.deepcopy(loaded.task_data), overrides, PROGRAM)
    if config.scene:
        apply_scene(data, config.scene)
    return task_from_data(data, loaded.task_path)


def protocol_task(loaded: LoadedPolicy, overrides: list[str], config: EvalConfig) -> TaskConfig:
    """The task under the protocol wanted, with the user's overrides."""
    task = training_task(loaded, overrides, config).for_evaluation()
    if config.protocol == "endless":
        steps = math.ceil(config.max_distance / SLOWEST / task.control_dt)
        task = replace(task, track=replace(task.track, length=None), episode_steps=steps)
    return task


def _grid_axis(text: str, task: TaskConfig) -> tuple[str, str, np.ndarray]:
    """``jump.w`` or ``jump.w:0.1:0.8:8`` to mode, parameter and values; by default half a range beyond both ends."""
    name, *limits = text.split(":")
    mode, _, parameter = name.partition(".")
    if mode not in task.mode_ranges:
        raise KeyError(f"grid: unknown mode '{mode}'{registry.did_you_mean(mode, task.mode_ranges)}")
    ranges = task.mode_ranges[mode]
    if parameter not in ranges or ranges[parameter].words:
        numbers = [key for key, range_ in ranges.items() if not range_.words]
        raise KeyError(f"grid: mode '{mode}' has no number '{parameter}'{registry.did_you_mean(parameter, numbers)}")
    range_ = ranges[parameter]
    try:
        low, high, points = float(limits[0]), float(limits[1]), int(limits[2])
    except IndexError:
        if limits:
            raise ValueError(f"grid: '{text}' must be mode.parameter or mode.parameter:low:high:points.") from None
        (low, high), points = range_.beyond(), GRID_POINTS
    except ValueError:
        raise ValueError(f"grid: '{text}' must be mode.parameter or mode.parameter:low:high:points.") from None
    return mode, parameter, np.round(np.linspace(low, high, points), 4)


def evaluate_grid(loaded: LoadedPolicy, task: TaskConfig, config: EvalConfig) -> dict[str, Any]:
    """The metrics over a grid of two mode parameters; each cell's track holds only that mode."""
    assert config.grid is not None
    axes = [_grid_axis(text, task) for text in config.grid.split(",")]
    if len(axes) != 2 or axes[0][0] != axes[1][0]:
        raise ValueError(f"'grid' needs two parameters of one mode, e.g. jump.w,jump.h; found '{config.grid}'.")
    (mode, first, first_values), (_, second, second_values) = axes
    cells = []
    total = len(first_values) * len(second_values) * CELL_EPISODES
    with progress_bar(total, "episode") as bar:
        for a in first_values:
            for b in second_values:
                cell = _with_mode(task, mode, {first: float(a), second: float(b)})
                records = play_episodes(loaded.policy, cell, CELL_EPISODES, config.seed, progress=bar.update)
                cells.append({first: float(a), second: float(b), "metrics": evaluate(cell, records)})
    ranges = task.mode_ranges[mode]
    trained = {key: [ranges[key].low, ranges[key].high] for key in (first, second)}
    return {"mode": mode, "axes": [first, second], "trained": trained, "cells": cells}


def _with_mode(task: TaskConfig, mode: str, values: dict[str, float]) -> TaskConfig:
    ranges = {**task.mode_ranges[mode], **{key: Range(value, value) for key, value in values.items()}}
    weights = {name: float(name == mode) for name in task.mode_ranges}
    return replace(task, modes={**task.modes, mode: ranges}, sampling=replace(task.sampling, weights=weights))


def show(title: str, metrics: dict[str, Summary], console: Console) -> None:
    """Print metrics as a table."""
    table = Table(title=title, title_justify="left")
    for column in ("metric", "mean", "std", "95 % interval", "n"):
        table.add_column(column, justify="left" if column == "metric" else "right")
    for name, summary in metrics.items():
        low, high = summary["ci95"]  # type: ignore[misc]
        interval = f"{low:.3f} .. {high:.3f}"
        table.add_row(name, f"{summary['mean']:.3f}", f"{summary['std']:.3f}", interval, str(summary["n"]))
    console.print(table)


def _run(arguments: list[str]) -> None:
    config, overrides = cli.parse(EvalConfig, arguments, PROGRAM, cli.task_keys(TaskConfig))
    loaded = load_policy(config.run)
    task = protocol_task(loaded, overrides, config)
    out = Path(config.out) if config.out else _default_out(loaded, config)
    out.mkdir(parents=True, exist_ok=True)
    distance = config.max_distance if config.protocol == "endless" else None
    console = Console()
    report: dict[str, Any] = {
        "run": str(loaded.path),
        "task": task.name,
        "protocol": config.protocol,
        "overrides": overrides,
        "scene": config.scene,
        "seed": config.seed,
        "num_timesteps": loaded.info.get("num_timesteps"),
        "physics_dt": task.physics_dt,
        "versions": loaded.info.get("versions"),
    }
    if config.grid:
        report["grid"] = evaluate_grid(loaded, task, config)
        _write(out, report)
        plot_grid(report["grid"], "return", out / "grid.png")
        console.print(f"{out / 'grid.png'}")
    elif config.robustness:
        sweeps = disturbance_sweeps(training_task(loaded, overrides, config).randomisation)
        with progress_bar(config.episodes * episode_sets(sweeps), "episode") as bar:
            report["robustness"] = play_sweeps(
                sweeps, loaded.policy, task, config.episodes, config.seed, distance, bar.update
            )
        _write(out, report)
        write_csv(report["robustness"], out / "robustness.csv")
        plot_robustness(report["robustness"], out / "robustness.png")
        console.print(f"{out / 'robustness.png'}, {out / 'robustness.csv'}")
    else:
        with progress_bar(config.episodes, "episode") as bar:
            records = play_episodes(loaded.policy, task, config.episodes, config.seed, distance, bar.update)
        report["metrics"] = evaluate(task, records)
        report["groups"] = by_word(task, records)
        report["median_distance_m"] = float(np.median([registry.metrics.get("distance_m")(r) for r in records]))
        causes = [r.termination for r in records]
        report["terminations"] = {cause: causes.count(cause) for cause in sorted(set(causes))}
        _write(out, report)
        show(f"{task.name}, {config.episodes} episodes, physics step {task.physics_dt} s", report["metrics"], console)
        for group, metrics in report["groups"].items():
            show(group, metrics, console)
        ended = ", ".join(f"{cause} {count}" for cause, count in report["terminations"].items())
        console.print(f"Ended by: {ended}. Median distance {report['median_distance_m']:.2f} m.")
    console.print(f"{out / 'metrics.json'}")


def _default_out(loaded: LoadedPolicy, config: EvalConfig) -> Path:
    run = Path(config.run)
    return run / "evaluation" if run.is_dir() else Path("evaluation") / loaded.path.name


def _write(out: Path, report: dict[str, Any]) -> None:
    (out / "metrics.json").write_text(json.dumps(report, indent=1), encoding="utf-8")


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
