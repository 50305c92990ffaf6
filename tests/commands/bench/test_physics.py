"""Physics steps of other lengths, against a fine one."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.commands.bench import physics as bench_physics
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.simulation import Simulation


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
