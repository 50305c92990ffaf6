"""``ogmp-report``: what a run or a sweep came to, as one page to read and the pictures and data to go with it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from glob import glob
from pathlib import Path
from typing import Literal

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.named_run import RUN, named_run
from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.yaml_files import read_value
from ogmp_sb3.evaluation.endless import MAX_DISTANCE
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy
from ogmp_sb3.evaluation.grid import CELLS, MAX_CELLS, default_grids
from ogmp_sb3.guidance.course import extent
from ogmp_sb3.report import falls_section as report_falls
from ogmp_sb3.report import run_sections as report_run
from ogmp_sb3.report import sweep_sections as report_sweep
from ogmp_sb3.report.headline import STRIP, VIDEO, film_of, headline, replay_of
from ogmp_sb3.report.heat_maps import heat_maps, heat_maps_to_come
from ogmp_sb3.report.page import Section, write_page
from ogmp_sb3.report.panels import shown, sweep_of
from ogmp_sb3.report.seeds_section import seed_groups, seeds
from ogmp_sb3.runs.callbacks import steps_bar
from ogmp_sb3.runs.multirun import read_runs, read_sweep
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import CONFIG, MULTIRUN, Run, default_out, owner, read_run

PROGRAM = "ogmp-report"
RUN_EPISODES, JOB_EPISODES = 100, 20
PAGE = "report.html"
RUNS_OUT = Path("report") / "runs"
RUN_ONLY = (
    "grids",
    "grid_cells",
    "cell_episodes",
    "traces",
    "endless",
    "max_distance",
    "film",
    "video",
    "trust",
    "task",
)
SWEEP_ONLY = ("policy",)


@dataclass(frozen=True, kw_only=True)
class ReportConfig:
    """Keys of the command line."""

    run: str | None = cli.option(RUN, None)
    sweep: str | None = cli.option("directory of a multirun (ogmp-train -m); either this or 'run'", None)
    runs: str | None = cli.option("or run directories to compare: a,b, or a pattern with *", None)
    out: str | None = cli.option("directory for the page; null: <run or sweep>/report; of 'runs', report/runs", None)
    policy: Literal["latest", "best"] = cli.option("sweep: which policy of each job: latest or best", "latest")
    episodes: int | None = cli.option(
        f"episodes of an evaluation; null: {RUN_EPISODES}, and {JOB_EPISODES} for each job of a sweep", None
    )
    seed: int = cli.option("episode i is seeded with seed + i", 0)
    grids: bool = cli.option("run: heat maps over mode parameters, which take minutes", True)
    grid_cells: int = cli.option("run: cells along each axis of a heat map", CELLS)
    cell_episodes: int = cli.option("run: episodes of each cell of a heat map", 10)
    traces: int = cli.option("run: episodes to draw as motion traces", 3)
    endless: int | None = cli.option("run: episodes on tracks without end, for survival curves; null: none", None)
    max_distance: float = cli.option("run: an endless episode is over this far along the track, m", MAX_DISTANCE)
    film: bool = cli.option("run: a strip of pictures of its first episode on top", True)
    video: bool = cli.option("run: a video of that episode too", False)
    replay: int | None = cli.option(
        "run: test episodes that those of a replay in 3-D are chosen from; null: no replay", 20
    )
    variants: str | None = cli.option(
        "motion traces side by side, under other values of some of these keys; sweep: those that were swept",
        ",".join(report_run.VARIANTS),
    )
    robot: str | None = cli.option(cli.ROBOT, None)
    trust: bool = cli.option(cli.TRUST, False)
    task: str | None = cli.option(cli.ZIP_TASK, None)

    def __post_init__(self) -> None:
        if sum(subject is not None for subject in (self.run, self.sweep, self.runs)) != 1:
            raise ValueError("give either 'run' or 'sweep', or 'runs' to compare some.")
        for field in fields(self):
            if self.run is None and field.name in RUN_ONLY and getattr(self, field.name) != field.default:
                kind = "a sweep" if self.runs is None else "several runs"
                raise ValueError(f"'{field.name}' is of a run: a report on {kind} does not use it.")
            if self.run is not None and field.name in SWEEP_ONLY and getattr(self, field.name) != field.default:
                raise ValueError(
                    f"'{field.name}' is of a sweep; of a run, give the policy itself: run={self.run}/best."
                )
        least = {"episodes": 1, "seed": 0, "grid_cells": 1, "cell_episodes": 1, "traces": 1, "endless": 1, "replay": 1}
        for name, low in least.items():
            value = getattr(self, name)
            if value is not None and value < low:
                raise ValueError(f"'{name}' must be at least {low}, found {value}.")
        if self.max_distance <= 0:
            raise ValueError(f"'max_distance' must be above 0, found {self.max_distance:g}.")
        if self.endless is None and self.max_distance != MAX_DISTANCE:
            raise ValueError("'max_distance' is of endless tracks: give 'endless', how many episodes, too.")
        if self.grid_cells > MAX_CELLS:
            raise ValueError(f"'grid_cells' must be at most {MAX_CELLS}, found {self.grid_cells}.")


HELP = cli.usage(
    PROGRAM,
    "write a page about a run or a sweep: training, evaluation, motion, with all pictures and data beside it.",
    [
        "ogmp-report run=runs/parkour/2026-01-31_12-00-00",
        "ogmp-report run=parkour out=report grids=false",
        "ogmp-report run=runs/dive/2026-01-31_12-00-00/best variants=oracle traces=4",
        "ogmp-report sweep=runs/sweeps/2026-01-31_14-00-00 episodes=100",
        "ogmp-report runs=runs/parkour/2026-01-3* out=seeds",
    ],
    ReportConfig,
    "any other key of the task file, for the evaluations, e.g. evaluation.track_length=20",
)


def _run(arguments: list[str]) -> None:
    config, overrides = cli.parse(ReportConfig, arguments, PROGRAM, cli.task_keys(TaskConfig))
    variants = _variants(config.variants)
    if config.video:
        cli.require("viewer", "imageio_ffmpeg")
    if config.run is not None:
        page = _report_run(config, config.run, overrides, variants)
    elif config.sweep is not None:
        page = _report_sweep(config, Path(config.sweep), overrides, variants)
    else:
        assert config.runs is not None
        page = _report_runs(config, config.runs, overrides, variants)
    cli.console().print(str(page))


def _report_run(config: ReportConfig, name: str, overrides: list[str], variants: list[str]) -> Path:
    folder = Path(name)
    if (folder / MULTIRUN).is_file():
        raise ValueError(f"'{name}' is a multirun: give it as sweep={name}.")
    name = named_run(PROGRAM, name)
    loaded, home = load_policy(name, config.trust, config.task, config.robot), owner(name)
    run = read_run(home) if home and (home / CONFIG).is_file() else None
    out = Path(config.out) if config.out else default_out(name, loaded.name, "report")
    cli.check_out(out)
    subject = EvaluatedPolicy(loaded, overrides, home or out, out)
    if config.endless is not None and extent(subject.task).timed:
        raise ValueError(f"'endless' is for tracks: the modes of '{subject.task.name}' take a time.")
    grids = default_grids(subject.task, loaded.task, config.grid_cells) if config.grids else []
    out.mkdir(parents=True, exist_ok=True)
    episodes = config.episodes or RUN_EPISODES
    kinds = [kind for kind, wanted in ((STRIP, config.film), (VIDEO, config.video)) if wanted]
    with steps_bar(subject.evaluation_steps(episodes, config.seed), "evaluation") as bar:
        result = subject.evaluation(episodes, config.seed, bar.update)
    views = film_of(subject, config.seed, kinds, out)
    if config.replay is not None:
        views.append(replay_of(subject, config.replay, config.seed, out))
    above = [
        headline(subject, result, views),
        report_run.overview(subject, run),
        report_run.training(run, subject.loaded.task.rho, out) if run else None,
        report_run.evaluation(subject, result, config.seed, out),
        report_falls.falls(result.falls, out),
        report_falls.endless(subject, config.endless, config.seed, config.max_distance, out)
        if config.endless is not None
        else None,
        report_run.motion(subject, config.traces, config.seed, variants, out),
    ]
    below = [report_run.latents(subject, config.seed, out), report_run.videos(run.path) if run else None]
    title = run.path.name if run else loaded.name
    subtitle = f"{loaded.task.name}, {loaded.task.oracle} oracle, rho {shown(loaded.task.rho)}"
    if subject.grids_steps(grids, config.cell_episodes, config.seed):
        page = _write(out, title, subtitle, [*above, heat_maps_to_come(), *below])
        cli.note(PROGRAM, f"{page} has everything but the heat maps, which are measured now.")
    maps = heat_maps(subject, grids, config.cell_episodes, config.seed, out) if grids else None
    return _write(out, title, subtitle, [*above, maps, *below])


def _report_sweep(config: ReportConfig, folder: Path, overrides: list[str], variants: list[str]) -> Path:
    if not folder.is_dir():
        raise ValueError(f"'{folder}': no such directory.")
    if (folder / CONFIG).is_file():
        raise ValueError(f"'{folder}' is one run, not a multirun: give it as run={folder}.")
    out = Path(config.out) if config.out else folder / "report"
    return _report_jobs(config, read_sweep(folder), out, folder.resolve().name, str(folder), overrides, variants)


def _report_runs(config: ReportConfig, text: str, overrides: list[str], variants: list[str]) -> Path:
    folders = run_folders(text)
    out = Path(config.out) if config.out else RUNS_OUT
    where = ", ".join(map(str, folders))
    return _report_jobs(config, read_runs(folders), out, "Comparison of runs", where, overrides, variants)


def _report_jobs(
    config: ReportConfig,
    jobs: list[Run],
    out: Path,
    title: str,
    where: str,
    overrides: list[str],
    variants: list[str],
) -> Path:  # fmt: skip
    """A page about several trainings.

    :param where: their directories
    """
    sweep, episodes = sweep_of(jobs), config.episodes or JOB_EPISODES
    cli.check_out(out)
    subjects, notes = report_sweep.load_subjects(sweep, config.policy, overrides, out, config.robot)
    out.mkdir(parents=True, exist_ok=True)
    evaluations = report_sweep.evaluate_jobs(subjects, episodes, config.seed)
    groups = seed_groups(sweep, subjects, evaluations)
    sections = [
        report_sweep.overview(sweep, subjects, where),
        report_sweep.curves(sweep, subjects, out),
        report_sweep.objectives(sweep, subjects, groups, out),
        seeds(sweep, groups, out),
        report_sweep.jobs(sweep, subjects, notes),
        report_sweep.evaluation(sweep, subjects, evaluations, episodes, config.seed, out),
        report_sweep.motion(sweep, subjects, evaluations, config.seed, variants, out),
    ]
    swept = f" over {', '.join(sweep.keys)}" if sweep.keys else ""
    return _write(out, title, f"{len(sweep.jobs)} jobs{swept}", sections)


def run_folders(text: str) -> list[Path]:
    """The directories of runs to compare.

    :param text: ``a,b`` or ``[a, b]``, a pattern, which other directories that it matches are left out of, or one
        directory
    :raises ValueError: if the list cannot be read, or nothing matches a pattern
    """
    if text.startswith("["):
        entries = read_value(text)
    else:
        entries = [text] if Path(text).exists() or glob(text) else [part.strip() for part in text.split(",")]
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, str) for entry in entries):
        raise ValueError(f"'runs' must be directories, a,b, or a pattern, found {text}.")
    found: list[Path] = []
    for entry in entries:
        if Path(entry).is_dir():
            found.append(Path(entry))
            continue
        matches = sorted(
            path for path in map(Path, glob(entry)) if any((path / f).is_file() for f in (CONFIG, MULTIRUN))
        )
        if not matches:
            comma = ' A directory with a comma in its name is put in quotes: ["a,b"].' if "," in text else ""
            raise ValueError(f"'runs': no directory of a run is '{entry}'.{comma}")
        found += matches
    return found


def _write(out: Path, title: str, subtitle: str, sections: list[Section | None]) -> Path:
    write_page(out / PAGE, title, subtitle, [section for section in sections if section is not None])
    return out / PAGE


def _variants(text: str | None) -> list[str]:
    """The keys that motion traces are varied in."""
    keys = [key.strip() for key in (text or "").split(",") if key.strip()]
    for key in keys:
        if key not in report_run.VARIANTS:
            raise KeyError(f"unknown variant '{key}'{did_you_mean(key, report_run.VARIANTS)}")
    return keys


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
