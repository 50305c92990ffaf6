"""Kilometres down the endless track everything is as it is at its start, and nothing grows on the way.

The tolerances are those of float64: at 10 km two neighbouring numbers lie 2e-12 m apart. Legged motion is chaotic, so
that two runs that differ by as much part within a second or two, wherever they are.
"""

from __future__ import annotations

import importlib.util
import math
from typing import Any

import numpy as np
import pytest

from helpers.paths import ROOT
from ogmp_sb3 import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.guidance.course import KEEP_BEHIND, REACH, Course
from ogmp_sb3.guidance.set_points import APEX, END, FOREVER
from ogmp_sb3.guidance.srb import GRAVITY, POS
from ogmp_sb3.guidance.terrain import NOTHING, TOP, X0, X1, height_at

FAR = 10_000.0  # m
EXACT = 1e-9  # m: of what is computed from the place along the track
MOVING = 1e-6  # of what physics makes of it within eight control steps
TASK = load_task("parkour", {"rho": None, "curriculum": None, "terminations": {}})


def move(env: BatchEnv, arrays: dict[str, np.ndarray], plain: dict[str, Any], distance: float) -> None:
    """Put environments into a state, with robots, terrain and plans moved along the track."""
    arrays = {name: values.copy() for name, values in arrays.items()}
    terrain, spans = arrays["course.terrain"], arrays["course.spans"]
    for column in (X0, X1):
        terrain[..., column][terrain[..., TOP] > NOTHING] += distance
    spans[..., END][spans[..., END] < FOREVER] += distance
    arrays["course._laid"] += distance
    arrays["plans.reference"][..., POS.start] += distance
    env.set_state(arrays, plain)
    env.sim.qpos[:, env.sim.base_qpos] += distance


def two_places(num_envs: int = 8) -> tuple[BatchEnv, BatchEnv]:
    """The same environments at the start of the track and far down it, in the middle of an episode."""
    near, far = (BatchEnv(TASK, num_envs, seed=3, threads=1) for _ in range(2))
    near.reset()
    for _ in range(3):
        near.step(np.zeros((num_envs, near.action_size)))
    move(far, *near.state(), FAR)
    return near, far


def test_what_is_seen_and_planned_far_out_is_what_is_seen_and_planned_at_the_start() -> None:
    near, far = two_places()
    a, b = near.view(), far.view()
    x = np.zeros(12)
    x[POS.start] = FAR
    np.testing.assert_allclose(b.state - x, a.state, atol=EXACT)
    np.testing.assert_allclose(b.reference - x, a.reference, atol=EXACT)
    np.testing.assert_array_equal(b.ground_height, a.ground_height)
    np.testing.assert_allclose(b.deviation, a.deviation, atol=EXACT)
    points = np.stack([np.linspace(-0.5, REACH, 400), np.zeros(400)], axis=1)[None].repeat(8, axis=0)
    np.testing.assert_array_equal(
        height_at(far.terrain, points + np.array([FAR, 0.0])), height_at(near.terrain, points)
    )
    rows = np.arange(8)
    for env in (near, far):
        env.guide.query(rows, env._states(rows))
    np.testing.assert_allclose(far.guide.plans.reference - x, near.guide.plans.reference, atol=EXACT)
    # The encoder computes in float32.
    np.testing.assert_allclose(far.guide.plans.latent, near.guide.plans.latent, atol=1e-5)


def test_physics_reward_and_observation_far_out_are_those_at_the_start() -> None:
    near, far = two_places()
    rng = np.random.default_rng(0)
    for _ in range(8):
        action = rng.uniform(-0.3, 0.3, (8, near.action_size))
        a, b = near.step(action), far.step(action)
        np.testing.assert_allclose(b.observation, a.observation, atol=MOVING)
        np.testing.assert_allclose(b.reward, a.reward, atol=MOVING)
        moved = far.sim.qpos.copy()
        moved[:, far.sim.base_qpos] -= FAR
        np.testing.assert_allclose(moved, near.sim.qpos, atol=MOVING)
    vertical = near.sim.qacc[:, near.sim.base_qvel + 2]
    assert (np.abs(vertical + GRAVITY) > 0.1).all()  # the ground carries them: none is falling freely


