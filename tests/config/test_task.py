"""What the dataclasses of task and robot files hold, and what they refuse."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from helpers.mistakes import MISSING, ROBOT, SHIPPED, put, write
from ogmp_sb3 import load_task
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.robot import STATE_NAMES, RobotConfig

# ---- RobotConfig ----


def test_the_shipped_robot_is_read_with_its_model_beside_it() -> None:
    robot = load_robot("hector")
    assert isinstance(robot, RobotConfig)
    assert robot.mjcf_path.is_file()
    assert len(robot.joints) == len(robot.nominal_joints) == 10


@pytest.mark.parametrize(
    ("key", "value", "kind", "message"),
    [
        ("joints", MISSING, KeyError, "'joints' is missing"),
        ("joint", [], KeyError, "'joint' is not a known key .*Did you mean 'joints'?"),
        ("path", "x", KeyError, "'path' is not a known key"),
        ("srb.mas", 1, KeyError, r"'srb\.mas' is not a known key .*Did you mean 'mass'?"),
        ("srb.mass", -1, ValueError, "'srb.mass' must be above 0, found -1"),
        ("srb.inertia", [1, 0, 1], ValueError, "'srb.inertia' must be above 0, found 0"),
        ("srb.inertia", [1, 1], ValueError, r"'srb\.inertia' must have 3 entries, found 2"),
        ("srb.inertia", "x", TypeError, r"'srb\.inertia' must be a list"),
        ("nominal_joints", [0.0], ValueError, "10 joints but 1 nominal_joints"),
        ("nominal_height", 0, ValueError, "'nominal_height' must be above 0, found 0"),
        ("leg_length", math.nan, ValueError, "'leg_length' must be finite"),
        ("feet", [], ValueError, "'feet' names no body"),
        ("feet", ["L_toe", "L_toe"], ValueError, "'feet' has 'L_toe' twice"),
        ("joints", ["L_knee"] * 10, ValueError, "'joints' has 'L_knee' twice"),
        ("mjcf", "nothing.xml", ValueError, r"'mjcf': there is no file .*nothing\.xml"),
    ],
)
def test_a_mistake_in_a_robot_file_names_robot_file_task_file_and_key(
    tmp_path: Path, key: str, value: Any, kind: type[Exception], message: str
) -> None:
    (tmp_path / "hector.xml").write_text("<mujoco/>")
    (tmp_path / "mine_robot.yaml").write_text(yaml.safe_dump(put(ROBOT, key, value)))
    path = write(tmp_path, put(SHIPPED["parkour"], "robot", "mine_robot.yaml"))
    with pytest.raises(kind, match=message) as caught:
        load_task(path)
    assert caught.value.args[0].startswith(f"{path}: 'robot': {tmp_path}/mine_robot.yaml: ")


def test_a_robot_is_found_relative_to_the_task_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "hector.xml").write_text("<mujoco/>")
    (tmp_path / "sub" / "r.yaml").write_text(yaml.safe_dump(put(ROBOT, "name", "mine")))
    path = write(tmp_path, put(SHIPPED["parkour"], "robot", "sub/r.yaml"))
    monkeypatch.chdir("/")
    robot = load_task(path).robot_config
    assert robot.name == "mine"
    assert robot.mjcf_path == tmp_path / "sub" / "hector.xml"


# ---- TaskConfig ----


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_task_says_what_its_file_says(name: str) -> None:
    task, data = load_task(name), SHIPPED[name]
    assert (task.name, task.file) == (name, f"tasks/{name}.yaml")
    assert task.rho == data["rho"]
    assert task.horizon == data["horizon"]
    assert list(task.observations) == list(data["observations"])
    assert task.oracle_params["preview"] == task.oracle_params["lqr"] == data["oracle_params"]["lqr"]
    assert task.substeps * task.physics_dt == pytest.approx(task.control_dt)
    assert task.evaluation.metrics == tuple(data["evaluation"]["metrics"])


def test_a_task_cannot_be_changed() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_task("parkour").rho = 1.0  # type: ignore[misc]


def test_bound_weights_follow_the_state_names() -> None:
    weights = load_task("parkour", {"bound": {"x": 2.0, "vz": 3.0}}).bound_weights
    assert dict(zip(STATE_NAMES, weights, strict=True)) == dict.fromkeys(STATE_NAMES, 0.0) | {"x": 2.0, "vz": 3.0}


def test_the_test_protocol_has_no_bound_no_floor_and_no_curriculum() -> None:
    task = load_task("parkour", {"evaluation.terminations.off_track": {}}).for_evaluation()
    assert (task.rho, task.min_step_reward, task.curriculum) == (None, None, None)
    assert (task.episode_steps, task.track.length) == (400, 10.0)
    assert list(task.terminations) == ["fall", "off_track"]
