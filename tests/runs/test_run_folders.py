"""Where runs lie, and what they are called."""

from __future__ import annotations

import os
from pathlib import Path

from helpers.run_directories import make_run
from ogmp_sb3.runs.run_folders import newest_first, run_folders, short_names


def begun(path: Path, seconds: int) -> Path:
    """A run begun at a time."""
    make_run(path, ["task=dive"])
    os.utime(path / "config.yaml", (seconds, seconds))
    return path


def test_runs_are_found_at_any_depth_and_sweeps_keep_their_jobs(tmp_path: Path) -> None:
    plain = [make_run(tmp_path / name, []) for name in ("a", "deep/er/b")]
    jobs = [make_run(tmp_path / "sweep" / name, []) for name in ("rho=0.1", "robot=x/y")]
    (tmp_path / "sweep" / "multirun.yaml").touch()
    make_run(tmp_path / ".hidden" / "c", [])
    (tmp_path / "a" / "evaluation").mkdir()
    (tmp_path / "loop").symlink_to(tmp_path)
    found = {run.path: run.sweep for run in run_folders(tmp_path)}
    assert found == dict.fromkeys(plain) | dict.fromkeys(jobs, tmp_path / "sweep")
    assert [run.path for run in run_folders(jobs[1])] == [jobs[1]]
    assert [run.sweep for run in run_folders(jobs[1])] == [tmp_path / "sweep"]
    assert list(run_folders(tmp_path / "nowhere")) == []


def test_the_newest_is_the_one_begun_or_resumed_last_whatever_it_is_called(tmp_path: Path) -> None:
    for name, seconds in (("z", 100), ("a", 300), ("m", 200)):
        begun(tmp_path / name, seconds)
    assert [run.path.name for run in newest_first(run_folders(tmp_path))] == ["a", "m", "z"]
    os.utime(tmp_path / "z" / "config.yaml", (400, 400))
    assert newest_first(run_folders(tmp_path))[0].path.name == "z"
    never = make_run(tmp_path / "never", [], config=False)
    os.utime(never / ".hydra" / "overrides.yaml", (500, 500))
    assert newest_first(run_folders(tmp_path))[0].begun == 500


def test_a_job_is_called_by_what_tells_it_from_the_others(tmp_path: Path) -> None:
    for name in ("num_envs=8,rho=0.1,seed=1,task=dive", "num_envs=8,rho=0.1,seed=2,task=dive"):
        make_run(tmp_path / "sweep" / name, [])
    (tmp_path / "sweep" / "multirun.yaml").touch()
    make_run(tmp_path / "alone", [])
    assert list(short_names(run_folders(tmp_path), tmp_path).values()) == ["alone", "sweep/seed=1", "sweep/seed=2"]


def test_jobs_that_would_be_called_the_same_keep_their_whole_names(tmp_path: Path) -> None:
    for name in ("a,b", "b,a"):
        make_run(tmp_path / "sweep" / name, [])
    (tmp_path / "sweep" / "multirun.yaml").touch()
    assert list(short_names(run_folders(tmp_path), tmp_path).values()) == ["sweep/a,b", "sweep/b,a"]
