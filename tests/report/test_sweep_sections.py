"""The sections of a report on a sweep."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from helpers.projects import trained_project
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.statistics import Estimate
from ogmp_sb3.report.page import Table
from ogmp_sb3.report.panels import sweep_of
from ogmp_sb3.report.seeds_section import seed_groups
from ogmp_sb3.report.sweep_sections import (
    curves,
    evenly_spaced,
    load_subjects,
    objectives,
    overview,
)
from ogmp_sb3.runs.logs import STEP_COLUMN
from ogmp_sb3.runs.multirun import read_sweep
from ogmp_sb3.runs.run_directory import Run


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_of_many_traces_some_are_drawn_with_the_first_and_the_last() -> None:
    assert evenly_spaced(12) == [0, 1, 2, 4, 5, 6, 7, 9, 10, 11]
    assert evenly_spaced(3) == [0, 1, 2]


def test_objectives_have_the_interval_of_the_episodes_or_that_of_the_seeds(tmp_path: Path) -> None:
    jobs = [
        Run(
            tmp_path / f"{rho}_{seed}",
            (f"rho={rho}", f"seed={seed}"),
            {"task": {"rho": rho}, "train": {"seed": seed}},
            {},
            "",
        )
        for rho, seed in ((0.3, 0), (0.3, 1), (0.5, 0))
    ]
    means = dict(zip((job.path for job in jobs), (1.0, 3.0, 7.0), strict=True))
    names = ("return", "true_objective")
    evaluations = {
        path: Evaluation(
            dict.fromkeys(names, Estimate(mean, 1.0, 3, mean - 0.5, mean + 0.5)), {}, 0.0, {"fall": 3},
            values={name: [mean - 1.0, mean, mean + 1.0] for name in names},
        )
        for path, mean in means.items()
    }  # fmt: skip
    loaded = SimpleNamespace(task=load_task("parkour"))
    subjects = {path: SimpleNamespace(task=loaded.task, loaded=loaded, samples=100) for path in means}
    sweep = sweep_of(jobs)
    groups = seed_groups(sweep, subjects, evaluations)  # type: ignore[arg-type]
    section = objectives(sweep, subjects, groups, tmp_path)  # type: ignore[arg-type]
    assert section is not None
    of_seeds, of_episodes, *_ = read_csv(tmp_path / "objectives.csv")
    reach = stats.t.ppf(0.975, 1) * 1.0  # of 1 and 3: the deviation is sqrt(2), over sqrt(2)
    assert [float(of_seeds[key]) for key in ("mean", "low", "high")] == pytest.approx([2.0, 2.0 - reach, 2.0 + reach])
    assert [of_seeds[key] for key in ("value", "interval", "seeds", "episodes")] == ["0.3", "over seeds", "2", "6"]
    assert [of_episodes[key] for key in ("value", "mean", "low", "high", "interval", "seeds", "episodes")] == [
        "0.5", "7.0", "6.5", "7.5", "over episodes", "1", "3",
    ]  # fmt: skip
    single = read_csv(tmp_path / "objectives_seeds.csv")
    assert [(row["value"], row["seed"], row["mean"]) for row in single[:2]] == [
        ("0.3", "0", "1.0"),
        ("0.3", "1", "3.0"),
    ]
    assert len(single) == 4  # of both objectives; of one training alone there is nothing behind its point


def test_curves_have_the_single_trainings_behind_the_mean(tmp_path: Path) -> None:
    def job(rho: float, seed: int, returns: list[float]) -> Run:
        overrides, config = (f"rho={rho}", f"seed={seed}"), {"task": {"rho": rho}, "train": {"seed": seed}}
        log = {STEP_COLUMN: 100.0 * (1 + np.arange(len(returns))), "episode/return": np.array(returns)}
        return Run(tmp_path / f"{rho}_{seed}", overrides, config, log, "")

    sweep = sweep_of([job(0.3, 0, [1.0, 2.0]), job(0.3, 1, [3.0, 4.0]), job(0.3, 2, [5.0]), job(0.5, 0, [9.0])])
    section = curves(sweep, {}, tmp_path)
    assert section is not None and "95 % interval over seeds" in section.parts[0].caption
    rows = read_csv(tmp_path / "training.csv")
    assert [(row["line"], row["samples"], row["seeds"], row["mean"]) for row in rows] == [
        ("0.3", "100.0", "3", "3.0"), ("0.3", "200.0", "2", "3.0"), ("0.5", "100.0", "1", "9.0"),
    ]  # fmt: skip
    assert rows[2]["low"] == rows[2]["high"] == ""  # one seed
    single = read_csv(tmp_path / "training_seeds.csv")
    assert [(row["line"], row["seed"], row["return"]) for row in single] == [
        ("0.3", "0", "1.0"), ("0.3", "0", "2.0"), ("0.3", "1", "3.0"), ("0.3", "1", "4.0"), ("0.3", "2", "5.0"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("seeds", "text"),
    [([0], "1 of each setting. One seed is one training: there is no interval"), ([0, 1, 2], "3 of each setting.")],
)
def test_the_overview_says_how_many_seeds_there_are(seeds: list[int], text: str, tmp_path: Path) -> None:
    jobs = [
        Run(tmp_path, (f"rho={rho}", f"seed={seed}"), {"task": {"rho": rho}, "train": {"seed": seed}}, {}, "")
        for rho in (0.3, 0.5)
        for seed in seeds
    ]
    (table,) = overview(sweep_of(jobs), {}, "somewhere").parts
    assert isinstance(table, Table)
    assert dict(table.rows)["seeds"].startswith(text)  # type: ignore[arg-type]


def test_the_jobs_of_a_sweep_that_has_moved_have_their_robots(tmp_path: Path) -> None:
    run = trained_project(tmp_path / "project")
    shutil.copytree(run, tmp_path / "project" / "sweep" / "rho=0.3")
    shutil.move(tmp_path / "project" / "sweep", tmp_path / "archive")
    shutil.rmtree(tmp_path / "project")
    subjects, notes = load_subjects(sweep_of(read_sweep(tmp_path / "archive")), "best", [])
    ((path, subject),) = subjects.items()
    assert notes[path] == "" and subject.task.robot_config.path == tmp_path / "archive" / "rho=0.3/robot/robot.yaml"
