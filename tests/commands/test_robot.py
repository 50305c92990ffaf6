"""ogmp-robot: from a model to a robot.yaml that a task can name."""

import shutil
from pathlib import Path

import pytest

from helpers.programs import Result, program
from helpers.robots import PUP
from ogmp_sb3.config.load import load_robot, load_task


def run(folder: Path, *arguments: str) -> Result:
    return program("robot", *arguments, cwd=folder)


@pytest.fixture
def model(tmp_path: Path) -> str:
    """A folder with a model in it."""
    shutil.copy(PUP.mjcf_path, tmp_path / "dog.xml")
    return "dog.xml"


def test_a_robot_is_written_drawn_and_found_by_its_name(model: str, tmp_path: Path, monkeypatch) -> None:
    done = run(tmp_path, model, "name=dog")
    assert done.returncode == 0, done.stderr
    for line in (
        "leg to FL_foot", "3 joints: FL_hip_roll, FL_hip_pitch, FL_knee", "the model's own",
        "crouch, 0.09 m below straight legs", "on its feet", "robots/dog/robot.yaml is written",
    ):  # fmt: skip
        assert line in done.stdout, line
    assert (tmp_path / "robots/dog/robot.png").stat().st_size > 10_000
    monkeypatch.chdir(tmp_path)
    assert load_robot("dog").joints == PUP.joints and load_robot("dog").mjcf == "../../dog.xml"
    assert load_task("parkour", {"robot": "dog"}).robot_config.name == "dog"


def test_a_file_that_is_there_is_not_written_over_unless_told(model: str, tmp_path: Path) -> None:
    (tmp_path / "robots/dog").mkdir(parents=True)
    (tmp_path / "robots/dog/robot.yaml").write_text("mine")
    done = run(tmp_path, model, "name=dog")
    assert (done.returncode, done.stdout) == (2, "")
    assert "robots/dog/robot.yaml is there already: give another name, or replace=true." in done.stderr
    assert (tmp_path / "robots/dog/robot.yaml").read_text() == "mine"
    assert run(tmp_path, model, "name=dog", "replace=true").returncode == 0


@pytest.mark.parametrize("name", ["no", "1", "a: b", "x #y", "[a]"])
def test_names_that_mean_something_in_yaml_are_names(name: str, tmp_path: Path) -> None:
    text = PUP.mjcf_path.read_text(encoding="utf-8").replace("FL_foot", "off")
    (tmp_path / "dog.xml").write_text(text, encoding="utf-8")
    done = run(tmp_path, "dog.xml", f"name={name}")
    assert done.returncode == 0, done.stderr
    robot = load_robot(str(tmp_path / "robots" / name / "robot.yaml"))
    assert robot.name == name and robot.feet[0] == "off"


def test_a_robot_that_fails_leaves_the_one_that_is_there(model: str, tmp_path: Path) -> None:
    assert run(tmp_path, model, "name=dog").returncode == 0
    before = (tmp_path / "robots/dog/robot.yaml").read_text(encoding="utf-8")
    text = PUP.mjcf_path.read_text(encoding="utf-8").replace("FL_foot", "a${b}")
    (tmp_path / "dog.xml").write_text(text, encoding="utf-8")
    assert run(tmp_path, "dog.xml", "name=dog", "replace=true").returncode == 2
    assert (tmp_path / "robots/dog/robot.yaml").read_text(encoding="utf-8") == before
    assert sorted(path.name for path in (tmp_path / "robots/dog").iterdir()) == ["robot.png", "robot.yaml"]


def test_what_is_given_is_in_the_file_and_said(model: str, tmp_path: Path) -> None:
    feet = ("FR_foot", "FL_foot", "RR_foot", "RL_foot")
    done = run(tmp_path, model, "name=dog", "kp=30", "out=here", f"feet=[{','.join(feet)}]")
    assert "kp given, else the model's own" in done.stdout
    robot = load_robot(str(tmp_path / "here/robot.yaml"))
    assert robot.servos is not None and set(robot.servos.kp) == {30.0} and robot.feet == feet
    assert robot.joints[:3] == ("FR_hip_roll", "FR_hip_pitch", "FR_knee")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["name=dog"], "'model' is missing: give model=<MJCF or URDF file"),
        (["dog.xml"], "'name' is missing: give name=<of the robot>."),
        (["cat.xml", "name=cat"], "cat.xml: no such file."),
        (["dog.xml", "cat.xml", "name=cat"], "give one model; found 'dog.xml' and 'cat.xml'."),
        (["dog.xml", "name=.."], "'name' must be a name, not a path; found '..'."),
        (["dog.xml", "name=a.yaml"], "'name' must be a name, not a path; found 'a.yaml'."),
        (["dog.xml", "name=a", "feet=[FL_foot,FL_foot]"], "'feet' must name bodies, each once"),
        ([".", "name=a"], ".: a directory, not a model."),
        (["dog.xml", "name=a${b}"], "'a${b}' cannot be written into a YAML file of ours"),
        (["dog.xml", "name=a/b"], "'name' must be a name, not a path; found 'a/b'."),
        (["dog.xml", "name=hector"], "'hector' ships with ogmp_sb3: give another name."),
        (["dog.xml", "name=dog", "kp=0"], "'kp' must be above 0, found 0."),
        (["dog.xml", "name=dog", "foot=[a]"], "unknown key 'foot'"),
        (["dog.xml", "name=dog", "base=trnk"], "'base': no body 'trnk' of the world that is free (allowed: trunk)."),
        (["menagerie:pup", "name=dog"], "'menagerie:pup' needs the package mujoco-menagerie"),
    ],
)
def test_mistakes_are_a_sentence_and_nothing_is_written(
    arguments: list[str], sentence: str, model: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mujoco_menagerie", None)
    done = run(tmp_path, *arguments)
    assert done.returncode == 2 and sentence in done.stderr, done.stderr
    assert done.stderr.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dog.xml"]
