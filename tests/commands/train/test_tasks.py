"""Tasks by name and by path, whatever characters are in the path."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml

from helpers.programs import SMALL, program
from ogmp_sb3.commands.train.tasks import register_tasks, registered_data
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.runs.policies import load_policy

NAMES = [
    "步态",
    "tâche",
    "my task (v2)",
    "2026",
    "it's",
    "a=b",
    "a,b",
    "null",
    "a.b",
    "100%",
    "{a}",
    "-x",
    " x",
    'say "hi"',
    "a$b#;%~",
    ".hidden",
    "~x",
    "*",
    "a\\b",
    "n" * 150,
]


@pytest.mark.parametrize("name", NAMES)
def test_a_file_of_any_name_is_a_task_of_this_name(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(TASKS_DIR / "dive.yaml", f"{name}.yaml")
    _, names = register_tasks([f"task={name}.yaml,dive"])
    assert names == [name, "dive"]
    assert registered_data(names)[0] == yaml.safe_load((TASKS_DIR / "dive.yaml").read_text())


def test_a_comma_within_a_path_separates_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rho=0.3,seed=1").mkdir()
    for file in ("a,b.yaml", "b.yaml", "rho=0.3,seed=1/c.yaml"):
        shutil.copy(TASKS_DIR / "dive.yaml", file)
    arguments, names = register_tasks(["task=a,b.yaml,parkour,b.yaml,rho=0.3,seed=1/c.yaml"])
    assert names == ["a,b", "parkour", "b", "c"]
    assert arguments == ["task='a,b',parkour,b,c"]


def test_a_task_by_path_is_registered_with_what_it_extends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bases").mkdir()
    (tmp_path / "bases" / "b.yaml").write_text("extends: dive\nrho: 0.2")
    (tmp_path / "extending.yaml").write_text("extends: bases/b.yaml\nhorizon: 7")
    _, names = register_tasks(["task=extending.yaml"])
    dive = yaml.safe_load((TASKS_DIR / "dive.yaml").read_text())
    assert registered_data(names) == [dive | {"rho": 0.2, "horizon": 7}]


def test_a_task_with_an_everyday_name_trains_in_directories_with_everyday_names(tmp_path: Path) -> None:
    shutil.copy(TASKS_DIR / "dive.yaml", tmp_path / "läufe, walk (1).yaml")
    for arguments in (["hydra.run.dir=r [1]/a=b,c"], ["-m", "rho=0.3", "hydra.sweep.dir=r [2]"]):
        done = program("train", "task=läufe, walk (1).yaml", *arguments, "total_timesteps=64", *SMALL, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    runs = [file.parent for file in tmp_path.glob("r */**/checkpoints")]
    assert [load_policy(run).task.name for run in runs] == ["läufe, walk (1)"] * 2
    done = program("train", "resume=r [1]/a=b,c", "total_timesteps=256", cwd=tmp_path)
    assert done.returncode == 0 and "resumed at step" in done.stdout
