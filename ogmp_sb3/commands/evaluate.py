"""``ogmp-eval``: how good a policy is, by the paper's test protocol, with confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from rich.console import Console

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.named_run import RUN, named_run
from ogmp_sb3.config.catalogue import shown_path
from ogmp_sb3.config.scenes import task_for_test
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.evaluation.analysis import Analysis, Report, Request
from ogmp_sb3.evaluation.endless import MAX_DISTANCE, endless
from ogmp_sb3.evaluation.episodes import Progress, play_episodes
from ogmp_sb3.evaluation.epsilon import epsilon_rows, epsilon_tables, measure_epsilon
from ogmp_sb3.evaluation.evaluate import Evaluation, heading, measure, metric_names
from ogmp_sb3.evaluation.falls import falls_csv, falls_of, falls_tables, measure_falls
from ogmp_sb3.evaluation.grid import CELL_EPISODES, count_cells, grid_copies_text, measure_grid
from ogmp_sb3.evaluation.robustness import count_sets, measure_robustness, robustness_copies_text, robustness_rows
from ogmp_sb3.evaluation.worst_case import (
    POINT_EPISODES,
    count_points,
    measure_worst_case,
    worst_case_rows,
    worst_case_tables,
)
from ogmp_sb3.guidance.course import extent
from ogmp_sb3.report.page import write_csv
from ogmp_sb3.report.plots.evaluations import plot_epsilon, plot_grids, plot_robustness
from ogmp_sb3.report.plots.falls import plot_falls
from ogmp_sb3.runs.callbacks import steps_bar
from ogmp_sb3.runs.policies import LoadedPolicy, load_policy
from ogmp_sb3.runs.run_directory import default_out
from ogmp_sb3.runs.settings import versions
from ogmp_sb3.runs.storage import save_json

PROGRAM = "ogmp-eval"
DISTURBANCES = "randomisation"  # key of a task; an analysis that uses it disturbs policies itself


def measure_metrics(request: Request, progress: Progress) -> Report:
    """The metrics of the task: what an :class:`Evaluation` is as plain data."""
    distance = request.max_distance
    records = play_episodes(request.policy, request.task, request.episodes, request.seed, distance, progress)
    return measure(request.task, records).as_data()


def show_metrics(report: Report, console: Console) -> None:
    """Print the metrics as tables."""
    console.print(Evaluation.from_data(report, heading(report["task"], report["episodes"], report["physics_dt"])))


def show_sentence(sentence: str, console: Console) -> None:
    """Print a sentence, unless it is empty."""
    if sentence:
        console.print(sentence)


METRICS = Analysis(name="metrics", measure=measure_metrics, show=show_metrics, endless=True)
ANALYSES = (
    Analysis(
        name="grid",
        measure=measure_grid,
        sets=count_cells,
        episodes=CELL_EPISODES,
        plot=lambda report, path: plot_grids([report["grid"]], "return", path),
        show=lambda report, console: show_sentence(grid_copies_text(report["grid"], report["episodes"]), console),
    ),
    Analysis(
        name="robustness",
        measure=measure_robustness,
        sets=count_sets,
        endless=True,
        training_keys=(DISTURBANCES,),
        refused_keys={"evaluation.randomisation": "disturbs one thing at a time; its ranges are 'randomisation'."},
        rows=robustness_rows,
        plot=lambda report, path: plot_robustness(report["robustness"], path),
        show=lambda report, console: show_sentence(robustness_copies_text(report), console),
    ),
    Analysis(
        name="worst_case",
        measure=measure_worst_case,
        sets=count_points,
        episodes=POINT_EPISODES,
        endless=True,
        training_keys=(DISTURBANCES,),
        refused_keys={"evaluation.randomisation": "looks through the ranges of 'randomisation'."},
        rows=worst_case_rows,
        show=lambda report, console: console.print(worst_case_tables(report)),
    ),
    Analysis(
        name="epsilon",
        measure=measure_epsilon,
        rows=epsilon_rows,
        plot=lambda report, path: plot_epsilon(report["epsilon"], path),
        show=lambda report, console: console.print(epsilon_tables(report["epsilon"])),
    ),
    Analysis(
        name="falls",
        measure=measure_falls,
        endless=True,
        rows=lambda report: falls_csv(falls_of(report)),
        plot=lambda report, path: plot_falls(falls_of(report), path),
        show=lambda report, console: console.print(falls_tables(report)),
    ),
)
"""What can be measured instead of the metrics, each asked for by the key of its name."""


@dataclass(frozen=True, kw_only=True)
class EvalConfig:
    """Keys of the command line."""

    run: str = cli.option(RUN)
    episodes: int | None = cli.option(
        f"how many episodes; null: {METRICS.episodes}, and {CELL_EPISODES} for each cell of a grid", None
    )
    seed: int = cli.option("episode i is seeded with seed + i", 0)
    protocol: Literal["paper", "endless"] = cli.option("paper: as in the task file; endless: to a fall", "paper")
    max_distance: float = cli.option("endless: an episode is over this far along the track, m", MAX_DISTANCE)
    scene: str | None = cli.option("modes to command, a shipped scene or a YAML file; null: the task's own", None)
    grid: str | None = cli.option("two parameters of a mode to vary, e.g. jump.w,jump.h", None)
    robustness: bool = cli.option("disturb the policy, one disturbance at a time, 'episodes' at each size", False)
    worst_case: bool = cli.option("look for the weakest point among all disturbances at once", False)
    disturbed: bool = cli.option("with the disturbances of the training, which a test does not have otherwise", False)
    epsilon: bool = cli.option("how far states stray from the reference of each oracle, by mode", False)
    falls: bool = cli.option("in which modes the robot falls, by size and by the mode before", False)
    out: str | None = cli.option("directory for the numbers and pictures; null: <run>/evaluation", None)
    robot: str | None = cli.option(cli.ROBOT, None)
    trust: bool = cli.option(cli.TRUST, False)
    task: str | None = cli.option(cli.ZIP_TASK, None)

    def __post_init__(self) -> None:
        if self.episodes is not None and self.episodes < 1:
            raise ValueError(f"'episodes' must be at least 1, found {self.episodes}.")
        if self.seed < 0:
            raise ValueError(f"'seed' must be at least 0, found {self.seed}.")
        if self.max_distance <= 0:
            raise ValueError(f"'max_distance' must be above 0, found {self.max_distance:g}.")
        names = [analysis.name for analysis in self.analyses]
        if len(names) > 1:
            raise ValueError(f"{' and '.join(map(repr, names))} are different evaluations: give one of them.")
        if self.disturbed and DISTURBANCES in self.analysis.training_keys:
            raise ValueError(f"'{names[0]}' disturbs the policy itself: leave 'disturbed=true' out.")
        if self.protocol == "endless" and not self.analysis.endless:
            raise ValueError(f"'{self.analysis.name}' plays the task's own protocol, not 'protocol=endless'.")
        if self.protocol == "paper" and self.max_distance != MAX_DISTANCE:
            raise ValueError("'max_distance' is for 'protocol=endless' alone.")

    @property
    def analyses(self) -> list[Analysis]:
        """Those that are asked for instead of the metrics."""
        return [analysis for analysis in ANALYSES if getattr(self, analysis.name)]

    @property
    def analysis(self) -> Analysis:
        """The one that is asked for, else the metrics."""
        return next(iter(self.analyses), METRICS)


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
        "ogmp-eval run=parkour worst_case=true randomisation.friction.coefficient=[0.4,1.2]",
        "ogmp-eval run=parkour disturbed=true randomisation.mass.scale=[0.8,1.2]",
        "ogmp-eval run=parkour epsilon=true",
        "ogmp-eval run=parkour falls=true protocol=endless",
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
    analysis = config.analysis
    for override in overrides:
        for key, reason in analysis.refused_keys.items():
            if override.startswith(key):
                raise ValueError(f"'{override}': '{analysis.name}' {reason}")
    keys = (DISTURBANCES,) if config.disturbed else analysis.training_keys
    return task_for_test(loaded.task_data, loaded.task_path, overrides, config.scene, PROGRAM, keys)


def protocol_task(trained: TaskConfig, config: EvalConfig) -> TaskConfig:
    """A task under the protocol wanted.

    :param trained: of :func:`training_task`
    :raises ValueError: if the protocol or a metric is not for such a task
    """
    task = trained.for_evaluation()
    if config.disturbed:
        if not trained.randomised:
            example = "randomisation.mass.scale=[0.8,1.2]"
            raise ValueError(f"'disturbed=true': '{task.name}' has no 'randomisation'; give some, e.g. {example}.")
        task = replace(task, randomisation=trained.randomisation)
    metric_names(task)
    if config.protocol == "endless":
        if extent(task).timed:
            raise ValueError(f"'protocol=endless' is for tracks: the modes of '{task.name}' take a time.")
        task = endless(task, config.max_distance)
    return task


def _run(arguments: list[str]) -> None:
    config, overrides = cli.parse(EvalConfig, arguments, PROGRAM, cli.task_keys(TaskConfig))
    run = named_run(PROGRAM, config.run)
    loaded = load_policy(run, config.trust, config.task, config.robot)
    analysis, request = config.analysis, _request(config, loaded, overrides)
    out = Path(config.out) if config.out else default_out(run, loaded.name, "evaluation")
    cli.check_out(out)
    with steps_bar(analysis.sets(request) * request.episodes * request.task.episode_steps) as bar:
        result = analysis.measure(request, bar.update)
    report = {**_origin(config, loaded, overrides, request), **result}
    files = _write(analysis, report, out)
    console = cli.console()
    if analysis.show is not None:
        analysis.show(report, console)
    console.print(", ".join(map(str, files)))


def _request(config: EvalConfig, loaded: LoadedPolicy, overrides: list[str]) -> Request:
    """What the command line asks the analysis to measure."""
    task = training_task(loaded, overrides, config)
    return Request(
        policy=loaded,
        task=protocol_task(task, config),
        training_task=task,
        trained_task=loaded.task,
        value=getattr(config, config.analysis.name, None),
        episodes=config.episodes or config.analysis.episodes,
        seed=config.seed,
        max_distance=config.max_distance if config.protocol == "endless" else None,
    )


def _origin(config: EvalConfig, loaded: LoadedPolicy, overrides: list[str], request: Request) -> Report:
    """Which policy was measured, and how: the head of every report."""
    return {
        "run": shown_path(loaded.path),
        "policy": loaded.digest,
        "task": request.task.name,
        "protocol": config.protocol,
        "max_distance": request.max_distance,
        "overrides": overrides,
        "robot": config.robot,
        "scene": config.scene,
        "seed": config.seed,
        "episodes": request.episodes,
        "stream": "test",
        "num_timesteps": loaded.info.get("num_timesteps"),
        "physics_dt": request.task.physics_dt,
        "versions": versions(),
    }


def _write(analysis: Analysis, report: Report, out: Path) -> list[Path]:
    """Write the report, its picture and its table.

    :return: the files: picture, table, report, as far as there are such
    """
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"{analysis.name}.json"
    save_json(file, report)
    files = [file]
    if analysis.rows is not None:
        files.insert(0, file.with_suffix(".csv"))
        write_csv(files[0], analysis.rows(report))
    if analysis.plot is not None:
        files.insert(0, file.with_suffix(".png"))
        analysis.plot(report, files[0])
    return files


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
