"""Where a robot's model lies."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ogmp_sb3.config.model_file import model_file


def test_a_path_is_relative_to_robot_yaml_or_whole(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert model_file("meshes/a.xml", Path("robots/a")) == Path("robots/a/meshes/a.xml")
    assert model_file(str(tmp_path / "a.xml"), Path("robots/a")) == tmp_path / "a.xml"
    assert model_file("~/a.xml", Path("robots/a")) == tmp_path / "a.xml"


def test_a_file_of_an_installed_package_is_found() -> None:
    found = model_file("package:ogmp_sb3/robots/hector/hector.xml", Path("elsewhere"))
    assert found.is_file() and found.name == "hector.xml"


@pytest.mark.parametrize("package", ["no_such_package_here", "sys", "os.path", ""])
def test_a_package_that_is_not_there_is_one_sentence(package: str) -> None:
    with pytest.raises(ValueError, match=f"'package:{package}/a.xml' is in the package '{package}', which is not inst"):
        model_file(f"package:{package}/a.xml", Path())


class Menagerie(SimpleNamespace):
    """What mujoco-menagerie answers, without a download."""

    class MenagerieError(Exception):
        pass

    def __init__(self, broken: bool = False) -> None:
        def xml(entry: str) -> str:
            if broken:
                raise self.MenagerieError("no network:\n  refused")
            return f"/cache/unitree_g1/{entry}.xml"

        robot = SimpleNamespace(entry_names=("g1", "g1_mjx", "scene"), default_model="g1", xml=xml)
        super().__init__(names=lambda: ["unitree_g1", "unitree_h1"], get=lambda name: robot)


@pytest.mark.parametrize(
    ("name", "file"), [("menagerie:unitree_g1", "g1.xml"), ("menagerie:unitree_g1/g1_mjx", "g1_mjx.xml")]
)
def test_a_model_of_the_menagerie_is_asked_of_its_package(name: str, file: str, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", Menagerie())
    assert model_file(name, Path("elsewhere")) == Path("/cache/unitree_g1") / file


@pytest.mark.parametrize(
    ("name", "package", "message"),
    [
        (
            "menagerie:unitree_g1",
            None,
            "'menagerie:unitree_g1' needs the package mujoco-menagerie: pip install ",
        ),
        ("menagerie:unitree_g2", Menagerie(), r"no robot 'unitree_g2' \(allowed: .*Did you mean 'unitree_g1'\?"),
        ("menagerie:unitree_g1/g1_mjk", Menagerie(), r"no model 'g1_mjk' \(allowed: .*Did you mean 'g1_mjx'\?"),
        ("menagerie:unitree_g1", Menagerie(broken=True), "'menagerie:unitree_g1': no network: refused"),
    ],
)
def test_what_the_menagerie_does_not_have_is_one_sentence(name: str, package: Any, message: str, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", package)
    with pytest.raises(ValueError, match=message):
        model_file(name, Path())
