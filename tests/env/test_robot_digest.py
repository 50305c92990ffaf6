"""Which changes of a robot count: those that a simulation could tell."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.projects import BOX, edit, make_project
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.robot_digest import robot_changes, robot_digest, same_model

MJCF, SERVOS, CUBE = "models/hector/hector.xml", "models/hector/parts/servos.xml", "meshes/cube.obj"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    make_project(tmp_path / "now")
    make_project(tmp_path / "before")
    return tmp_path / "now"


def robots(project: Path) -> tuple[RobotConfig, RobotConfig]:
    """The robot before and after the changes of a test."""
    return load_robot(str(project.parent / "before" / "robot.yaml")), load_robot(str(project / "robot.yaml"))


@pytest.mark.parametrize(
    ("file", "before", "after", "named"),
    [
        (SERVOS, 'joint="L_knee"', 'joint="L_knee" kp="31"', "actuator_gainprm"),
        (MJCF, '<joint name="L_knee"', '<joint stiffness="1" name="L_knee"', "jnt_stiffness"),
        (CUBE, BOX.format(0.05), BOX.format(0.06), "shape of geom"),
        (MJCF, 'friction="1.0"', 'friction="0.9"', "geom_friction"),
        (MJCF, 'cone="pyramidal"', 'cone="elliptic"', "option.cone"),
        ("robot.yaml", "nominal_height: 0.50", "nominal_height: 0.51", "nominal_height"),
        ("robot.yaml", "  - L_hip_yaw\n  - L_hip_roll", "  - L_hip_roll\n  - L_hip_yaw", "joints"),
        ("robot.yaml", "feet: [L_toe, R_toe]", "feet: [L_toe]", "feet"),
        ("robot.yaml", "  mass: 14.046", "  mass: 14.1", "srb"),
    ],
)
def test_what_a_simulation_could_tell_is_named(file: str, before: str, after: str, named: str, project: Path) -> None:
    edit(project / file, before, after)
    one, other = robots(project)
    assert any(change.startswith(named) for change in robot_changes(one, other))
    assert robot_digest(one) != robot_digest(other)


@pytest.mark.parametrize(
    ("file", "before", "after"),
    [
        (MJCF, "<mujoco model=", "<!-- of today --><mujoco model="),
        (MJCF, 'rgba="0.93 0.45 0.10 1"', 'rgba="0.1 0.45 0.10 1"'),
        (MJCF, 'rgba="0.3 0.7 0.4 0.5"', 'rgba="1 0 0 1"'),
        (MJCF, 'friction="1.0"', 'friction="1.00"'),
        (MJCF, 'timestep="0.002"', 'timestep="0.001"'),
        (CUBE, "v -0.05", "v  -0.05"),
        ("robot.yaml", "name: hector", "name: hector the second"),
        ("robot.yaml", "leg_length: 0.459 ", "leg_length: 4.59e-1 "),
    ],
)
def test_what_is_only_seen_or_written_another_way_changes_nothing(
    file: str, before: str, after: str, project: Path
) -> None:
    edit(project / file, before, after)
    one, other = robots(project)
    assert robot_changes(one, other) == []
    assert robot_digest(one) == robot_digest(other)


def test_two_joints_of_the_model_that_change_their_names_are_a_change(project: Path) -> None:
    for first, second in (("L_ankle", "x"), ("R_ankle", "L_ankle"), ("x", "R_ankle")):
        edit(project / MJCF, f'<joint name="{first}"', f'<joint name="{second}"')
    assert "places of the joints" in robot_changes(*robots(project))


def test_the_digest_does_not_tell_places_or_names_of_files(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, _ = robots(project)
    digest = robot_digest(one)
    (project / "models").rename(project / "others")
    edit(project / "robot.yaml", "models/hector", "others/hector")
    assert robot_digest(load_robot(str(project / "robot.yaml"))) == digest
    monkeypatch.chdir(project)  # from a relative path MuJoCo itself does not find what an included file includes
    assert robot_digest(load_robot("robot.yaml")) == digest


def test_a_copy_that_differs_in_what_is_seen_is_not_the_same_model(project: Path) -> None:
    one, other = robots(project)
    assert same_model(one.mjcf_path, other.mjcf_path)
    edit(project / MJCF, 'rgba="0.93 0.45 0.10 1"', 'rgba="0.1 0.45 0.10 1"')
    assert not same_model(one.mjcf_path, other.mjcf_path)
