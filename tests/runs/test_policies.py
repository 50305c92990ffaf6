"""Policies by name or directory."""

from __future__ import annotations

import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.projects import BOX, edit, trained_project
from ogmp_sb3.config.catalogue import PACKAGE
from ogmp_sb3.env.robot_digest import robot_digest
from ogmp_sb3.runs.policies import load_policy, policy_dir
from ogmp_sb3.runs.run_directory import checkpoint_dirs
from ogmp_sb3.runs.storage import load_json, save_json, write_manifest


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("nowhere", "'nowhere' is neither a run directory nor a shipped policy"),
        ("../policies/parkour", "is neither a run directory nor a shipped policy"),
        ("", "'' is a directory here, but neither a run nor a policy"),
        ("parkour", "'parkour' is a directory here, but neither a run nor a policy"),  # not the shipped one
        ("./parkour", "'./parkour' is a directory here, but neither a run nor a policy, and no run is below it"),
    ],
)
def test_a_name_that_is_no_policy_is_a_sentence(name: str, sentence: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "parkour" / "2026-01-31_12-00-00").mkdir(parents=True)
    with pytest.raises((KeyError, ValueError), match=sentence):
        policy_dir(name)


def test_no_file_that_ships_is_a_pickle() -> None:
    files = (path for path in (PACKAGE / "policies").glob("*/**/*") if path.is_file() and "wip" not in path.parts)
    assert {path.suffix for path in files} <= {".json", ".safetensors", ".md"}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A project with a run in runs/a, which has moved since; where it was there is nothing."""
    folder = tmp_path_factory.mktemp("trained")
    trained_project(folder / "was")
    (folder / "was").rename(folder / "is")
    yield folder / "is"


@pytest.fixture
def project(trained: Path, tmp_path: Path) -> Path:
    return shutil.copytree(trained, tmp_path / "project")


@pytest.mark.parametrize("part", ["", "best", "checkpoints/000000000016"])
def test_a_part_of_a_run_that_is_copied_alone_has_its_robot(part: str, project: Path, tmp_path: Path, recwarn) -> None:
    expected = load_policy(project / "runs" / "a")
    alone = shutil.copytree(project / "runs" / "a" / part, tmp_path / "elsewhere" / "alone")
    shutil.rmtree(project)
    loaded = load_policy(alone)
    assert loaded.task.robot_config.path == alone / "robot" / "robot.yaml"
    assert robot_digest(loaded.task.robot_config) == robot_digest_of(expected.info)
    assert not recwarn


def robot_digest_of(info: dict) -> str:
    return str(info["robot"]["digest"])


def test_the_robot_of_a_checkpoint_is_the_copy_in_its_run(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(project / "runs")
    for run in ("a", "a/best", "a/checkpoints/000000000016", "../runs/a"):
        assert load_policy(run).task.robot_config.path.resolve() == project / "runs" / "a" / "robot" / "robot.yaml"


def test_a_run_that_can_only_be_read_is_loaded_and_stays_as_it_is(project: Path) -> None:
    run = project / "runs" / "a"
    before = {path: path.stat().st_mtime_ns for path in [run, *run.rglob("*")]}
    for path in before:
        path.chmod(path.stat().st_mode & ~(stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH))
    try:
        load_policy(run)
        assert {path: path.stat().st_mtime_ns for path in [run, *run.rglob("*")]} == before
    finally:
        for path in before:
            path.chmod(path.stat().st_mode | stat.S_IWUSR)


@pytest.mark.parametrize(
    ("file", "before", "after", "named"),
    [
        ("robot.yaml", "nominal_height: 0.50", "nominal_height: 0.52", "nominal_height; in robot.yaml"),
        ("models/hector/parts/servos.xml", '"L_knee" class', '"L_knee" kp="3" class', "in servos.xml"),
        ("meshes/cube.obj", BOX.format(0.05), BOX.format(0.06), "in cube.obj"),
    ],
)
def test_a_robot_that_changed_is_named_and_measured_anew_if_it_is_asked_for(
    file: str, before: str, after: str, named: str, project: Path
) -> None:
    run, own = project / "runs" / "a", project / "robot.yaml"
    digest = load_policy(run).digest
    assert load_policy(run, robot=own).digest == digest  # the same robot, from elsewhere
    edit(project / file, before, after)
    with pytest.warns(UserWarning, match=rf"robot.yaml: changed since the training \(.*{named}\)"):
        assert load_policy(run).digest == digest
    changed = load_policy(run, robot=own)
    assert changed.digest != digest
    assert changed.task.robot_config.path == own and changed.task_data["robot"] == str(own)


def test_another_robot_is_found_from_the_working_directory_or_by_name(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(project)
    assert load_policy("runs/a", robot="robot.yaml").task.robot_config.path == project / "robot.yaml"
    assert load_policy("runs/a", robot="hector").task.robot_config.mjcf == "hector.xml"
    with pytest.raises(KeyError, match=r"unknown robot 'hectr'.*Did you mean 'hector'"):
        load_policy("runs/a", robot="hectr")


@pytest.mark.parametrize("there", [True, False])
def test_a_policy_alone_without_a_copy_asks_for_its_robot_unless_it_is_there(
    there: bool, project: Path, tmp_path: Path
) -> None:
    """As of a large robot, or of a training from before there were copies."""
    alone = shutil.copytree(project / "runs" / "a" / "best", tmp_path / "alone")
    shutil.rmtree(alone / "robot")
    info = load_json(alone / "policy.json")
    info["task"]["robot"] = str(project / "robot.yaml") if there else "/no/robot.yaml"
    save_json(alone / "policy.json", info)
    (alone / "manifest.json").unlink()
    write_manifest(alone)
    if there:
        load_policy(alone)
        edit(project / "robot.yaml", "nominal_height: 0.50", "nominal_height: 0.52")
        with pytest.warns(UserWarning, match="there is no copy, so the new one is used"):
            load_policy(alone)
    else:
        with pytest.raises(ValueError, match=r"policy.json: 'robot': /no/robot.yaml: no such file.*robot=<its robot.y"):
            load_policy(alone)
        assert load_policy(alone, robot=project / "robot.yaml").task.robot_config.path == project / "robot.yaml"


def test_a_copy_in_a_policy_that_was_changed_is_named(project: Path, tmp_path: Path) -> None:
    alone = shutil.copytree(project / "runs" / "a" / "best", tmp_path / "alone")
    edit(alone / "robot" / "servos.xml", '"L_knee" class', '"L_knee" kp="3" class')
    with pytest.raises(ValueError, match=r"alone/robot/servos.xml: damaged or missing"):
        load_policy(alone)
    (alone / "manifest.json").unlink()
    with pytest.raises(ValueError, match=r"alone/robot/servos.xml: changed or missing"):
        load_policy(alone)


def test_a_checkpoint_still_has_its_robot_when_the_run_s_copy_was_changed(project: Path) -> None:
    run = project / "runs" / "a"
    (run / "robot" / "robot.yaml").write_text("")
    (checkpoint,) = checkpoint_dirs(run)
    assert load_policy(run).task.robot_config.path == checkpoint / "robot" / "robot.yaml"
