"""The sections of a report on a sweep."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from helpers.projects import trained_project
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.statistics import Estimate
from ogmp_sb3.report.panels import sweep_of
from ogmp_sb3.report.sweep_sections import evenly_spaced, highest_return, load_subjects, objectives
from ogmp_sb3.runs.multirun import read_sweep
from ogmp_sb3.runs.run_directory import Run


def test_of_many_traces_some_are_drawn_with_the_first_and_the_last() -> None:
    assert evenly_spaced(12) == [0, 1, 2, 4, 5, 6, 7, 9, 10, 11]
    assert evenly_spaced(3) == [0, 1, 2]


@pytest.mark.parametrize(("task", "expected"), [("parkour", 400 * 1.0), ("dive", 150 * 1.0)])
def test_the_highest_return_is_full_reward_at_every_step_of_the_test(task: str, expected: float) -> None:
    assert highest_return(load_task(task)) == pytest.approx(expected)


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
    evaluations = {
        path: Evaluation(dict.fromkeys(("return", "true_objective"), Estimate(mean, 1.0, 9, mean - 0.5, mean + 0.5)),
                         {}, 0.0, {})
        for path, mean in means.items()
    }  # fmt: skip
    loaded = SimpleNamespace(task=load_task("parkour"))
    subjects = {path: SimpleNamespace(task=loaded.task, loaded=loaded) for path in means}
    section = objectives(sweep_of(jobs), subjects, evaluations, tmp_path)  # type: ignore[arg-type]
    assert section is not None
    header, *lines = (tmp_path / "objectives.csv").read_text().splitlines()
    assert header == "objective,line,value,mean,low,high,seeds"
    assert lines[:2] == ["surrogate: return,,0.3,2.0,1.0,3.0,2", "surrogate: return,,0.5,7.0,6.5,7.5,1"]


def test_the_jobs_of_a_sweep_that_has_moved_have_their_robots(tmp_path: Path) -> None:
    run = trained_project(tmp_path / "project")
    shutil.copytree(run, tmp_path / "project" / "sweep" / "rho=0.3")
    shutil.move(tmp_path / "project" / "sweep", tmp_path / "archive")
    shutil.rmtree(tmp_path / "project")
    subjects, notes = load_subjects(sweep_of(read_sweep(tmp_path / "archive")), "best", [])
    ((path, subject),) = subjects.items()
    assert notes[path] == "" and subject.task.robot_config.path == tmp_path / "archive" / "rho=0.3/robot/robot.yaml"
