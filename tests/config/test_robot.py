"""What robot files hold, and what they refuse."""

import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from helpers.mistakes import MISSING, ROBOT, SHIPPED, put, write
from ogmp_sb3 import load_task
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.robot import RobotConfig


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
