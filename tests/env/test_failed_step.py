"""A simulation that fails ends alone, is kept as it was, and fails again when it is replayed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from helpers.failures import PATH, failed_step
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.env import batch_env as env_module
from ogmp_sb3.env.failed_step import UnstableStep, capture, replay
from ogmp_sb3.sb3.vec_env import make_env


@pytest.fixture(scope="module")
def failed() -> tuple[UnstableStep, dict]:
    return failed_step()


def test_a_step_that_is_sound_does_not_fail(failed) -> None:
    task = task_from_data(failed[1], PATH)
    sound = env_module.BatchEnv(task, 2, seed=4, threads=1)
    sound.reset()
    sound.step(np.full((2, 10), 0.1))
    found = replay(capture(sound, 1, np.full(10, 0.1)), task)
    assert found.failed_at is None and found.reasons == []


def test_mujoco_writes_no_log_and_prints_nothing(tmp_path: Path, monkeypatch, capfd) -> None:
    monkeypatch.chdir(tmp_path)
    vec = make_env("parkour", 2)
    vec.reset()
    vec.batch.sim.qvel[1, 2] = np.nan
    _, _, done, _ = vec.step(np.zeros((2, 10)))
    assert done.tolist() == [False, True]
    assert list(tmp_path.iterdir()) == []
    assert "".join(capfd.readouterr()) == ""