@pytest.fixture(scope="module")
def long_course() -> Course:
    """Two tracks of ten kilometres, laid as a robot moves along them."""
    course = Course(TASK, num_envs=2)
    rng = [np.random.default_rng(row) for row in range(2)]
    for row in range(2):
        course.begin(row, rng[row], 1.0)
    for x in np.arange(0.0, FAR, 0.5):
        for row in course.short_of_track(np.arange(2), np.full(2, x)):
            course.extend(row, x, rng[row], 1.0)
    return course


def test_a_track_of_ten_kilometres_is_as_long_as_its_modes(long_course: Course) -> None:
    for row in range(2):
        length = math.fsum(call.segment().length for call in long_course.modes[row])
        assert long_course._laid[row] == pytest.approx(length, abs=1e-7)
        assert long_course._laid[row] > FAR


def test_the_ground_after_ten_kilometres_is_what_its_modes_ask_for(long_course: Course) -> None:
    for row in range(2):
        starts = np.cumsum([0.0, *(call.segment().length for call in long_course.modes[row])])
        x = np.arange(FAR - 0.5 * KEEP_BEHIND, FAR + REACH, 0.01)
        expected = np.full(len(x), NOTHING)
        for start, call in zip(starts[:-1], long_course.modes[row], strict=True):
            if start > FAR - 5.0:
                for plateau in call.segment().plateaus:
                    on = (x >= start + plateau.start + 1e-6) & (x < start + plateau.end - 1e-6)
                    expected[on] = np.maximum(expected[on], plateau.top)
        asked = expected > NOTHING  # not within a rounding of an edge
        found = height_at(long_course.terrain[[row]], np.stack([x, np.zeros(len(x))], axis=1)[None])[0]
        np.testing.assert_array_equal(found[asked], expected[asked])
        assert (found > NOTHING).all()  # no crack between two modes
        assert asked.mean() > 0.99


def test_the_mode_at_a_place_is_found_after_ten_kilometres(long_course: Course) -> None:
    starts = np.cumsum([0.0, *(call.segment().length for call in long_course.modes[0])])
    for x in np.linspace(FAR - 2.0, FAR + 1.0, 50):
        assert long_course.mode_at(0, float(x)) is long_course.modes[0][np.searchsorted(starts, x, side="right") - 1]


def test_a_wide_gap_keeps_its_apex_wherever_it_is() -> None:
    """What is left of a flight is known as long as it lasts, also where its start is left behind."""
    gap = {"w": 3.0, "d": 0.5, "v": 2.0, "run_up": 1.0}
    task = load_task("parkour", {"curriculum": None, "modes": {"leap": gap, "jump": None, "pace": None}})
    course, rng = Course(task, 1), np.random.default_rng(0)
    course.begin(0, rng, 1.0)
    flight = next(i for i in range(course._span_count[0]) if course.spans[0, i, APEX] > 0)
    start, end = course.spans[0, flight - 1, END], course.spans[0, flight, END]
    course.extend(0, end - 0.1, rng, 1.0)
    kept = next(i for i in range(course._span_count[0]) if course.spans[0, i, END] == end)
    assert end - 0.1 - KEEP_BEHIND > start
    assert kept > 0
    assert course.spans[0, kept - 1, END] == start


def test_memory_and_files_do_not_grow_with_steps_and_resets() -> None:
    path = ROOT / "benchmarks" / "long_haul.py"
    spec = importlib.util.spec_from_file_location("long_haul", path)
    assert spec is not None and spec.loader is not None
    long_haul = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(long_haul)
    found = long_haul.haul(4000, num_envs=16, points=20)
    assert found["episodes"] > 30
    assert found["growth"] < 0.02
    assert found["more_files"] == 0
