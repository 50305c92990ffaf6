"""What is shared of a policy is whole, and is the same policy elsewhere."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from helpers.hub import running_hub, use
from helpers.learners import learner, policy_info
from ogmp_sb3.commands.share.bundle import copy_replay, own_paths, training_file, write_policy
from ogmp_sb3.config.catalogue import ROBOTS_DIR
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.runs.checkpoint import save_checkpoint
from ogmp_sb3.runs.policies import LoadedPolicy, load_policy
from ogmp_sb3.runs.robot_copy import ROBOT, keep_robot
from ogmp_sb3.runs.storage import verify


def of_own_robot(folder: Path) -> LoadedPolicy:
    """A policy of a run whose robot has no name, and whose copy of it is in the run alone, as that of a large one."""
    shutil.copytree(ROBOTS_DIR / "hector", folder / "mine")
    file, run = folder / "mine" / "robot.yaml", folder / "run"
    run.mkdir()
    _, record = keep_robot(load_robot(str(file)), str(file), run)
    info = policy_info()
    info["task"] |= {"robot": str(file)}
    info[ROBOT] = {"digest": record.digest, "files": record.files, "beside": record.beside}
    (run / "config.yaml").write_text("overrides: [rho=0.5]\n")
    model, _ = learner()
    save_checkpoint(model, run / "best", info)
    shutil.rmtree(run / "best" / ROBOT, ignore_errors=True)
    (run / "best" / "manifest.json").unlink()
    shutil.rmtree(folder / "mine")
    return load_policy(run / "best")


def test_a_policy_is_complete_without_its_run_and_its_robot(tmp_path: Path) -> None:
    loaded = of_own_robot(tmp_path)
    digest = loaded.digest
    (tmp_path / "out").mkdir()
    write_policy(loaded, tmp_path / "run" / "config.yaml", tmp_path / "out")
    shutil.move(tmp_path / "out", tmp_path / "elsewhere")
    shutil.rmtree(tmp_path / "run")
    verify(tmp_path / "elsewhere", "policy.json", "policy.safetensors", "robot/robot.yaml")
    again = load_policy(tmp_path / "elsewhere")
    assert again.digest == digest
    assert again.task.robot_config.path.is_relative_to(tmp_path / "elsewhere")
    assert training_file(again, None) == tmp_path / "elsewhere" / "training.yaml"


def test_a_robot_is_whole_in_the_cache_of_the_hub_where_files_are_links(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("huggingface_hub", reason="needs the extra 'hub'")
    loaded, out = of_own_robot(tmp_path), tmp_path / "out"
    out.mkdir()
    write_policy(loaded, None, out)
    files = {path.relative_to(out).as_posix(): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with running_hub() as hub:
        use(hub, tmp_path / "cache", monkeypatch)
        hub.add("me/own", files)
        again = load_policy("hf:me/own")
    assert again.task.robot_config.path.is_relative_to(tmp_path / "cache")
    assert again.digest == loaded.digest


def test_a_robot_that_nobody_else_has_is_a_sentence(tmp_path: Path) -> None:
    loaded = of_own_robot(tmp_path)
    shutil.move(tmp_path / "run" / ROBOT, tmp_path / "mine")
    (tmp_path / "out").mkdir()
    with pytest.raises(
        ValueError, match=r"there is no copy of its robot '.*/mine/robot.yaml', without which nobody can"
    ):
        write_policy(loaded, None, tmp_path / "out")


def test_a_replay_is_a_file_or_a_directory_of_files(tmp_path: Path) -> None:
    (tmp_path / "r" / "inner").mkdir(parents=True)
    (tmp_path / "r" / "inner" / "b.bin").touch()
    (tmp_path / "r" / "index.html").touch()
    (tmp_path / "empty").mkdir()
    assert copy_replay(tmp_path / "r", tmp_path / "out") == ["replay/index.html", "replay/inner/b.bin"]
    assert copy_replay(tmp_path / "r" / "index.html", tmp_path / "one") == ["replay/index.html"]
    assert (tmp_path / "one" / "replay" / "index.html").is_file()
    with pytest.raises(ValueError, match=r"'replay': '.*empty' is neither a file nor a directory of files"):
        copy_replay(tmp_path / "empty", tmp_path / "out")


def test_paths_of_this_machine_are_found_wherever_they_are() -> None:
    data = {"task_file": "/home/me/a.yaml", "task": {"robot": "hector", "list": ["/x", {"a": "/x", "b": 1}]}}
    assert own_paths(json.loads(json.dumps(data))) == ["/home/me/a.yaml", "/x"]
