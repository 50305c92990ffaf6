"""Files of steps in which a simulation failed."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from helpers.batches import actions
from helpers.failures import PATH, failed_step
from helpers.programs import SMALL, program
from ogmp_sb3.config.load import load_robot, task_from_data
from ogmp_sb3.config.yaml_files import apply_overrides, read_yaml
from ogmp_sb3.env import batch_env as env_module
from ogmp_sb3.env.failed_step import UnstableStep, capture, replay
from ogmp_sb3.runs.failed_steps import MOST, load_step, save_step
from ogmp_sb3.runs.robot_copy import keep_robot
from ogmp_sb3.runs.run_directory import read_log


@pytest.fixture(scope="module")
def failed() -> tuple[UnstableStep, dict]:
    return failed_step()


def test_a_step_survives_its_file_and_fails_again_in_the_same_physics_step(failed, tmp_path: Path) -> None:
    step, data = failed
    file = tmp_path / "unstable" / "1.safetensors"
    save_step(step, file, task=data, task_file=str(PATH), num_timesteps=12)
    assert [path.name for path in file.parent.iterdir()] == ["1.safetensors"]
    loaded, task = load_step(file)
    for name in ("state", "terrain", "action"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(step, name))
    assert loaded.varied.keys() == step.varied.keys() and loaded.substeps == step.substeps
    for name in step.varied:
        np.testing.assert_array_equal(loaded.varied[name], step.varied[name])
    assert loaded.info["num_timesteps"] == 12
    found, again = replay(loaded, task), replay(step, task)
    assert found == again
    assert found.failed_at is not None and 1 <= found.failed_at <= task.substeps
    assert found.fastest == (task.robot_config.joints[3], pytest.approx(4e4))
    assert found.reasons


def test_targets_and_kicks_on_the_way_survive_the_file(tmp_path: Path) -> None:
    overrides = {"randomisation": {"action_delay": {"delay": 0.016}, "push": {"every": 0.014, "speed": 0.3}}}
    data = apply_overrides(read_yaml(PATH), overrides, "test")
    env = env_module.BatchEnv(task_from_data(data, PATH), 2, seed=4, threads=1)
    env.reset()
    for command in actions(4, 2):
        env.step(command)
    step = capture(env, 1, command[1])
    assert step.targets.at.tolist() == [8] and len(step.kicks.at) in (1, 2)
    save_step(step, tmp_path / "step.safetensors", task=data, task_file=str(PATH))
    loaded, _ = load_step(tmp_path / "step.safetensors")
    for name in ("targets", "kicks"):
        for found, expected in zip(
            vars(getattr(loaded, name)).values(), vars(getattr(step, name)).values(), strict=True
        ):
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("damage", ["empty", "half", "pickle", "no data", "other format", "task", "versions", "shape"])
def test_a_file_that_is_damaged_is_a_sentence(damage: str, failed, tmp_path: Path) -> None:
    step, data = failed
    file = tmp_path / "step.safetensors"
    extra = {"task": data, "task_file": str(PATH)}
    if damage == "task":
        extra["task"] = {**data, "rho": -1}
    if damage == "versions":
        extra["versions"] = [3]
    save_step(step, file, **extra)
    content = file.read_bytes()
    if damage == "empty":
        file.write_bytes(b"")
    elif damage == "half":
        file.write_bytes(content[: len(content) // 2])
    elif damage == "pickle":
        file.write_bytes(b"\x80\x04\x95cposix\nsystem\n.")
    elif damage == "no data":
        save_file({"state": step.state}, file)
    elif damage == "other format":
        file.write_bytes(content.replace(b'{\\"format\\": 3', b'{\\"format\\": 2'))
    elif damage == "shape":
        with safe_open(file, "numpy") as opened:
            meta = opened.metadata()
            arrays = {name: opened.get_tensor(name) for name in opened.keys()}
        save_file({**arrays, "state": step.state[:5]}, file, meta)
    done = program("check", f"unstable={file}", cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr and len(done.stderr.splitlines()) == 1
    assert "step.safetensors" in done.stderr or "'state' has the shape" in done.stderr


def test_a_training_goes_on_counts_keeps_and_says_how_to_replay(tmp_path: Path, monkeypatch) -> None:
    """At every other step, the simulation of one environment is spoilt."""
    step, steps = env_module.BatchEnv.step, iter(range(10**6))

    def spoilt(self: env_module.BatchEnv, actions: np.ndarray, rows: np.ndarray | None = None):
        if next(steps) % 2 == 1:
            self.sim.qvel[3, 7] = np.nan
        return step(self, actions, rows)

    monkeypatch.setattr(env_module.BatchEnv, "step", spoilt)
    with pytest.warns(UserWarning, match="A simulation failed at step 16: its episode ended") as caught:
        done = program("train", "task=dive", "total_timesteps=640", *SMALL, "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len([w for w in caught if "A simulation failed" in str(w.message)]) == 1
    log = read_log(tmp_path / "run" / "progress.csv")
    assert log["train/unstable_episodes"].tolist() == [8, 16, 24, 32, 40]
    assert np.nanmin(log["termination/unstable"]) > 0
    assert not any(np.isinf(column).any() for column in log.values())
    files = sorted((tmp_path / "run" / "unstable").iterdir())
    assert len(files) == MOST
    monkeypatch.setattr(env_module.BatchEnv, "step", step)
    shown = program("check", f"unstable={files[0]}", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    assert "fails in physics step 1 of 15" in shown.stdout
    assert "seed 3" in shown.stdout and "environment 3" in shown.stdout


def test_a_step_of_a_run_that_has_moved_is_replayed_with_the_run_s_robot(failed, tmp_path: Path) -> None:
    step, data = failed
    robot, record = keep_robot(load_robot("hector"), "hector", tmp_path)
    file, data = tmp_path / "unstable" / "1.safetensors", {**data, "robot": "/no/robot.yaml"}
    save_step(step, file, task=data, task_file=str(PATH), robot=asdict(record))
    _, task = load_step(file)
    assert task.robot_config == load_robot(str(robot.path))
