"""ogmp-task: a task for another robot."""

import shutil
from pathlib import Path

import pytest

from helpers.programs import program
from helpers.robots import PUP
from ogmp_sb3.config.load import load_task


def test_a_task_is_written_for_a_robot_and_found_by_its_name(tmp_path: Path, monkeypatch) -> None:
    done = program("task", "new=pup_parkour", f"robot={PUP.path}", "from=parkour", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("# parkour for ") and "ogmp-encode task=pup_parkour" in done.stdout
    monkeypatch.chdir(tmp_path)
    (tmp_path / "encoders").mkdir()
    task = load_task("pup_parkour", {"encoder": None, "observations.mode_latent": None})
    assert task.robot_config.name == "pup" and task.gait.height == pytest.approx(0.55 * 0.258 / 0.5, abs=1e-3)


def test_paths_are_of_where_the_program_runs(tmp_path: Path, monkeypatch) -> None:
    shutil.copytree(PUP.path.parent, tmp_path / "robots/pup")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/walk.yaml").write_text("extends: parkour\nrho: 0.3\n")
    done = program("task", "new=a", "robot=robots/pup/robot.yaml", "from=mine/walk.yaml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    monkeypatch.chdir(tmp_path)
    task = load_task("a")
    assert task.robot_config.name == "pup" and task.rho == 0.3


def test_a_task_is_not_written_over_what_it_extends(tmp_path: Path) -> None:
    assert program("task", "new=a", "robot=hector", cwd=tmp_path).returncode == 0
    assert program("task", "new=b", "robot=hector", "from=a", cwd=tmp_path).returncode == 0
    for start in ("a", "b"):
        done = program("task", "new=a", "robot=hector", f"from={start}", "replace=true", cwd=tmp_path)
        assert done.returncode == 2 and f"'{start}' is tasks/a.yaml itself, or extends it" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["robot=hector"], "'new' is missing: give new=<name of the task"),
        (["new=a"], "'robot' is missing: give robot=<its robot"),
        (["new=parkour", "robot=hector"], "'parkour' ships with ogmp_sb3: give another name."),
        (["new=a/b", "robot=hector"], "'new' must be a name, not a path; found 'a/b'."),
        (["new=there", "robot=hector"], "tasks/there.yaml is there already: give another name, or replace=true."),
        (["new=a", "robot=hektor"], "unknown robot 'hektor'"),
        (["new=a", "robot=hector", "from=parkuor"], "unknown task 'parkuor'"),
        (["new=a", "robot=hector", "form=parkour"], "unknown key 'form'"),
    ],
)
def test_mistakes_are_a_sentence(arguments: list[str], sentence: str, tmp_path: Path) -> None:
    (tmp_path / "tasks").mkdir()
    (tmp_path / "tasks/there.yaml").write_text("mine")
    done = program("task", *arguments, cwd=tmp_path)
    assert done.returncode == 2 and sentence in done.stderr and done.stderr.count("\n") == 1, done.stderr
    assert [path.name for path in (tmp_path / "tasks").iterdir()] == ["there.yaml"]
