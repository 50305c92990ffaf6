"""The speed of the simulation, against bare physics and other vectorisations."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

from ogmp_sb3.commands.bench import simulation as bench_sim
from ogmp_sb3.config.load import load_task
from ogmp_sb3.sb3.vec_env import OgmpVecEnv


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_the_bare_replay_is_the_same_physics_bit_for_bit(name: str) -> None:
    task = load_task(name, {"episode_steps": 15})
    recording = bench_sim.record(task, num_envs=3, steps=40)
    assert sum(len(rows) for rows, _, _ in recording.resets) > 3
    env = OgmpVecEnv(task, 3, seed=0)
    env.reset()
    for action in recording.actions:
        env.step(action)
    sim, replay = bench_sim.bare_replay(task, recording)
    for _ in range(2):  # it can be done again
        assert len(list(replay())) == 40
    np.testing.assert_array_equal(sim.mj.state, env.batch.sim.mj.state)


def test_shares_of_a_step_are_parts_of_a_whole() -> None:
    task = load_task("parkour")
    shares = bench_sim._shares(task, bench_sim.record(task, num_envs=4, steps=30))
    assert set(shares) == {"share_physics", "share_oracle", "share_observation", "share_reward", "share_reset"}
    assert all(0 < share < 1 for share in shares.values())


def test_sb3_s_own_vectorisation_steps_the_same_task() -> None:
    task = load_task("parkour", {"modes.jump": None, "episode_steps": 7})
    with closing(bench_sim.stock_env(DummyVecEnv, task, 2)) as env:
        assert [batch.task for batch in env.get_attr("batch")] == [task, task]
