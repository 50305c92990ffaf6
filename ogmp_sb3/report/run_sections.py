"""The sections of a report on one run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.catalogue import shown_path
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.evaluation.copies import copies_text
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy
from ogmp_sb3.evaluation.statistics import Estimate, Estimates, as_text
from ogmp_sb3.evaluation.traces import Trace, ground_rows, trace_rows
from ogmp_sb3.guidance.admissible import standing_still
from ogmp_sb3.guidance.latent import load_encoder
from ogmp_sb3.guidance.reference_data import reference_data
from ogmp_sb3.report.page import (
    Part,
    Picture,
    Rows,
    Section,
    Table,
    Video,
    data_uri,
    first_paragraph,
    fitting,
    make_picture,
    write_csv,
)
from ogmp_sb3.report.panels import shown
from ogmp_sb3.report.plots.evaluations import plot_terminations
from ogmp_sb3.report.plots.guidance import plot_latents
from ogmp_sb3.report.plots.traces import plot_traces
from ogmp_sb3.report.plots.trainings import SMOOTH, plot_training
from ogmp_sb3.report.speed_section import speed_parts
from ogmp_sb3.runs.logs import STEP_COLUMN
from ogmp_sb3.runs.provenance import BEGAN
from ogmp_sb3.runs.run_directory import Run, samples_text

# What motion traces are varied in (paper, fig:abl_trc); the oracles are those of the task.
VARIANTS: dict[str, tuple[Any, ...]] = {"oracle": (), "horizon": (7, 15, 30), "rho": (0.1, 0.5, 0.8)}
CURVES = {
    "episode/return": "return",
    "episode/length": "length (control steps)",
    "episode/distance": "distance (m)",
    "episode/level": "level of the curriculum",
    "episode/deviation": "mean deviation ‖W (x − x_ref)‖",
}
CAUSE = "termination/"
REFERENCES = 1000  # in the picture of the latent
THIN = "\N{NARROW NO-BREAK SPACE}"
LARGEST_VIDEO = 5_000_000  # bytes that are put into the page


def overview(subject: EvaluatedPolicy, run: Run | None) -> Section:
    """What was trained, and on what."""
    task, info = subject.loaded.task, subject.loaded.info
    weights = ", ".join(f"{name} {weight:g}" for name, weight in task.bound.items() if weight)
    rows = [
        ["task", f"{task.name}: {task.description}"],
        ["oracle", task.oracle],
        ["horizon", "one mode" if task.horizon is None else f"{task.horizon} control steps of {task.control_dt:g} s"],
        ["rho", "off (unguided)" if task.rho is None else f"{task.rho:g} (W: {weights})"],
        ["standing still", standing_still(task) or "not bounded by rho in this task"],
        ["least reward of a step", "off" if task.min_step_reward is None else f"{task.min_step_reward:g}"],
        ["observations", ", ".join(name for name, parameters in task.observations.items() if parameters is not None)],
        ["seed", str(info.get("seed", "not recorded"))],
        ["samples", _samples(subject, run)],
        ["versions", ", ".join(f"{name} {version}" for name, version in (info.get("versions") or {}).items())],
        ["policy", shown_path(subject.loaded.path)],
    ]
    if run is not None:
        rows += _circumstances(run)
    if subject.overrides:
        rows.append(["evaluated with", " ".join(subject.overrides)])
    return Section("Run", "", [Table(rows)])


def _circumstances(run: Run) -> list[list[str]]:
    """When, where, for how long and by which command it was trained, as far as that is recorded."""
    began = run.config.get(BEGAN, {})
    rows = [[key, str(began[key])] for key in ("date", "machine", "commit") if key in began]
    if run.seconds:
        pace = f"{run.samples / run.seconds:,.0f} samples/s, pauses left out"
        rows.insert(min(1, len(rows)), ["trained for", f"{duration(run.seconds)}, {pace}"])
    return [*rows, *([["command", run.command]] if run.overrides else [])]


def duration(seconds: float) -> str:
    """A time in hours and minutes."""
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"


def _samples(subject: EvaluatedPolicy, run: Run | None) -> str:
    text = "not recorded" if subject.samples is None else samples_text(subject.samples)
    if run is None:
        return text
    total = run.config.get("train", {}).get("total_timesteps")
    return f"{text}; the run is {run.state}, with {samples_text(run.samples)} of {samples_text(total)}"


def training(run: Run, rho: float | None, out: Path) -> Section | None:
    """Curves of ``progress.csv``."""
    if not run.log:
        return None
    columns = {column: label for column, label in CURVES.items() if np.isfinite(run.log.get(column, np.nan)).any()}
    causes = {column: column.removeprefix(CAUSE) for column in run.log if column.startswith(CAUSE)}
    names = [STEP_COLUMN, *columns, *causes]
    rows = [dict(zip(names, values, strict=True)) for values in zip(*(run.log[name] for name in names), strict=True)]
    caption = (
        f"Training episodes, exploration noise on: means over {SMOOTH} rows of progress.csv, the rows themselves "
        "behind. Last: the share of episodes that each rule ended."
    )
    picture = make_picture(
        out, "training", caption, rows, lambda path: plot_training(run.log, columns, causes, rho, path)
    )
    return Section("Training", "", [picture])


def evaluation(subject: EvaluatedPolicy, result: Evaluation, seed: int, out: Path) -> Section:
    """Metrics with confidence intervals, and what ended the episodes.

    :param result: of the policy
    :param seed: of its first episode
    """
    causes = result.terminations
    parts: list[Part] = [metrics_table(subject.task, result.metrics)]
    write_csv(out / "metrics.csv", metrics_rows([("all", result.metrics), *result.groups.items()]))
    parts.append(
        make_picture(
            out, "terminations", "What ended the episodes.",
            [{"cause": cause, "episodes": count} for cause, count in causes.items()],
            lambda path: plot_terminations([("", causes)], path),
        )
    )  # fmt: skip
    parts += speed_parts(result.speeds, out)
    if result.groups:
        names = list(next(iter(result.groups.values())))
        rows = [[group, *(interval(metrics[name]) for name in names)] for group, metrics in result.groups.items()]
        parts += fitting(Table(rows, ["", *names], "By the words among the parameters of the first mode."))
    text = f"{protocol(subject.task, result.episodes, seed)} {copies_text(result.copies, result.episodes)}".rstrip()
    return Section("Evaluation", text, parts)


def protocol(task: TaskConfig, episodes: int, seed: int) -> str:
    """A sentence on how policies are evaluated."""
    test = task.evaluation
    track = "" if test.track_length is None else f" on a track of {test.track_length:g} m, flat ground behind it"
    starts = "" if test.initial is None else " Robots begin in states that are drawn."
    ends = ", ".join(name for name, parameters in test.terminations.items() if parameters is not None)
    return (
        f"{task.name}: {episodes} episodes with seeds {seed} to {seed + episodes - 1} and deterministic actions, at "
        f"most {test.episode_steps} control steps{track}.{starts} The bound and the least reward of a step are off; an "
        f"episode ends earlier only by: {ends or 'nothing'}. Intervals are of the mean over the episodes, at 95 %: "
        f"Student's, Wilson's for yes or no; they say nothing on another seed. Physics step {task.physics_dt:g} s, on "
        "which accelerations depend."
    )


def metrics_table(task: TaskConfig, metrics: Estimates) -> Table:
    """Every metric with its interval and its meaning."""
    rows = []
    for name, each in metrics.items():
        kinds, key = (registry.objectives, task.objective) if name == "true_objective" else (registry.metrics, name)
        mean, std = as_text([each.mean]), as_text([each.std])
        between = as_text([each.low, each.high], 3, f"{THIN}…{THIN}")
        rows.append([name, mean, between, std, str(each.n), first_paragraph(kinds.get(key))])
    return Table(rows, ["metric", "mean", "95 % interval", "std", "n", "meaning"], files=["metrics.csv"])


def metrics_rows(groups: list[tuple[str, Estimates]]) -> Rows:
    """Metrics of groups of episodes, each with its name, as a table for a file."""
    return [
        {
            "group": group, "metric": name, "mean": each.mean, "low": each.low, "high": each.high,
            "std": each.std, "n": each.n,
        }
        for group, metrics in groups
        for name, each in metrics.items()
    ]  # fmt: skip


def interval(estimate: Estimate) -> str:
    """Mean and interval in one cell."""
    return f"{estimate.mean:.2f} [{as_text([estimate.low, estimate.high], 2, f',{THIN}')}]"


def motion(subject: EvaluatedPolicy, episodes: int, seed: int, variants: list[str], out: Path) -> Section:
    """Motion traces of the first episodes, and of one episode under other oracles, horizons and bounds."""
    parts: list[Part] = [traces_picture(out, "traces", "The first episodes.", subject.traces(episodes, seed))]
    for key in variants:
        values = _values(subject.task, key)
        if not values:
            continue
        traces = [
            trace for value in values for trace in subject.traces(1, seed, f"{key} = {value}", (f"{key}={value}",))
        ]
        ends = " The bound ends the episode." if key == "rho" else ""
        trained = shown(getattr(subject.loaded.task, key))
        caption = f"The same policy, trained with {key} = {trained}, under other values.{ends}"
        parts.append(traces_picture(out, f"traces_{key}", caption, traces))
    text = (
        "The way of the base (black; grey strokes along the trunk) and what the oracle answered to each query (orange, "
        "a dot at the query). The colour of the ground is that of the mode that laid it. Below: the deviation from "
        "the reference in the norm of the bound, which is not enforced here unless said."
    )
    return Section("Motion", text, parts)


def _values(task: TaskConfig, key: str) -> tuple[Any, ...]:
    """What a key is varied over; timed modes have no horizon."""
    if key == "oracle":
        return tuple(task.oracle_params)
    return () if key == "horizon" and task.horizon is None else VARIANTS[key]


def traces_picture(out: Path, name: str, caption: str, traces: list[Trace]) -> Picture:
    """Motion traces with their data, the ground in a file of its own."""
    rows, ground = trace_rows(traces), ground_rows(traces)
    return make_picture(out, name, caption, rows, lambda path: plot_traces(traces, path), ground=ground)


def latents(subject: EvaluatedPolicy, seed: int, out: Path) -> Section | None:
    """What the policy's encoder makes of references along random courses, by mode and parameter."""
    task = subject.loaded.task
    if not task.uses_latent or task.encoder is None:
        return None
    data = reference_data(replace(task, curriculum=None), REFERENCES, np.random.SeedSequence(seed))
    latent = load_encoder(task.encoder)(data.state, data.steps)
    keys = dict.fromkeys(key for call in data.calls for key in call.parameters)
    rows = [
        {
            "mode": call.name,
            **{key: call.parameters.get(key, "") for key in keys},
            **{f"z{i}": z for i, z in enumerate(point, start=1)},
        }
        for call, point in zip(data.calls, latent, strict=True)
    ]
    caption = (
        f"The latent of {REFERENCES} references that robots ask for along random courses; by the mode under the base, "
        "and by each parameter of it that varies."
    )
    picture = make_picture(out, "latents", caption, rows, lambda path: plot_latents(latent, data.calls, path))
    return Section("Mode latent", "", [picture])


def videos(folder: Path) -> Section | None:
    """The videos that lie in a run directory."""
    parts: list[Part] = []
    for path in sorted(folder.glob("*.mp4")):
        size = path.stat().st_size
        if size < LARGEST_VIDEO:
            parts.append(Video(path.name, data_uri(path, "video/mp4")))
        else:
            parts.append(Table([[path.name, f"{path}: {size / 1e6:.1f} MB, too large for the page"]]))
    return Section("Video", "", parts) if parts else None
