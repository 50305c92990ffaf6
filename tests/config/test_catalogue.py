"""Files by name or path: what ships, and what a user has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from helpers.mistakes import SHIPPED, write
from ogmp_sb3 import load_task
from ogmp_sb3.config.catalogue import PACKAGE, find, names
from ogmp_sb3.config.plugins import FILES


def test_a_task_is_found_by_name_and_by_path(tmp_path: Path) -> None:
    assert set(SHIPPED) <= set(names("task"))
    assert all(find("task", name).is_file() for name in names("task"))
    path = write(tmp_path, SHIPPED["parkour"])
    assert find("task", path) == find("task", str(path)) == path
    assert load_task(path).name == "mine"


@pytest.mark.parametrize("name", ["parkuor", "Parkour"])
def test_an_unknown_task_has_a_closest_match(name: str) -> None:
    with pytest.raises(KeyError, match=rf"unknown task '{name}' \(allowed: .*\)\. Did you mean 'parkour'\? Or give"):
        load_task(name)


@pytest.mark.parametrize("name", ["", ".", "..", "*", "a\nb", "a\0b", "x" * 5000, 3, None])
def test_what_cannot_name_a_task_is_an_error(name: Any) -> None:
    with pytest.raises(KeyError, match="unknown task"):
        load_task(name)


@pytest.mark.parametrize("name", ["nothing.yaml", "/", "/nowhere/x.yml", "a\0b.yaml", "x" * 5000 + ".yaml"])
def test_a_missing_task_file_is_an_error(name: str) -> None:
    with pytest.raises(ValueError, match="no such file"):
        load_task(name)


@pytest.mark.parametrize("kind", FILES)
def test_what_ships_is_found_by_its_name_and_by_its_path(kind: str, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = sorted(PACKAGE.glob(FILES[kind]))
    assert shipped and sorted(find(kind, name) for name in names(kind)) == shipped
    for file in shipped:
        own = file if file.suffix == ".yaml" else file.parent
        assert find(kind, own) == find(kind, own.name, relative_to=own.parent) == file


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("name", ["", "..", "*", "a\0b", "x" * 5000, "ñ\n"])
def test_what_cannot_be_a_name_is_unknown(kind: str, name: str, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(KeyError, match=r"\(allowed: \w+"):
        find(kind, name)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (
            "task",
            "unknown task 'parkuor' (allowed: dive, dive_robot, parkour, parkour_robot, stairs). "
            "Did you mean 'parkour'? ",
        ),
        ("encoder", "no encoder 'parkuor' (allowed: dive, parkour). Did you mean 'parkour'? ogmp-encode trains one."),
        ("policy", "'parkuor' is neither a run directory nor a shipped policy (allowed: dive, parkour). Did you mean"),
        ("robot", "unknown robot 'parkuor' (allowed: hector)."),
        ("scene", "unknown scene 'parkuor' (allowed: faster, pace_leap_pace, pace_to_jump). Or give the path"),
    ],
)
def test_an_unknown_name_lists_those_that_are_known(kind: str, message: str, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(KeyError) as caught:
        find(kind, "parkuor")
    assert caught.value.args[0].startswith(message)


def test_an_encoder_in_the_working_directory_comes_before_a_shipped_one(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("parkour", "mine"):
        (tmp_path / "encoders" / name).mkdir(parents=True)
        (tmp_path / "encoders" / name / "encoder.json").touch()
    assert find("encoder", "parkour") == Path("encoders/parkour/encoder.json")
    assert names("encoder") == ["dive", "mine", "parkour"]


def test_a_name_does_not_lead_out_of_its_folder(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    for kind in ("encoder", "policy"):
        with pytest.raises(KeyError):
            find(kind, "../encoders/parkour")
