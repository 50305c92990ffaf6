"""Trainings whose project changes, moves or goes: the robot of the beginning is that of the end."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from helpers.programs import program
from helpers.projects import BOX, edit, job, make_project, trained_project
from ogmp_sb3.guidance.latent import copy_encoder
from ogmp_sb3.runs.own_files import run_robot
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import checkpoint_dirs, read_run, run_config
from ogmp_sb3.runs.storage import load_json, save_json, write_manifest, write_yaml
from ogmp_sb3.runs.training import begin_or_go_on


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with a run of one update, in runs/a."""
    folder = tmp_path_factory.mktemp("trained") / "project"
    trained_project(folder)
    return folder


@pytest.fixture
def project(trained: Path, tmp_path: Path) -> Path:
    """The same, renamed: nothing is where it was during the training."""
    return shutil.copytree(trained, tmp_path / "renamed")


def resume(project: Path, *arguments: str) -> Any:
    return program("train", "resume=runs/a", "total_timesteps=32", *arguments, cwd=project)


def without_robot(run: Path) -> Path:
    """A run as it was before robots travelled with them: its task names a file that is not there."""
    folders = [run, run / "best", *checkpoint_dirs(run)]
    for folder in folders:
        shutil.rmtree(folder / "robot")
        data = run_config(run) if folder == run else load_json(folder / "policy.json")
        del data["robot"]
        data["task"]["robot"] = "/no/robot.yaml"
        (write_yaml if folder == run else save_json)(folder / ("config.yaml" if folder == run else "policy.json"), data)
        if folder != run:
            (folder / "manifest.json").unlink()
            write_manifest(folder)
    return run


def test_a_training_uses_the_copy_and_leaves_it_in_run_and_policies(trained: Path) -> None:
    run = trained / "runs" / "a"
    (checkpoint,) = checkpoint_dirs(run)
    names = sorted(path.name for path in (run / "robot").iterdir())
    assert names == ["all.xml", "cube.obj", "hector.xml", "robot.yaml", "servos.xml"]
    for folder in (run / "best", checkpoint):
        assert sorted(path.name for path in (folder / "robot").iterdir()) == names
        assert load_json(folder / "policy.json")["robot"] == run_config(run)["robot"]
    assert run_config(run)["task"]["robot"] == str(trained / "robot.yaml")


def test_a_renamed_project_goes_on_without_a_word(trained: Path, project: Path, recwarn) -> None:
    trained_is_there = trained.rename(trained.with_name("gone"))
    try:
        done = resume(project)
    finally:
        trained_is_there.rename(trained)
    assert done.returncode == 0, done.stderr
    assert "resumed at step 16" in done.stdout and not [w for w in recwarn if "changed" in str(w.message)]
    assert int(checkpoint_dirs(project / "runs" / "a")[-1].name) == 32
    assert not list((project / "runs" / "a").glob("*/robot.yaml.*"))


def test_a_resumed_run_keeps_the_robot_that_it_was_begun_with(project: Path) -> None:
    before = load_policy(project / "runs" / "a").task.robot_config
    edit(project / "robot.yaml", "nominal_height: 0.50", "nominal_height: 0.52")
    (project / "meshes" / "cube.obj").write_text(BOX.format(0.06))
    with pytest.warns(UserWarning, match=r"robot.yaml: changed since the training \(nominal_height, .*shape of geom"):
        done = resume(project)
    assert done.returncode == 0, done.stderr
    with pytest.warns(UserWarning, match=r"the run's own copy is used; robot=.*/renamed/robot.yaml takes the new one"):
        after = load_policy(project / "runs" / "a").task.robot_config
    assert after == before


def test_a_copy_that_was_changed_ends_a_resume_and_is_named(project: Path) -> None:
    edit(project / "runs" / "a" / "robot" / "servos.xml", 'name="L_knee"', 'name="L_knee" kp="3"')
    done = resume(project)
    assert done.returncode == 2 and "runs/a/robot/servos.xml: changed or missing" in done.stderr


def test_a_copy_that_is_gone_is_made_again_of_the_same_robot_alone(project: Path) -> None:
    shutil.rmtree(project / "runs" / "a" / "robot")
    edit(project / "robot.yaml", "nominal_height: 0.50", "nominal_height: 0.52")
    done = resume(project)
    assert done.returncode == 2 and "robot.yaml: changed since the training" in done.stderr
    (project / "robot.yaml").rename(project / "heavy.yaml")
    edit(project / "heavy.yaml", "nominal_height: 0.52", "nominal_height: 0.50")
    assert resume(project, "robot=heavy.yaml").returncode == 0
    assert (project / "runs" / "a" / "robot" / "servos.xml").is_file()


