"""ogmp-task: a task for another robot."""

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
