"""The sections of a report on a sweep."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ogmp_sb3.evaluation.copies import copies_in_sets_text
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy, rank_key
from ogmp_sb3.evaluation.metrics import highest_objective, highest_return
from ogmp_sb3.evaluation.seeds import few_seeds_text
from ogmp_sb3.guidance.admissible import standing_deviation, standing_still
from ogmp_sb3.report.page import Part, Rows, Section, Table, fitting, make_picture, write_csv
from ogmp_sb3.report.panels import Sweep, brief, jobs_along, label_of, mean_curve, shown
from ogmp_sb3.report.plots.evaluations import plot_terminations
from ogmp_sb3.report.plots.trainings import FOR_BAND, plot_objectives, plot_sweep_curves
from ogmp_sb3.report.run_sections import interval, metrics_rows, protocol, traces_picture
from ogmp_sb3.report.seeds_section import SeedGroup
from ogmp_sb3.runs.callbacks import steps_bar
from ogmp_sb3.runs.logs import STEP_COLUMN
from ogmp_sb3.runs.multirun import setting
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import RETURN, Run, samples_text

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


def overview(sweep: Sweep, subjects: Subjects, where: str) -> Section:
    """What was swept, and how far it got.

    :param where: the directories
    """
    states = Counter(job.state for job in sweep.jobs)
    tasks = [subject.loaded.task for subject in subjects.values()]
    versions = {
        ", ".join(f"{name} {version}" for name, version in (subject.loaded.info.get("versions") or {}).items())
        for subject in subjects.values()
    }
    rows = [
        ["directory", where],
        ["task", ", ".join(dict.fromkeys(f"{task.name}: {task.description}" for task in tasks)) or "none was loaded"],
        ["swept", "; ".join(f"{key}: {_values(sweep, key)}" for key in sweep.keys) or "nothing"],
        ["least reward of a step", ", ".join(dict.fromkeys(shown(task.min_step_reward) for task in tasks))],
        ["jobs", ", ".join(f"{count} {state}" for state, count in states.items())],
        ["seeds", _seeds_text(sweep)],
        ["versions", "; ".join(sorted(versions))],
    ]
    return Section("Sweep", "", [Table(rows)])


def _seeds_text(sweep: Sweep) -> str:
    counts = sorted({len(line.runs) for panel in sweep.panels for line in panel.lines})
    if not counts:
        return "none"
    number = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    alone = few_seeds_text(1) if counts == [1] else ""
    return f"{number} of each setting. {alone}".rstrip()


def _values(sweep: Sweep, key: str) -> str:
    return ", ".join(dict.fromkeys(shown(setting(job, key)) for job in sweep.jobs))


def curves(sweep: Sweep, subjects: Subjects, out: Path) -> Section | None:
    """Training curves over the swept keys."""
    rows: Rows = []
    single: Rows = []
    for panel in sweep.panels:
        for line in panel.lines:
            where, curve = {"panel": panel.title, "line": brief(line.value)}, mean_curve(line.runs, RETURN)
            points = zip(*curve.values(), strict=True)
            rows += [{**where, **dict(zip(curve, point, strict=True))} for point in points]
            single += [
                {**where, "seed": seed, "samples": samples, "return": value}
                for run, seed in zip(line.runs, line.seeds, strict=True)
                if len(line.runs) > 1 and RETURN in run.log
                for samples, value in zip(run.log[STEP_COLUMN], run.log[RETURN], strict=True)
            ]
    if not rows:
        return None
    caption = f"Return of training episodes, one line for each {sweep.line_key}."
    if single:
        caption += (
            " Where jobs differ in the seed alone, the line is the mean over the seeds that have got so far (thin: "
            f"each of them), and the band its 95 % interval over seeds, from {FOR_BAND} of them on."
        )
    standing = _standing(sweep, subjects)
    if standing is not None:
        caption += f" {_range(standing)}: a bound beyond that lets it stand."
    more = {"seeds": single} if single else {}
    picture = make_picture(
        out, "training", caption, rows, lambda path: plot_sweep_curves(rows, sweep.line_key, path, single), **more
    )
    return Section("Training", "", [picture])


def objectives(sweep: Sweep, subjects: Subjects, groups: Sequence[SeedGroup], out: Path) -> Section | None:
    """Surrogate and true objective against the swept key, with their upper bounds."""
    rows: Rows = []
    single: Rows = []
    for objective, metric in OBJECTIVES.items():
        for group in groups:
            where = {"objective": objective, "line": group.panel, "value": brief(group.value)}
            alone = len(group.evaluations) == 1
            found = group.evaluations[0].metrics[metric] if alone else group.statistics[metric].over_seeds
            rows.append({
                **where, "mean": found.mean, "low": found.low, "high": found.high,
                "interval": "over episodes" if alone else "over seeds", "seeds": len(group.evaluations),
                "episodes": group.statistics[metric].over_episodes.n,
            })  # fmt: skip
            single += [
                {**where, "seed": seed, "mean": each.metrics[metric].mean}
                for seed, each in zip(group.seeds, group.evaluations, strict=True)
                if not alone
            ]
    if not rows:
        return None
    tasks = [subject.task for subject in subjects.values()]
    bounds = {SURROGATE: _common(map(highest_return, tasks)), TRUE: _common(map(highest_objective, tasks))}
    standing = _standing(sweep, subjects)
    meanings = ", ".join(dict.fromkeys(task.objective for task in tasks))
    caption = (
        f"The surrogate objective, as undiscounted return, and the true objective ({meanings}) against "
        f"{sweep.line_key}. Of one training, the bar is the 95 % interval of the mean over its episodes. Of several "
        "that differ in the seed alone, the point is the mean over the seeds, the bar its 95 % interval over seeds; "
        "small circles are the single trainings. Red: the highest reward at every step, and the end of the test track "
        "(1 for a dive)."
    )
    if standing is not None:
        caption += f" {_range(standing)} (grey): a bound beyond that lets it stand."
    more = {"seeds": single} if single else {}

    def draw(path: Path) -> None:
        plot_objectives(rows, sweep.line_key, bounds, standing, path, single)

    return Section("Objectives", "", [make_picture(out, "objectives", caption, rows, draw, **more)])


def _standing(sweep: Sweep, subjects: Subjects) -> tuple[float, float] | None:
    """The values of rho above which the robot may stand still; None over another key, or if jobs differ in them."""
    if sweep.line_key != "rho":
        return None
    return _common(standing_deviation(subject.loaded.task) for subject in subjects.values())  # type: ignore[no-any-return]


def _range(standing: tuple[float, float]) -> str:
    low, high = standing
    return f"A robot that stands still deviates by {low:.2f} to {high:.2f}, from the easiest to the hardest mode"


def _common(values: Any) -> Any:
    """The value that all jobs share, else None."""
    different = set(values)
    return different.pop() if len(different) == 1 else None


def jobs(sweep: Sweep, subjects: Subjects, notes: dict[Path, str]) -> Section:
    """Every job with its state."""
    rows = []
    for job in sweep.jobs:
        subject = subjects.get(job.path)
        samples = "none" if subject is None or subject.samples is None else samples_text(subject.samples)
        remarks = [standing_still(subject.loaded.task) if subject else None, notes.get(job.path)]
        returned = job.final(RETURN)
        rows.append([
            _label(job, sweep), job.state, samples_text(job.samples),
            "" if np.isnan(returned) else f"{returned:.1f}", samples, ". ".join(filter(None, remarks)),
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
    tables = fitting(Table(rows, ["job", *names], files=["metrics.csv"]))
    causes = [(label, result.terminations) for label, result in measured]
    picture = make_picture(
        out, "terminations", "What ended the episodes.",
        [{"job": job, "cause": cause, "episodes": n} for job, counts in causes for cause, n in counts.items()],
        lambda path: plot_terminations(causes, path),
    )  # fmt: skip
    text = " ".join(dict.fromkeys(protocol(subject.task, episodes, seed) for subject in subjects.values()))
    counted = (result.episodes - result.copies for _, result in measured)
    text = f"{text} {copies_in_sets_text(counted, episodes, 'jobs')}".rstrip()
    return Section("Evaluation", text, [*tables, picture])


def _label(job: Run, sweep: Sweep) -> str:
    return label_of(job, sweep.keys) or job.path.name


def motion(
    sweep: Sweep, subjects: Subjects, evaluations: Evaluations, seed: int, variants: list[str], out: Path
) -> Section | None:
    """Motion traces of policies that differ in one key alone, a picture for each key that was swept."""
    parts: list[Part] = []
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
