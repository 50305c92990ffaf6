"""The files of a robot side by side: the same model to the last bit, wherever they lay."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from helpers.projects import BOX, make_project
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.robot import SRB, RobotConfig
from ogmp_sb3.config.robot_files import robot_files

GEOMS = '<worldbody><body><freejoint/><geom type="mesh" mesh="{}"/></body></worldbody>'


def robot_of(folder: Path, mjcf: str) -> RobotConfig:
    """A robot.yaml that names a model; what else it says does not matter here."""
    (folder / "robot.yaml").write_text(f"mjcf: {mjcf}\nname: x\n")
    srb = SRB(mass=1.0, inertia=(1.0, 1.0, 1.0))
    return RobotConfig(
        name="x", mjcf=mjcf, source="", base="b", joints=(), feet=("f",), nominal_height=1.0, nominal_joints=(),
        leg_length=1.0, srb=srb, path=folder / "robot.yaml",
    )  # fmt: skip


def written(files: dict[str, bytes], folder: Path) -> Path:
    """The files in one directory, and what its robot.yaml names."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    (line,) = [line for line in files["robot.yaml"].decode().splitlines() if line.startswith("mjcf: ")]
    return folder / line.removeprefix("mjcf: ")


def png(path: Path, grey: int) -> None:
    """A picture of 4 x 4 pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 4, 4, 8, 0, 0, 0, 0)
    rows = zlib.compress(bytes([0, *[grey] * 3, 255 - grey] * 4))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b""))


def assert_same(one: Path, other: Path) -> mujoco.MjModel:
    """That two models are the same, all arrays and names."""
    models = [mujoco.MjSpec.from_file(str(path)).compile() for path in (one, other)]
    for name in dir(models[0]):
        first, second = (getattr(model, name) for model in models)
        if isinstance(first, np.ndarray) and not (name.endswith("pathadr") or name.startswith("_")):
            np.testing.assert_array_equal(first, second, err_msg=name)
    assert models[0].names == models[1].names
    return models[1]


def test_files_that_lie_side_by_side_stay_as_they_are() -> None:
    robot = load_robot("hector")
    files = robot_files(robot)
    assert files == {"robot.yaml": robot.path.read_bytes(), "hector.xml": robot.mjcf_path.read_bytes()}


def test_a_project_s_includes_and_mesh_come_together(tmp_path: Path) -> None:
    make_project(tmp_path / "project")
    robot = load_robot(str(tmp_path / "project" / "robot.yaml"))
    files = robot_files(robot)
    assert sorted(files) == ["all.xml", "cube.obj", "hector.xml", "robot.yaml", "servos.xml"]
    mjcf = written(files, tmp_path / "copy")
    (tmp_path / "project").rename(tmp_path / "moved")
    assert_same(tmp_path / "moved" / "models" / "hector" / "hector.xml", mjcf)
    assert robot_files(load_robot(str(tmp_path / "copy" / "robot.yaml"))) == files


def test_a_relative_path_is_the_same_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_project(tmp_path)
    files = robot_files(load_robot(str(tmp_path / "robot.yaml")))
    monkeypatch.chdir(tmp_path)
    assert robot_files(load_robot("robot.yaml")) == files


@pytest.mark.parametrize("name", ["a & b.obj", "it's <1>.obj", "Füße.obj", "a--b.obj", "two  blanks.obj", "-->.obj"])
def test_odd_names_of_files(name: str, tmp_path: Path) -> None:
    (tmp_path / "in" / "meshes").mkdir(parents=True)
    (tmp_path / "in" / "meshes" / name).write_text(BOX.format(0.1))
    quoted = name.replace("&", "&amp;").replace("<", "&lt;").replace("'", "&#39;")
    stem = quoted.removesuffix(".obj")
    xml = f"""<mujoco><!-- a -- comment <include file="no.xml"/> --><compiler meshdir='meshes'/>
    <asset><mesh file='{quoted}'/></asset>{GEOMS.format(stem)}</mujoco>"""
    (tmp_path / "in" / "model.xml").write_text(xml, encoding="utf-8")
    files = robot_files(robot_of(tmp_path / "in", "model.xml"))
    assert list(files) == ["robot.yaml", "model.xml", name]
    assert_same(tmp_path / "in" / "model.xml", written(files, tmp_path / "out"))


@pytest.mark.parametrize(
    ("compiler", "reference", "place"),
    [
        ("", "cube.obj", "cube.obj"),
        ("", "./a/../cube.obj", "cube.obj"),
        ("", r"a\cube.obj", "a/cube.obj"),
        ('assetdir="a"', "cube.obj", "a/cube.obj"),
        ('assetdir="b" meshdir="a"', "b/cube.obj", "a/b/cube.obj"),
        ('meshdir="../outside"', "cube.obj", "../outside/cube.obj"),
        ('meshdir="{absolute}"', "cube.obj", "../outside/cube.obj"),
        ('meshdir="a"', "{absolute}/cube.obj", "../outside/cube.obj"),
        ('meshdir="a" strippath="true"', "elsewhere/cube.obj", "a/cube.obj"),
        ('meshdir="b"/><compiler meshdir="a"', "cube.obj", "a/cube.obj"),
    ],
)
def test_a_mesh_is_found_where_mujoco_finds_it(compiler: str, reference: str, place: str, tmp_path: Path) -> None:
    folder, absolute = tmp_path / "in", str(tmp_path / "outside")
    (folder / "a" / "b").mkdir(parents=True)
    (folder / "b").mkdir()
    (tmp_path / "outside").mkdir()
    (folder / place).write_text(BOX.format(0.1))
    compiler, reference = (text.replace("{absolute}", absolute) for text in (compiler, reference))
    xml = f'<mujoco><compiler {compiler}/><asset><mesh file="{reference}"/></asset>{GEOMS.format("cube")}</mujoco>'
    (folder / "model.xml").write_text(xml)
    files = robot_files(robot_of(folder, "model.xml"))
    assert files["cube.obj"] == (folder / place).read_bytes()
    assert_same(folder / "model.xml", written(files, tmp_path / "out"))
    assert absolute.encode() not in files["model.xml"]


def test_two_files_of_one_name_pictures_height_fields_and_models_within_the_model(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    for name in ("left", "right", "leg/meshes", "pictures"):
        (folder / name).mkdir(parents=True)
    for name, size in (("left/cube.obj", 0.1), ("right/cube.obj", 0.2), ("leg/meshes/cube.obj", 0.3)):
        (folder / name).write_text(BOX.format(size))
    for i, face in enumerate(("right", "left", "up", "down", "front", "back")):
        png(folder / "pictures" / f"{face}.png", 10 * i)
    faces = " ".join(f'file{face}="{face}.png"' for face in ("right", "left", "up", "down", "front", "back"))
    png(folder / "hills.png", 40)
    leg = '<mujoco model="leg"><compiler meshdir="meshes"/><asset><mesh file="cube.obj"/></asset><worldbody>'
    leg += '<body name="thigh"><geom type="mesh" mesh="cube"/></body></worldbody></mujoco>'
    (folder / "leg" / "model.xml").write_text(leg)
    xml = f"""<mujoco><compiler texturedir="pictures"/><asset><mesh name="l" file="left/cube.obj"/>
    <mesh name="r" file="right/cube.obj"/><texture name="sky" type="cube" {faces}/>
    <hfield name="hills" file="hills.png" size="1 1 1 1"/><model name="leg" file="leg/model.xml"/></asset>
    <worldbody><geom type="hfield" hfield="hills"/><body><freejoint/><geom type="mesh" mesh="l"/>
    <geom type="mesh" mesh="r"/><attach model="leg" body="thigh" prefix="x"/></body></worldbody></mujoco>"""
    (folder / "model.xml").write_text(xml)
    model = assert_same(folder / "model.xml", written(robot_files(robot_of(folder, "model.xml")), tmp_path / "out"))
    assert (model.nmesh, model.ntex, model.nhfield) == (3, 1, 1)


def test_a_model_that_lies_elsewhere_is_named_anew_in_robot_yaml(tmp_path: Path) -> None:
    make_project(tmp_path)
    robot = load_robot(str(tmp_path / "robot.yaml"))
    copy = written(robot_files(robot), tmp_path / "copy")
    assert copy.name == "hector.xml"
    again = load_robot(str(tmp_path / "copy" / "robot.yaml"))
    assert (again.joints, again.srb, again.mjcf) == (robot.joints, robot.srb, "hector.xml")
