"""The robot that travels with a run: copied, checked, found, and compared with where it was taken from."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from helpers.projects import BOX, edit, make_project
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.robot_digest import robot_digest, same_model
from ogmp_sb3.runs import robot_copy
from ogmp_sb3.runs.robot_copy import (
    ROBOT,
    RobotRecord,
    changes,
    copy_small,
    keep_robot,
    original,
    own_robot,
    read_record,
    task_robot,
    warn_of_changes,
)


@pytest.fixture
def robot(tmp_path: Path) -> RobotConfig:
    make_project(tmp_path / "project")
    return load_robot(str(tmp_path / "project" / "robot.yaml"))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "project" / "runs" / "a").mkdir(parents=True)
    return tmp_path / "project" / "runs" / "a"


def test_a_copy_is_the_same_model_and_says_what_it_is_made_of(robot: RobotConfig, run: Path) -> None:
    copy, record = keep_robot(robot, str(robot.path), run)
    assert copy.path == run / "robot" / "robot.yaml" and same_model(copy.mjcf_path, robot.mjcf_path)
    assert record.digest == robot_digest(copy) == robot_digest(robot)
    assert sorted(record.files) == sorted(path.name for path in (run / "robot").iterdir())
    assert record.beside == "../../robot.yaml"
    assert sorted(path.name for path in run.iterdir()) == ["robot"]


def test_a_robot_with_a_name_is_copied_too(run: Path) -> None:
    hector = load_robot("hector")
    copy, record = keep_robot(hector, "hector", run)
    assert copy.path.parent == run / "robot" and record.beside is None
    assert copy.mjcf_path.read_bytes() == hector.mjcf_path.read_bytes()


def test_a_copy_of_another_model_is_not_kept(robot: RobotConfig, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = robot_copy.robot_files(robot)
    files["hector.xml"] = files["hector.xml"].replace(b'rgba="0.93 0.45', b'rgba="0.13 0.45')
    monkeypatch.setattr(robot_copy, "robot_files", lambda robot: files)
    with pytest.warns(UserWarning, match=r"robot.yaml: cannot be copied; the run needs it where it is"):
        used, record = keep_robot(robot, str(robot.path), run)
    assert used == robot and record.files == {} and record.digest == robot_digest(robot)
    assert list(run.iterdir()) == []


def test_a_small_robot_goes_into_every_policy_and_a_large_one_does_not(
    robot: RobotConfig, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep_robot(robot, str(robot.path), run)
    copy_small(run / ROBOT, tmp_path / "small")
    assert len(list((tmp_path / "small" / "robot").iterdir())) == 5
    monkeypatch.setattr(robot_copy, "SMALL", 1000)
    copy_small(run / ROBOT, tmp_path / "large")
    assert not (tmp_path / "large").exists()


@pytest.mark.parametrize("name", ["servos.xml", "cube.obj", "robot.yaml"])
def test_a_file_of_a_copy_that_has_changed_is_named(name: str, robot: RobotConfig, run: Path, tmp_path: Path) -> None:
    _, record = keep_robot(robot, str(robot.path), run)
    assert own_robot(record, run) == run / "robot" / "robot.yaml"
    policy = tmp_path / "policy"
    copy_small(run / ROBOT, policy)
    with (run / ROBOT / name).open("a") as file:
        file.write(" ")
    with pytest.raises(ValueError, match=rf"runs/a/robot/{name}: changed or missing"):
        own_robot(record, run)
    assert own_robot(record, run, policy) == policy / "robot" / "robot.yaml"
    (policy / ROBOT / name).unlink()
    with pytest.raises(ValueError, match=name):
        own_robot(record, run, policy)
    shutil.rmtree(run / ROBOT)
    shutil.rmtree(policy / ROBOT)
    assert own_robot(record, run, policy) is None


def test_the_original_is_found_where_the_project_has_gone(robot: RobotConfig, run: Path, tmp_path: Path) -> None:
    _, record = keep_robot(robot, str(robot.path), run)
    assert original(str(robot.path), Path("flip.yaml"), record, run) == robot.path
    (tmp_path / "project").rename(tmp_path / "moved")
    run = tmp_path / "moved" / "runs" / "a"
    assert original(str(robot.path), Path("flip.yaml"), record, run) == tmp_path / "moved" / "robot.yaml"
    assert original(str(robot.path), Path("flip.yaml"), record, None) is None
    assert original("hector", Path("flip.yaml"), None, None) == load_robot("hector").path


def test_a_robot_that_is_nowhere_is_a_sentence_that_says_what_to_give(robot: RobotConfig, run: Path) -> None:
    with pytest.raises(
        ValueError, match=r"'robot': /no/robot.yaml: no such file. There is no copy of it: give it with"
    ):
        task_robot("/no/robot.yaml", Path("flip.yaml"), None, run)
    with pytest.raises(ValueError, match=r"unknown robot 'hectr'.*Did you mean 'hector'\?.*robot=<its robot.yaml>"):
        task_robot("hectr", Path("flip.yaml"), None, None)


def test_changes_are_named_with_their_files_and_comments_are_none(
    robot: RobotConfig, run: Path, tmp_path: Path
) -> None:
    own, record = keep_robot(robot, str(robot.path), run)
    project = tmp_path / "project"
    assert changes(record, robot, own) == ""
    edit(project / "models" / "hector" / "hector.xml", "</mujoco>", "<!-- new --></mujoco>")
    assert changes(record, robot, own) == changes(record, robot, None) == ""
    (project / "meshes" / "cube.obj").write_text(BOX.format(0.07))
    assert "shape of geom" in changes(record, robot, own)
    assert changes(record, robot, own).endswith("; in hector.xml, cube.obj")
    edit(project / "robot.yaml", "nominal_height: 0.50", "nominal_height: 0.52")
    changed = load_robot(str(robot.path))
    assert changes(record, changed, own).startswith("nominal_height, ")
    assert changes(record, changed, None).startswith("files; in robot.yaml, ")
    (project / "meshes" / "cube.obj").unlink()
    assert "it cannot be read" in changes(record, changed, own)


def test_a_change_is_told_once_with_what_is_used_instead(
    robot: RobotConfig, run: Path, recwarn: pytest.WarningsRecorder
) -> None:
    own, record = keep_robot(robot, str(robot.path), run)
    warn_of_changes(own, robot.path, record, "")
    warn_of_changes(own, None, record, "")
    warn_of_changes(robot, robot.path, record, "")
    assert not recwarn
    edit(robot.path, "nominal_height: 0.50", "nominal_height: 0.52")
    warn_of_changes(own, robot.path, record, "; or the other")
    assert str(recwarn.pop().message) == (
        f"{robot.path}: changed since the training (nominal_height; in robot.yaml); the run's own copy is used; or the "
        "other."
    )
    warn_of_changes(robot, robot.path, record, "")
    assert str(recwarn.pop().message).endswith("there is no copy, so the new one is used.")
    edit(robot.path, "nominal_height: 0.52", "nominal_heigth: 0.52")
    warn_of_changes(own, robot.path, record, "")
    assert "it cannot be read" in str(recwarn.pop().message)


def test_a_record_is_read_and_checked() -> None:
    data = {"digest": "1", "files": {"robot.yaml": "2"}, "beside": None}
    assert read_record({"robot": data}, Where("x")) == RobotRecord(**data)  # type: ignore[arg-type]
    assert read_record({}, Where("x")) is None
    with pytest.raises(TypeError, match=r"x: 'robot.files' must be a mapping"):
        read_record({"robot": {**data, "files": 3}}, Where("x"))
