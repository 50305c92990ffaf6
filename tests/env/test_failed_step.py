"""A simulation that fails ends alone, is kept as it was, and fails again when it is replayed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from helpers.programs import SMALL, program
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.yaml_files import apply_overrides, read_yaml
from ogmp_sb3.env import batch_env as env_module
from ogmp_sb3.env.failed_step import UnstableStep, capture, replay
from ogmp_sb3.runs.failed_steps import MOST, load_step, save_step
from ogmp_sb3.runs.run_directory import read_log
from ogmp_sb3.sb3.vec_env import OgmpVecEnv, make_env

PATH = TASKS_DIR / "parkour.yaml"
VARIED = {"randomisation": {"mass": [0.8, 1.2], "friction": [0.5, 1.0], "gains": [0.8, 1.2], "latency": [1, 1]}}


@pytest.fixture(scope="module")
def failed() -> tuple[UnstableStep, dict]:
    """A step in which a joint of environment 1 was as fast as no joint can be, on a robot that is varied."""
    data = apply_overrides(read_yaml(PATH), VARIED, "test")
    vec = OgmpVecEnv(task_from_data(data, PATH), 3, seed=4, threads=1)
    vec.reset()
    rng = np.random.default_rng(0)
    for _ in range(3):
        vec.step(rng.uniform(-0.1, 0.1, (3, 10)))
    vec.batch.sim.qvel[1, vec.batch.sim.joint_qvel[3]] = 4e4
    before = vec.batch.sim.qpos[1].copy()
    actions = rng.uniform(-0.1, 0.1, (3, 10))
    _, _, done, infos = vec.step(actions)
    assert done.tolist() == [False, True, False]
    assert ["unstable" in info for info in infos] == [False, True, False]
    step = infos[1]["unstable"]
    np.testing.assert_array_equal(step.action, actions[1])
    position = 1  # behind the time
    np.testing.assert_array_equal(step.state[position : position + len(before)], before)
    assert step.info["environment"] == 1 and step.info["control_step"] == 4
    assert set(step.varied) == {"mass", "friction", "gains"}
    return step, data


def test_a_step_survives_its_file_and_fails_again_in_the_same_physics_step(failed, tmp_path: Path) -> None:
    step, data = failed
    file = tmp_path / "unstable" / "1.safetensors"
    save_step(step, file, task=data, task_file=str(PATH), num_timesteps=12)
    assert [path.name for path in file.parent.iterdir()] == ["1.safetensors"]
    loaded, task = load_step(file)
    for name in ("state", "terrain", "action"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(step, name))
    assert loaded.varied == step.varied
    assert loaded.info["num_timesteps"] == 12
    found, again = replay(loaded, task), replay(step, task)
    assert found == again
    assert found.failed_at is not None and 1 <= found.failed_at <= task.substeps
    assert found.fastest == (task.robot_config.joints[3], pytest.approx(4e4))
    assert found.reasons


def test_a_step_that_is_sound_does_not_fail(failed) -> None:
    task = task_from_data(failed[1], PATH)
    sound = env_module.BatchEnv(task, 2, seed=4, threads=1)
    sound.reset()
    sound.step(np.full((2, 10), 0.1))
    found = replay(capture(sound, 1, np.full(10, 0.1)), task)
    assert found.failed_at is None and found.reasons == []


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
        file.write_bytes(content.replace(b'{\\"format\\": 1', b'{\\"format\\": 2'))
    elif damage == "shape":
        with safe_open(file, "numpy") as opened:
            meta = opened.metadata()
        save_file({"state": step.state[:5], "terrain": step.terrain, "action": step.action}, file, meta)
    done = program("check", f"unstable={file}", cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr and len(done.stderr.splitlines()) == 1
    assert "step.safetensors" in done.stderr or "'state' has the shape" in done.stderr


def test_mujoco_writes_no_log_and_prints_nothing(tmp_path: Path, monkeypatch, capfd) -> None:
    monkeypatch.chdir(tmp_path)
    vec = make_env("parkour", 2)
    vec.reset()
    vec.batch.sim.qvel[1, 2] = np.nan
    _, _, done, _ = vec.step(np.zeros((2, 10)))
    assert done.tolist() == [False, True]
    assert list(tmp_path.iterdir()) == []
    assert "".join(capfd.readouterr()) == ""


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
