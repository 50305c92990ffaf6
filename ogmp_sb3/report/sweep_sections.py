"""The sections of a report on a sweep."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.rewards import highest_reward
from ogmp_sb3.evaluation.copies import copies_in_sets_text
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy, rank_key
from ogmp_sb3.evaluation.metrics import highest_objective
from ogmp_sb3.guidance.admissible import standing_deviation, standing_still
from ogmp_sb3.report.page import Picture, Rows, Section, Table, Video, make_picture, write_csv
from ogmp_sb3.report.panels import Sweep, brief, jobs_along, label_of, mean_curve, shown
from ogmp_sb3.report.plots.evaluations import plot_terminations
from ogmp_sb3.report.plots.trainings import plot_objectives, plot_sweep_curves
from ogmp_sb3.report.run_sections import interval, metrics_rows, protocol, traces_picture
from ogmp_sb3.runs.callbacks import steps_bar
from ogmp_sb3.runs.multirun import setting
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import Run

RETURN = "episode/return"
SURROGATE, TRUE = "surrogate: return", "true objective"
OBJECTIVES = {SURROGATE: "return", TRUE: "true_objective"}  # names of their metrics
MOST_TRACES = 10  # in a picture of motion traces; the ready sweep over rho has ten bounds

Subjects = dict[Path, EvaluatedPolicy]
Evaluations = dict[Path, Evaluation]


def load_subjects(
    sweep: Sweep, policy: str, overrides: list[str], out: Path | None = None, robot: str | None = None
) -> tuple[Subjects, dict[Path, str]]:
    """The policies of the jobs, and the reasons why jobs have none, both by directory.

    :param policy: ``latest`` or ``best``
    :param overrides: of the task, ``key=value``
    :param out: where the results of jobs are kept whose own directories cannot be written
    :param robot: in place of those of the jobs
    """
    subjects, notes = {}, {job.path: job.problem for job in sweep.jobs}
    for job in sweep.jobs:
        if not job.config:
            continue
        try:
            loaded = load_policy(job.path / "best" if policy == "best" else job.path, robot=robot)
        except (ValueError, KeyError) as error:
            notes[job.path] = str(error.args[0])
        else:
            subjects[job.path] = EvaluatedPolicy(loaded, overrides, job.path, out)
    return subjects, notes


def evaluate_jobs(subjects: Subjects, episodes: int, seed: int) -> Evaluations:
    """The evaluations of all jobs that have a policy, by directory."""
    evaluations = {}
    with steps_bar(sum(each.evaluation_steps(episodes, seed) for each in subjects.values()), "evaluation") as bar:
        for path, subject in subjects.items():
            evaluations[path] = subject.evaluation(episodes, seed, bar.update)
    return evaluations


def overview(sweep: Sweep, subjects: Subjects, folder: Path) -> Section:
    """What was swept, and how far it got."""
    states = Counter(job.state for job in sweep.jobs)
    tasks = [subject.loaded.task for subject in subjects.values()]
    versions = {
        ", ".join(f"{name} {version}" for name, version in (subject.loaded.info.get("versions") or {}).items())
        for subject in subjects.values()
    }
    rows = [
        ["directory", str(folder)],
        ["task", ", ".join(dict.fromkeys(f"{task.name}: {task.description}" for task in tasks)) or "none was loaded"],
        ["swept", "; ".join(f"{key}: {_values(sweep, key)}" for key in sweep.keys) or "nothing"],
        ["least reward of a step", ", ".join(dict.fromkeys(shown(task.min_step_reward) for task in tasks))],
        ["jobs", ", ".join(f"{count} {state}" for state, count in states.items())],
        ["versions", "; ".join(sorted(versions))],
    ]
    return Section("Sweep", "", [Table(rows)])


def _values(sweep: Sweep, key: str) -> str:
    return ", ".join(dict.fromkeys(shown(setting(job, key)) for job in sweep.jobs))


def curves(sweep: Sweep, subjects: Subjects, out: Path) -> Section | None:
    """Training curves over the swept keys."""
    rows: Rows = []
    for panel in sweep.panels:
        for line in panel.lines:
            curve = mean_curve(line.runs, RETURN)
            for samples, mean, low, high in zip(*(curve[k] for k in ("samples", "mean", "low", "high")), strict=True):
                rows.append({
                    "panel": panel.title, "line": brief(line.value), "samples": samples, "mean": mean, "low": low,
                    "high": high,
                })  # fmt: skip
    if not rows:
        return None
    caption = (
        f"Return of training episodes, one line for each {sweep.line_key}. Where jobs differ in the seed alone, the "
        "line is the mean of those that have got so far, and the band goes from the least to the greatest."
    )
    standing = _standing(sweep, subjects)
    if standing is not None:
        caption += f" {_range(standing)}: a bound beyond that lets it stand."
    picture = make_picture(out, "training", caption, rows, lambda path: plot_sweep_curves(rows, sweep.line_key, path))
    return Section("Training", "", [picture])


def objectives(sweep: Sweep, subjects: Subjects, evaluations: Evaluations, out: Path) -> Section | None:
    """Surrogate and true objective against the swept key, with their upper bounds."""
    rows: Rows = []
    for objective, metric in OBJECTIVES.items():
        for panel in sweep.panels:
            for line in panel.lines:
                estimates = [evaluations[run.path].metrics[metric] for run in line.runs if run.path in evaluations]
                if estimates:
                    means, only = [each.mean for each in estimates], estimates[0]
                    low, high = (only.low, only.high) if len(means) == 1 else (min(means), max(means))
                    rows.append({
                        "objective": objective, "line": panel.title, "value": brief(line.value),
                        "mean": float(np.mean(means)), "low": low, "high": high, "seeds": len(means),
                    })  # fmt: skip
    if not rows:
        return None
    tasks = [subject.task for subject in subjects.values()]
    bounds = {SURROGATE: _common(map(highest_return, tasks)), TRUE: _common(map(highest_objective, tasks))}
    standing = _standing(sweep, subjects)
    meanings = ", ".join(dict.fromkeys(task.objective for task in tasks))
    caption = (
        f"The surrogate objective, as undiscounted return, and the true objective ({meanings}) against "
        f"{sweep.line_key}. Of one training, the bar is the 95 % interval of the mean over its episodes. Of several "
        "that differ in the seed alone, the point is the mean over the trainings, and the bar goes from the least to "
        "the greatest of them. Red: the highest reward at every step, and the end of the test track (1 for a dive)."
    )
    if standing is not None:
        caption += f" {_range(standing)} (grey): a bound beyond that lets it stand."
    picture = make_picture(
        out, "objectives", caption, rows, lambda path: plot_objectives(rows, sweep.line_key, bounds, standing, path)
    )
    return Section("Objectives", "", [picture])


def _standing(sweep: Sweep, subjects: Subjects) -> tuple[float, float] | None:
    """The values of rho above which the robot may stand still; None over another key, or if jobs differ in them."""
    if sweep.line_key != "rho":
        return None
    return _common(standing_deviation(subject.loaded.task) for subject in subjects.values())  # type: ignore[no-any-return]


def _range(standing: tuple[float, float]) -> str:
    low, high = standing
    return f"A robot that stands still deviates by {low:.2f} to {high:.2f}, from the easiest to the hardest mode"


def highest_return(task: TaskConfig) -> float | None:
    """The highest return of an episode of the test protocol, None if it is not known."""
    reward = highest_reward(task.rewards)
    return None if reward is None else reward * task.evaluation.episode_steps


def _common(values: Any) -> Any:
    """The value that all jobs share, else None."""
    different = set(values)
    return different.pop() if len(different) == 1 else None


def jobs(sweep: Sweep, subjects: Subjects, notes: dict[Path, str]) -> Section:
    """Every job with its state."""
    rows = []
    for job in sweep.jobs:
        subject = subjects.get(job.path)
        samples = "none" if subject is None or subject.samples is None else f"{subject.samples:,}"
        remarks = [standing_still(subject.loaded.task) if subject else None, notes.get(job.path)]
        returned = job.final(RETURN)
        rows.append([
            _label(job, sweep), job.state, f"{job.samples:,}", "" if np.isnan(returned) else f"{returned:.1f}", samples,
            ". ".join(filter(None, remarks)),
        ])  # fmt: skip
    columns = [
        "job",
        "state",
        "samples",
        "training return",
        "samples of the policy",
        "standing still, and what went wrong",
    ]
    text = (
        "The training return is the mean of the last rows of progress.csv. A job that is stopped goes on with "
        "ogmp-train resume=<its directory>; one that failed left no checkpoint; a missing one was asked for but is "
        "not there; a damaged one has a file that cannot be read."
    )
    return Section("Jobs", text, [Table(rows, columns)])


def evaluation(
    sweep: Sweep, subjects: Subjects, evaluations: Evaluations, episodes: int, seed: int, out: Path
) -> Section | None:
    """The metrics of every job that has a policy."""
    if not evaluations:
        return None
    measured = [(_label(job, sweep), evaluations[job.path]) for job in sweep.jobs if job.path in evaluations]
    groups = []
    for label, result in measured:
        groups += [(label, result.metrics), *((f"{label}, {name}", m) for name, m in result.groups.items())]
    write_csv(out / "metrics.csv", metrics_rows(groups))
    names = list(dict.fromkeys(name for _, result in measured for name in result.metrics))
    rows = [
        [label, *(interval(result.metrics[name]) if name in result.metrics else "" for name in names)]
        for label, result in measured
    ]
    causes = [(label, result.terminations) for label, result in measured]
    picture = make_picture(
        out, "terminations", "What ended the episodes.",
        [{"job": job, "cause": cause, "episodes": n} for job, counts in causes for cause, n in counts.items()],
        lambda path: plot_terminations(causes, path),
    )  # fmt: skip
    text = " ".join(dict.fromkeys(protocol(subject.task, episodes, seed) for subject in subjects.values()))
    counted = (result.episodes - result.copies for _, result in measured)
    text = f"{text} {copies_in_sets_text(counted, episodes, 'jobs')}".rstrip()
    return Section("Evaluation", text, [Table(rows, ["job", *names], files=["metrics.csv"]), picture])


def _label(job: Run, sweep: Sweep) -> str:
    return label_of(job, sweep.keys) or job.path.name


def motion(
    sweep: Sweep, subjects: Subjects, evaluations: Evaluations, seed: int, variants: list[str], out: Path
) -> Section | None:
    """Motion traces of policies that differ in one key alone, a picture for each key that was swept."""
    parts: list[Table | Picture | Video] = []
    tested = [job for job in sweep.jobs if job.path in subjects]
    for key in variants:
        policies = jobs_along(key, tested, sweep.keys, lambda job: rank_key(evaluations[job.path]))
        if key not in sweep.keys or not policies:
            continue
        chosen = [policies[i] for i in evenly_spaced(len(policies))]
        traces = [trace for job in chosen for trace in subjects[job.path].traces(1, seed, _label(job, sweep))]
        others = label_of(chosen[0], [other for other in sweep.keys if other != key])
        caption = f"Policies that differ in {key} alone, on the episode of seed {seed}."
        if others:
            caption += f" All have {others}."
        if len(chosen) < len(policies):
            caption += f" Shown are {len(chosen)} of {len(policies)} values."
        parts.append(traces_picture(out, f"traces_{key}", caption, traces))
    return Section("Motion", "", parts) if parts else None


def evenly_spaced(count: int) -> list[int]:
    """The indices of the traces to draw: all, or as many as fit, the first and the last among them."""
    return [round(i) for i in np.linspace(0, count - 1, min(count, MOST_TRACES))]
