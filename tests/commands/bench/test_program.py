"""The comparisons must compare like with like; how fast things are is no test."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from stable_baselines3.common.vec_env import DummyVecEnv

from helpers.programs import program
from ogmp_sb3.commands.bench import physics as bench_physics
from ogmp_sb3.commands.bench import program as bench
from ogmp_sb3.commands.bench import simulation as bench_sim
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.simulation import Simulation
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
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
    replay()
    np.testing.assert_array_equal(sim.mj.state, env.batch.sim.mj.state)


def test_shares_of_a_step_are_parts_of_a_whole() -> None:
    task = load_task("parkour")
    shares = bench_sim._shares(task, bench_sim.record(task, num_envs=4, steps=30))
    assert set(shares) == {"share_physics", "share_oracle", "share_observation", "share_reward", "share_reset"}
    assert all(0 < share < 1 for share in shares.values())


def test_learners_are_compared_on_the_same_full_rollouts(monkeypatch: pytest.MonkeyPatch) -> None:
    trained = []
    for kind in (StockRecurrentPPO, RecurrentPPO):
        monkeypatch.setattr(kind, "train", lambda learner: trained.append((type(learner), learner.rollout_buffer.full)))
    numbers = bench.bench_learner(load_task("parkour"), num_envs=2, repeats=2)
    assert trained == [(StockRecurrentPPO, True), (RecurrentPPO, True), (RecurrentPPO, True)] * 2
    assert {"stock_samples_per_second", "exact_samples_per_second", "chunked_samples_per_second"} <= set(numbers)


def test_sb3_s_own_vectorisation_steps_the_same_task() -> None:
    task = load_task("parkour", {"modes.jump": None, "episode_steps": 7})
    with closing(bench_sim.stock_env(DummyVecEnv, task, 2)) as env:
        assert [batch.task for batch in env.get_attr("batch")] == [task, task]


def test_what_a_benchmark_does_not_use_is_refused() -> None:
    with pytest.raises(ValueError, match="'run' is for 'physics' alone, not for 'train'"):
        bench.BenchConfig(what="train", run="parkour")
    with pytest.raises(ValueError, match="'steps' is for 'sim' and 'train', not for 'learner'"):
        bench.BenchConfig(what="learner", steps=10)


def test_numbers_are_kept_with_what_they_are_of(tmp_path: Path) -> None:
    arguments = ["steps=10", "repeats=1", "num_envs=4", "modes.jump=null", "json=out/sim.json"]
    done = program("bench", "sim", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "sim.json").read_text())
    assert report["overrides"] == ["modes.jump=null"] and report["config"]["steps"] == 10
    assert 0 < report["numbers"]["sim_over_bare_physics"] < 1.5
    assert (tmp_path / "out" / "sim.png").is_file()
    assert "sim_over_bare_physics" in done.stdout


def test_a_replay_at_the_task_s_own_step_ends_where_the_run_did() -> None:
    task = load_task("parkour")
    windows = bench_physics.record_windows(task, None, num_envs=4)
    assert len(windows) == bench_physics.WINDOWS
    sim = Simulation(task.robot_config, 1, task.physics_dt, task.track.boxes, 1)
    window = windows[0]
    sim.set_terrain(np.array([0]), window.terrain[None])
    sim.mj.state[0] = window.state
    sim.mj.bind("qacc_warmstart")[:] = 0.0
    for ctrl in window.ctrl:
        sim.ctrl[:] = ctrl
        sim.step(None, task.substeps)
    (outcome,) = bench_physics.replay_windows(task, [window], task.physics_dt)
    np.testing.assert_allclose(outcome.base_pos, sim.qpos[0, :3], atol=1e-6)


def test_half_the_step_strays_less_from_the_reference() -> None:
    task = load_task("parkour")
    windows = bench_physics.record_windows(task, None, num_envs=4)[:8]
    reference, fine, coarse = (bench_physics.replay_windows(task, windows, dt) for dt in (0.0005, 0.001, 0.005))

    def error(outcomes: list[bench_physics.Outcome]) -> float:
        return np.median([np.linalg.norm(a.base_pos - b.base_pos) for a, b in zip(outcomes, reference, strict=True)])

    assert error(fine) < error(coarse)
