"""What a report says of trainings that differ in the seed alone."""

from __future__ import annotations

import csv
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.statistics import estimate
from ogmp_sb3.report.page import Table
from ogmp_sb3.report.panels import sweep_of
from ogmp_sb3.report.seeds_section import SeedGroup, seed_groups, seeds
from ogmp_sb3.runs.run_directory import Run

TASK = load_task("parkour")


def job(rho: float, seed: int, state: str = "finished") -> Run:
    overrides = (f"rho={rho}", f"seed={seed}")
    config = {} if state == "missing" else {"task": {"rho": rho}, "train": {"seed": seed}}
    return Run(Path(f"{rho}/{seed}"), overrides, config, {}, state)


def evaluation(seed: int, episodes: int = 20, copies: int = 0) -> Evaluation:
    rng = np.random.default_rng(seed)
    values: dict[str, list[float]] = {
        "return": rng.normal(100.0 + seed, 1.0, episodes).tolist(),
        "no_fall_fraction": (rng.random(episodes) < 0.8).tolist(),
    }
    metrics = {name: estimate(numbers) for name, numbers in values.items()}
    return Evaluation(metrics, {}, 0.0, {"fall": episodes}, copies=copies, values=values)


def groups_of(jobs: list[Run], evaluations: dict[Path, Evaluation], **samples: int) -> tuple[Any, list[SeedGroup]]:
    sweep = sweep_of(jobs)
    subjects = {path: SimpleNamespace(task=TASK, samples=samples.get(path.name, 1000)) for path in evaluations}
    return sweep, seed_groups(sweep, subjects, evaluations)  # type: ignore[arg-type]


def test_both_intervals_are_named_with_what_they_count(tmp_path: Path) -> None:
    jobs = [job(rho, seed) for rho in (0.3, 0.5) for seed in (0, 1, 2)]
    section = seeds(*groups_of(jobs, {each.path: evaluation(i) for i, each in enumerate(jobs)}), tmp_path)
    assert section is not None
    over_seeds, over_episodes = section.parts
    assert isinstance(over_seeds, Table) and isinstance(over_episodes, Table)
    assert over_seeds.caption.startswith("Over seeds: what another training") and "over seeds" in over_seeds.caption
    assert over_episodes.caption.startswith("Over episodes: what these very policies")
    assert over_seeds.columns[:2] == ["trainings", "n: seeds"] and over_episodes.columns[1] == "n: episodes"
    assert [row[:2] for row in over_seeds.rows] == [["rho=0.3", "3: 0, 1, 2"], ["rho=0.5", "3: 0, 1, 2"]]
    assert [row[:2] for row in over_episodes.rows] == [["rho=0.3", "60 = 3 x 20"], ["rho=0.5", "60 = 3 x 20"]]
    with (tmp_path / "seeds.csv").open(newline="") as file:
        rows = {(row["group"], row["metric"], row["interval"]): row for row in csv.DictReader(file)}
    assert len(rows) == 2 * 2 * 2
    assert rows["rho=0.3", "return", "over seeds"]["n"] == "3"
    assert rows["rho=0.3", "return", "over episodes"]["n"] == "60"
    assert rows["rho=0.3", "return", "over episodes"]["number"] == "iqm"
    assert rows["rho=0.3", "no_fall_fraction", "over episodes"]["number"] == "share"
    assert section.text.startswith("3 seeds are few")


def test_a_failed_job_is_named_and_the_others_are_compared(tmp_path: Path) -> None:
    jobs = [job(0.3, 0), job(0.3, 1, "failed"), job(0.5, 0), job(0.5, 1), job(0.5, 2, "missing")]
    tested = [jobs[0], jobs[2], jobs[3]]
    section = seeds(*groups_of(jobs, {each.path: evaluation(i) for i, each in enumerate(tested)}), tmp_path)
    assert section is not None
    over_seeds = section.parts[0]
    assert isinstance(over_seeds, Table)
    assert [row[1] for row in over_seeds.rows] == ["1: 0", "2: 0, 1"]
    assert over_seeds.rows[0][2].endswith("[-]")  # one seed: no interval over seeds
    for text in (
        "One seed is one training: there is no interval over seeds",
        "2 seeds are few",
        "The groups have different seeds.",
        "Without a policy: rho=0.3, seed 1 (failed).",
        "Without a policy: rho=0.5, seed 2 (missing).",
    ):
        assert text in section.text


def test_seeds_with_different_numbers_of_episodes_and_of_samples_are_said_to_have(tmp_path: Path) -> None:
    jobs = [job(0.3, 0), job(0.3, 1)]
    evaluations = {jobs[0].path: evaluation(0, 20), jobs[1].path: evaluation(1, 4, copies=16)}
    section = seeds(*groups_of(jobs, evaluations, **{"0": 2000}), tmp_path)
    assert section is not None
    over_episodes = section.parts[1]
    assert isinstance(over_episodes, Table) and over_episodes.rows[0][1] == "24 = 20 + 4"
    assert "The policies of all runs are of 1.00k to 2.00k samples." in section.text


def test_runs_that_differ_in_the_seed_alone_are_one_group(tmp_path: Path) -> None:
    jobs = [job(0.3, seed) for seed in range(5)]
    sweep, groups = groups_of(jobs, {each.path: evaluation(i) for i, each in enumerate(jobs)})
    assert [(group.label, group.seeds) for group in groups] == [("all runs", ["0", "1", "2", "3", "4"])]
    section = seeds(sweep, groups, tmp_path)
    assert section is not None and section.text == ""  # five need no warning


def test_without_seeds_there_is_no_such_section(tmp_path: Path) -> None:
    jobs = [job(rho, 0) for rho in (0.3, 0.5)]
    assert seeds(*groups_of(jobs, {each.path: evaluation(i) for i, each in enumerate(jobs)}), tmp_path) is None
    assert seeds(*groups_of(jobs, {}), tmp_path) is None


@pytest.mark.parametrize("name", ["return", "no_fall_fraction"])
def test_means_over_seeds_are_those_of_the_evaluations(name: str, tmp_path: Path) -> None:
    jobs = [job(0.3, seed) for seed in range(3)]
    _, (group,) = groups_of(jobs, {each.path: evaluation(i) for i, each in enumerate(jobs)})
    assert group.statistics[name].over_seeds.mean == pytest.approx(
        np.mean([each.metrics[name].mean for each in group.evaluations])
    )
