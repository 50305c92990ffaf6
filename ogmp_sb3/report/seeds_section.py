"""The section of a report on trainings that differ in the seed alone: what other seeds, or tracks, would give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ogmp_sb3.evaluation.evaluate import Evaluation, metric_limits
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy
from ogmp_sb3.evaluation.seeds import SeedStatistics, few_seeds_text, seed_statistics
from ogmp_sb3.report.page import Rows, Section, Table, fitting, write_csv
from ogmp_sb3.report.panels import Sweep, label_of, shown
from ogmp_sb3.report.run_sections import interval
from ogmp_sb3.runs.multirun import SEED, setting
from ogmp_sb3.runs.run_directory import Run, samples_text


@dataclass(frozen=True)
class SeedGroup:
    """Trainings that differ in the seed alone and were tested."""

    panel: str
    """values of all keys but that of the line"""
    value: Any
    """of the key that the lines of a panel differ in"""
    label: str
    """both, as on a command line"""
    seeds: list[str]
    """of the trainings that were tested"""
    evaluations: list[Evaluation]
    """of each of these"""
    samples: list[int | None]
    """that each of their policies was trained on; None: not recorded"""
    untested: list[Run]
    """those that have no policy"""
    statistics: dict[str, SeedStatistics]
    """by metric"""


def seed_groups(
    sweep: Sweep, subjects: Mapping[Path, EvaluatedPolicy], evaluations: Mapping[Path, Evaluation]
) -> list[SeedGroup]:
    """The groups of a sweep of which at least one training was tested."""
    others = [key for key in sweep.keys if key != SEED]
    groups = []
    for panel in sweep.panels:
        for line in panel.lines:
            tested = [(run, seed) for run, seed in zip(line.runs, line.seeds, strict=True) if run.path in evaluations]
            if not tested:
                continue
            runs = [run for run, _ in tested]
            label = label_of(runs[0], others)
            found = [evaluations[run.path] for run in runs]
            subject = subjects[runs[0].path]
            groups.append(
                SeedGroup(
                    panel=panel.title,
                    value=line.value,
                    label=label or "all runs",
                    seeds=[seed for _, seed in tested],
                    evaluations=found,
                    samples=[subjects[run.path].samples for run in runs],
                    untested=[
                        job for job in sweep.jobs if job.path not in evaluations and label_of(job, others) == label
                    ],
                    statistics=_statistics(subject, found),
                )
            )
    return groups


def _statistics(subject: EvaluatedPolicy, evaluations: Sequence[Evaluation]) -> dict[str, SeedStatistics]:
    disturbed = subject.task.evaluation.randomisation is not None  # draws for as long as a robot runs
    same_tracks = not disturbed and not any(each.copies for each in evaluations)
    names = [name for name in evaluations[0].values if all(name in each.values for each in evaluations)]
    return {
        name: seed_statistics(
            [each.values[name] for each in evaluations], metric_limits(subject.task, name), same_tracks
        )
        for name in names
    }


def seeds(sweep: Sweep, groups: Sequence[SeedGroup], out: Path) -> Section | None:
    """Statistics over seeds and over episodes of every group; nothing if no seeds were asked for."""
    if not groups or (SEED not in sweep.keys and all(len(group.seeds) == 1 for group in groups)):
        return None
    write_csv(out / "seeds.csv", seed_rows(groups))
    names = list(dict.fromkeys(name for group in groups for name in group.statistics))

    def cells(group: SeedGroup, over: str) -> list[str]:
        found = group.statistics
        return [interval(getattr(found[name], over)) if name in found else "" for name in names]

    over_seeds = Table(
        [
            [group.label, f"{len(group.seeds)}: {', '.join(group.seeds)}", *cells(group, "over_seeds")]
            for group in groups
        ],
        ["trainings", "n: seeds", *names],
        "Over seeds: what another training would come to. Mean over the seeds with Student's 95 % interval over seeds.",
        ["seeds.csv"],
    )
    over_episodes = Table(
        [[group.label, _episodes(group), *cells(group, "over_episodes")] for group in groups],
        ["trainings", "n: episodes", *names],
        "Over episodes: what these very policies would come to on other tracks. Interquartile mean (the middle half) "
        "over all episodes of all seeds with a 95 % bootstrap interval stratified by seed; of yes or no the share with "
        "Wilson's. More episodes make this interval shorter, and say nothing on another seed.",
    )
    return Section("Seeds", _notes(groups), [*fitting(over_seeds, 2), *fitting(over_episodes, 2)])


def _episodes(group: SeedGroup) -> str:
    counts = [sum(each.terminations.values()) for each in group.evaluations]
    parts = f"{len(counts)} x {counts[0]}" if len(set(counts)) == 1 else " + ".join(map(str, counts))
    return parts if len(counts) == 1 else f"{sum(counts)} = {parts}"


def _notes(groups: Sequence[SeedGroup]) -> str:
    """What is to be known before the numbers are compared."""
    notes = [few_seeds_text(count) for count in sorted({len(group.seeds) for group in groups})]
    if len({tuple(sorted(group.seeds)) for group in groups}) > 1:
        notes.append("The groups have different seeds.")
    for group in groups:
        missing = [f"seed {shown(setting(job, SEED))} ({job.state})" for job in group.untested]
        if missing:
            notes.append(f"Without a policy: {group.label}, {', '.join(missing)}.")
        known = sorted({samples for samples in group.samples if samples is not None})
        if len(known) > 1:
            notes.append(
                f"The policies of {group.label} are of {samples_text(known[0])} to {samples_text(known[-1])} samples."
            )
    return " ".join(filter(None, notes))


def seed_rows(groups: Sequence[SeedGroup]) -> Rows:
    """The statistics as a table for a file: two rows for each group and metric."""
    return [
        {
            "group": group.label, "metric": metric, "interval": name, "number": number,
            "value": found.mean, "low": found.low, "high": found.high, "n": found.n,
        }
        for group in groups
        for metric, each in group.statistics.items()
        for name, number, found in (
            ("over seeds", "mean", each.over_seeds),
            ("over episodes", each.number, each.over_episodes),
        )
    ]  # fmt: skip
