"""Pictures of environments, drawn for real where there is an OpenGL."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from helpers.players import flat
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.rendering.frame import drawable_of
from ogmp_sb3.rendering.painter import HEIGHT, WIDTH, Painter, Pictures
from ogmp_sb3.sb3.gym_env import OgmpEnv


def still(env: BatchEnv, steps: int) -> None:
    for _ in range(steps):
        env.step(np.zeros((env.num_envs, env.action_size)))


def test_a_scene_has_the_robot_where_it_is_and_the_ghost_at_the_reference() -> None:
    env = BatchEnv(flat(), 3, seed=1)
    env.reset()
    still(env, 5)
    view = env.view()
    scene = drawable_of(env, 2, view, None)
    np.testing.assert_array_equal(scene.robot, env.sim.qpos[2])
    np.testing.assert_array_equal(scene.base, view.base_pos_w[2])
    np.testing.assert_array_equal(scene.ghost[:3], view.reference[2, 3:6])
    np.testing.assert_array_equal(scene.ghost[3:7], view.reference_quat[2])
    np.testing.assert_array_equal(scene.ghost[env.sim.joint_qpos], env.task.robot_config.nominal_joints)
    np.testing.assert_array_equal(scene.trail, env.plan(2)[:, 3:6])


def test_ground_stays_in_sight_for_six_metres_after_the_physics_let_go_of_it() -> None:
    env = BatchEnv(flat(), 1)
    env.reset()
    near, far = (-6.0, -5.0, -1.0, 1.0, 0.2), (-9.0, -8.0, -1.0, 1.0, 0.2)
    now = drawable_of(env, 0, env.view(), None)
    before = replace(now, terrain=np.vstack([far, near, now.terrain]))
    after = drawable_of(env, 0, env.view(), before)
    np.testing.assert_array_equal(after.terrain, np.vstack([near, now.terrain]))


def test_a_robot_that_exploded_can_still_be_drawn(opengl) -> None:
    env = BatchEnv(flat(), 1)
    env.reset()
    env.sim.qpos[:] = np.nan
    assert Pictures(env).draw(0).shape == (HEIGHT, WIDTH, 3)


def test_rows_are_drawn_each_for_itself(opengl) -> None:
    env = BatchEnv(load_task("parkour", {"curriculum": None}), 2, seed=0)
    env.reset()
    env.sim.qpos[1, env.sim.base_qpos + 2] += 0.2
    pictures = Pictures(env)
    first, second = pictures.draw(0), pictures.draw(1)
    assert np.abs(first.astype(int) - second).max(axis=-1).mean() > 5
    np.testing.assert_array_equal(pictures.draw(0), first)
    pictures.close()


def test_a_painter_that_died_is_a_sentence(opengl) -> None:
    env = BatchEnv(flat(), 1)
    scene = drawable_of(env, 0, env.view(), None)
    with Painter(env.task) as painter:
        painter._process.kill()
        with pytest.raises(ValueError, match=r"drawing with MUJOCO_GL=\w+ failed \(exit code -9\)"):
            painter.draw(scene, scene.base)


def test_the_process_that_draws_imports_no_torch() -> None:
    code = "import sys, ogmp_sb3.rendering.renderer; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_no_opengl_is_looked_for_before_the_first_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "opengles")
    env = OgmpEnv("dive", render_mode="rgb_array")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="no OpenGL found with MUJOCO_GL=opengles"):
        env.render()
    env.close()
