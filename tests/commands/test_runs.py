"""ogmp-runs: the list of trainings."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import yaml

from helpers.programs import program
from helpers.run_directories import make_run
from ogmp_sb3.commands.runs import short_time
from ogmp_sb3.runs.atomic import locked
from ogmp_sb3.runs.run_names import find_run


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Two runs of their own, a damaged one, and a sweep of three jobs of which one was never begun."""
    runs = tmp_path / "runs"
    make_run(runs / "parkour" / "old", ["task=parkour", "rho=0.5"], 2_000, 1_300, 1_200)
    make_run(runs / "dive" / "new", ["task=dive"], 1_000, 1_000, 1_000)
    make_run(runs / "dive" / "broken", ["task=dive"])
    (runs / "dive" / "broken" / "config.yaml").write_text("[")
    make_run(runs / "sweeps" / "s" / "rho=0.3,task=dive", ["task=dive", "rho=0.3"], 1_000, 500, 256)
    make_run(runs / "sweeps" / "s" / "rho=-1,task=dive", ["task=dive", "rho=-1"], config=False)
    sweeper = {"_target_": "hydra._internal.core_plugins.basic_sweeper.BasicSweeper"}
    hydra = {"sweeper": sweeper, "overrides": {"task": ["task=dive", "rho=0.3,-1,0.9"]}}
    (runs / "sweeps" / "s" / "multirun.yaml").write_text(yaml.safe_dump({"hydra": hydra}))
    ages = {"parkour/old": 4, "dive/new": 1, "dive/broken": 2, "sweeps/s/rho=0.3,task=dive": 3}
    for name, age in ages.items():
        os.utime(runs / name / "config.yaml", (1e9 - age, 1e9 - age))
    os.utime(runs / "sweeps" / "s" / "rho=-1,task=dive" / ".hydra" / "overrides.yaml", (1e9 - 3.5, 1e9 - 3.5))
    return tmp_path


def lines(project: Path, *arguments: str) -> list[list[str]]:
    done = program("runs", *arguments, cwd=project)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return [line.split() for line in done.stdout.splitlines()]


def test_the_newest_run_comes_first_and_a_sweep_keeps_its_jobs_together(project: Path) -> None:
    with locked(project / "runs" / "sweeps" / "s" / "rho=0.3,task=dive"):
        header, *rows = lines(project)
    assert header == ["name", "task", "rho", "samples", "return", "state", "age"]
    assert [row[:-2] for row in rows[:6]] == [
        ["dive/new", "dive", "0.5", "1.00k", "/", "1.00k", "800.0", "finished"],
        ["dive/broken", "damaged"],
        ["sweeps/s/", "2", "jobs:", "1", "running,", "1", "failed,"],
        ["rho=0.3", "dive", "0.5", "500", "/", "1.00k", "300.0", "running"],
        ["rho=-1", "dive", "-1", "0", "/", "?", "failed"],
        ["parkour/old", "parkour", "0.5", "1.30k", "/", "2.00k", "1100.0", "stopped"],
    ]
    assert rows[2][-2:] == ["1", "missing"]
    assert rows[6][0] == "runs/dive/broken:" and "not readable as YAML" in " ".join(rows[6])
    assert len(rows) == 7


def test_columns_are_aligned(project: Path) -> None:
    text = program("runs", cwd=project).stdout.splitlines()
    at = text[0].index("state")
    assert [line[at:].split()[0] for line in text[1:7]] == ["finished", "damaged", "2", "stopped", "failed", "stopped"]
    assert all(line[at - 1] == " " for line in text[:7])


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (["task=parkour"], ["parkour/old"]),
        (["state=stopped"], ["sweeps/s/", "rho=0.3,task=dive", "parkour/old"]),
        (["task=dive", "state=finished"], ["dive/new"]),
        (["runs/sweeps"], ["s/", "rho=0.3", "rho=-1"]),
        (["dir=runs/sweeps/s", "state=failed"], ["./", "rho=-1,task=dive"]),
        (["runs/dive/new"], ["."]),
    ],
)
def test_a_directory_and_filters_choose_runs(arguments: list[str], names: list[str], project: Path) -> None:
    assert [row[0] for row in lines(project, *arguments)[1:]] == names


def test_the_list_can_be_written_as_json(project: Path) -> None:
    lines(project, "json=list.json")
    listed = json.loads((project / "list.json").read_text())["runs"]
    assert [run["state"] for run in listed] == ["finished", "damaged", "stopped", "failed", "stopped"]
    assert listed[0] == {
        "name": "dive/new", "path": "runs/dive/new", "sweep": None, "task": "dive", "rho": 0.5, "samples": 1000,
        "total_timesteps": 1000, "return": 800.0, "state": "finished", "begun": "2001-09-09T01:46:39+00:00",
        "problem": None,
    }  # fmt: skip
    assert (listed[2]["sweep"], listed[3]["return"], listed[3]["rho"]) == ("runs/sweeps/s", None, "-1")


def test_every_name_in_the_list_is_one_for_run(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines(project, "json=list.json")
    monkeypatch.chdir(project)
    for run in json.loads(Path("list.json").read_text())["runs"]:
        assert find_run(run["name"]) == run["path"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["state=runing"], "Did you mean 'running'?"),
        (["task=parkuor"], "no run is of a task 'parkuor' (allowed: dive, parkour). Did you mean 'parkour'?"),
        (["dir=run"], "'run': no such directory (allowed: runs). Did you mean 'runs'?"),
        (["runs", "dir=runs"], "'dir' is given twice"),
        (["stat=running"], "unknown key 'stat'"),
        (["json=nowhere/list.json"], "nowhere"),
    ],
)
def test_mistakes_are_a_sentence(arguments: list[str], sentence: str, project: Path) -> None:
    done = program("runs", *arguments, cwd=project)
    assert (done.returncode, done.stdout) == (2, "")
    assert sentence in done.stderr and done.stderr.count("\n") == 1


def test_where_there_are_none_it_says_so(tmp_path: Path) -> None:
    assert program("runs", cwd=tmp_path).stdout == "No run below 'runs'.\n"
    make_run(tmp_path / "runs" / "a", ["task=dive"])
    done = program("runs", "task=parkour", "state=running", cwd=tmp_path)
    assert done.stdout == "No run of task 'parkour' that is running below 'runs'.\n"


def test_times_are_short() -> None:
    assert [short_time(s) for s in (-5, 0, 119, 120, 7199, 7200, 172_799, 172_800)] == [
        "0 s", "0 s", "119 s", "2 min", "119 min", "2 h", "47 h", "2 d",
    ]  # fmt: skip
