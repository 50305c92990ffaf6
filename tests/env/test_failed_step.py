"""A simulation that fails ends alone, is kept as it was, and fails again when it is replayed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from helpers.batches import actions
from helpers.failures import PATH, failed_step
from ogmp_sb3.config.load import load_task, task_from_data
from ogmp_sb3.env import batch_env as env_module
from ogmp_sb3.env import failed_step as failed_step_module
from ogmp_sb3.env.failed_step import UnstableStep, capture, replay
from ogmp_sb3.env.simulation import Simulation
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


@pytest.mark.parametrize("latency", [0.0, 0.016, 0.044])
def test_a_replay_repeats_targets_and_kicks_that_came_on_the_way(latency: float, monkeypatch) -> None:
    """Kicks every 14 ms, and a target after 16 ms: the state behind the control step comes out bit for bit."""
    replayed = []
    monkeypatch.setattr(
        failed_step_module,
        "Simulation",
        lambda *args, **given: replayed.append(Simulation(*args, **given)) or replayed[0],
    )
    task = load_task(
        "parkour", {"randomisation": {"action_delay": {"delay": latency}, "push": {"every": 0.014, "speed": 0.3}}}
    )
    env = env_module.BatchEnv(task, 3, seed=4, threads=1)
    env.reset()
    for command in actions(4, 3):
        env.step(command)
    assert len(env.sim.events[1].later(1).at) > 0
    replay(capture(env, 1, command[1]), task)
    np.testing.assert_array_equal(replayed[0].mj.state[0], env.sim.mj.state[1])


def test_a_kick_on_the_way_fails_again_in_its_physics_step() -> None:
    task = load_task("parkour", {"randomisation": {"push": {"every": 0.3, "speed": 1.0}}})
    env = env_module.BatchEnv(task, 1, seed=4, threads=1)
    env.reset()
    env.disturbances.arrays()["next_push"][:] = 22
    env.disturbances.arrays()["push_speed"][:] = 1e11
    for _ in range(2):
        result = env.step(np.zeros((1, 10)))
    assert result.termination.tolist() == ["unstable"]
    assert replay(capture(env, 0, np.zeros(10)), task).failed_at == 22 - 15 + 1


def test_mujoco_writes_no_log_and_prints_nothing(tmp_path: Path, monkeypatch, capfd) -> None:
    monkeypatch.chdir(tmp_path)
    vec = make_env("parkour", 2)
    vec.reset()
    vec.batch.sim.qvel[1, 2] = np.nan
    _, _, done, _ = vec.step(np.zeros((2, 10)))
    assert done.tolist() == [False, True]
    assert list(tmp_path.iterdir()) == []
    assert "".join(capfd.readouterr()) == ""