def test_the_robot_of_a_run_cannot_change(project: Path) -> None:
    done = resume(project, "robot=robot.yaml")
    assert done.returncode == 2 and "'robot' cannot change when a run is resumed" in done.stderr


def test_a_run_of_before_goes_on_with_the_robot_that_is_given_and_has_a_copy_then(project: Path) -> None:
    without_robot(project / "runs" / "a")
    done = resume(project)
    assert done.returncode == 2
    assert "config.yaml: 'robot': /no/robot.yaml: no such file." in done.stderr
    assert "give it with robot=<its robot.yaml>" in done.stderr
    done = resume(project, "robot=robot.yaml")
    assert done.returncode == 0, done.stderr
    config = run_config(project / "runs" / "a")
    assert config["task"]["robot"] == str(project / "robot.yaml") and config["robot"]["beside"] == "../../robot.yaml"
    assert load_policy(project / "runs" / "a").task.robot_config.path == project / "runs/a/robot/robot.yaml"


def test_a_run_that_was_stopped_before_its_first_checkpoint_begins_with_its_copy(project: Path) -> None:
    run = project / "runs" / "a"
    shutil.rmtree(run / "checkpoints")
    record = run_config(run)["robot"]
    edit(project / "robot.yaml", "nominal_height: 0.50", "nominal_height: 0.52")
    with pytest.warns(UserWarning, match="the run's own copy is used"):
        done = resume(project)
    assert "beginning anew" in done.stdout
    assert run_config(run)["robot"] == record


@pytest.mark.parametrize(
    ("file", "before", "after", "named"),
    [
        ("robot.yaml", "nominal_height: 0.50", "nominal_height: 0.52", "nominal_height; in robot.yaml"),
        ("models/hector/parts/servos.xml", '"L_knee" class', '"L_knee" kp="3" class', "in servos.xml"),
        ("meshes/cube.obj", BOX.format(0.05), BOX.format(0.06), "in cube.obj"),
    ],
)
@pytest.mark.parametrize("total", [16, 32])
def test_the_same_command_with_another_robot_is_another_run(
    total: int, file: str, before: str, after: str, named: str, project: Path
) -> None:
    edit(project / file, before, after)
    with pytest.raises(ValueError, match=rf"holds another run: .*robot.yaml has changed since \(.*{named}\)"):
        begin_or_go_on(job(project / "flip.yaml", project / "runs" / "a", total))


def test_the_same_command_goes_on_in_a_renamed_project(project: Path) -> None:
    begin_or_go_on(job(project / "flip.yaml", project / "runs" / "a", 32))
    assert int(checkpoint_dirs(project / "runs" / "a")[-1].name) == 32


def test_the_same_command_with_another_encoder_is_another_run(tmp_path: Path) -> None:
    encoder = tmp_path / "encoder"
    copy_encoder("dive", encoder)
    plain = job(make_project(tmp_path / "project"), tmp_path / "run")
    observations = {**plain.task.observations, "mode_latent": {}}
    asked = replace(plain, task=replace(plain.task, encoder=str(encoder), observations=observations))
    begin_or_go_on(asked)
    begin_or_go_on(replace(asked, task_data={**asked.task_data, "encoder": "elsewhere/dive"}))
    edit(encoder / "encoder.json", "{", "{ ")
    with pytest.raises(ValueError, match=r"holds another run: .*encoder/encoder.json has changed since"):
        begin_or_go_on(asked)


def test_the_robot_of_a_run_is_asked_for_by_what_its_configuration_says(project: Path) -> None:
    run = project / "runs" / "a"
    assert run_robot(run, run_config(run)) == run / "robot" / "robot.yaml"
    with pytest.raises(ValueError, match=r"config.yaml: 'task.robot' is missing"):
        run_robot(run, {**run_config(run), "task": {}})
    with pytest.raises(ValueError, match=r"config.yaml: 'robot' must be a mapping"):
        run_robot(run, {**run_config(run), "robot": 3})


def test_a_fingerprint_is_of_the_robot_and_not_of_where_it_was(project: Path) -> None:
    run = project / "runs" / "a"
    before, data = read_run(run).fingerprint, yaml.safe_load((run / "config.yaml").read_text())
    data["task"]["robot"] = "/elsewhere/robot.yaml"
    write_yaml(run / "config.yaml", data)
    assert read_run(run).fingerprint == before
    data["robot"]["digest"] = "0"
    write_yaml(run / "config.yaml", data)
    assert read_run(run).fingerprint != before
