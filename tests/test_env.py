"""BatchEnv over every shipped task: one row is the same as many, and the rules hold at every step."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ogmp_sb3.config import TASKS_DIR, load_task
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.env import BatchEnv, StepResult
from ogmp_sb3.latent import load_encoder
from ogmp_sb3.sampling import mode_ranges
from ogmp_sb3.srb import STATE_NAMES
from ogmp_sb3.terrain import BOX_DEPTH, NOTHING, X0, X1, Y0, Y1, height_at

TASKS = sorted(path.stem for path in TASKS_DIR.glob("*.yaml"))
ON_TRACK = [name for name in TASKS if load_task(name).horizon is not None]
SEED = 5
OPEN = {"rho": None, "min_step_reward": None, "terminations": {"fall": None}, "episode_steps": 100_000}
"""Overrides under which an episode on a track never ends."""


def at_full_level(task: TaskConfig) -> TaskConfig:
    """Without curriculum, so that the first episode meets every mode."""
    return replace(task, curriculum=None)


def actions(steps: int, num_envs: int, scale: float = 0.3, seed: int = 0) -> np.ndarray:
    """Random actions, shape (steps, num_envs, 10)."""
    return scale * np.random.default_rng(seed).uniform(-1, 1, (steps, num_envs, 10))


def ended(result: StepResult) -> np.ndarray:
    return np.flatnonzero(result.terminated | result.truncated)


def play(env: BatchEnv, commands: np.ndarray) -> list[dict[str, np.ndarray]]:
    """Reset, then step with episodes beginning anew; everything an adapter can see of each step."""
    seen = [{"observation": env.reset()}]
    for command in commands:
        result = env.step(command)
        step = {
            "observation": result.observation,
            "reward": result.reward,
            "terminated": result.terminated,
            "truncated": result.truncated,
            "termination": result.termination,
            "deviation": result.view.deviation,
            "reference": result.view.reference,
            "state": result.view.state,
            **result.reward_terms,
        }
        rows = ended(result)
        first = np.full_like(result.observation, np.nan)
        if len(rows):
            first[rows] = env.reset(rows)
        seen.append({**{name: value.copy() for name, value in step.items()}, "first": first})
    return seen


def assert_same(one: list[dict[str, np.ndarray]], other: list[dict[str, np.ndarray]], rows: Any = slice(None)) -> None:
    """Bit for bit; of ``other`` only some rows."""
    for step, (a, b) in enumerate(zip(one, other, strict=True)):
        for name in a:
            np.testing.assert_array_equal(a[name], b[name][rows], err_msg=f"{name} at step {step}")


def base_x(env: BatchEnv) -> np.ndarray:
    """Live view of where the bases are along the track."""
    return env.sim.qpos[:, env.sim.base_qpos]


def put_upright(env: BatchEnv, x: np.ndarray) -> None:
    """Robots at rest in the nominal pose over the ground at ``x`` (or over zero above a gap)."""
    p = env.sim.base_qpos
    ground = height_at(env.terrain, np.stack([x, np.zeros_like(x)], axis=1)[:, None])[:, 0]
    env.sim.qpos[:] = 0.0
    env.sim.qpos[:, p] = x
    env.sim.qpos[:, p + 2] = 0.5 + np.maximum(ground, 0.0)
    env.sim.qpos[:, p + 3] = 1.0
    env.sim.qvel[:] = 0.0


# ---- every task ----


@pytest.mark.parametrize("name", TASKS)
def test_shapes_types_and_ranges_hold_for_200_random_steps(name: str) -> None:
    env = BatchEnv(at_full_level(load_task(name)), num_envs=2, seed=SEED, threads=1)
    observation = env.reset()
    assert observation.shape == (2, env.observation_size)
    assert env.action_size == 10
    bound = (50.0 * env.observation_scale).astype(np.float32)
    episodes = 0
    for command in actions(200, 2, scale=1.0):
        result = env.step(command)
        for array in (observation, result.observation):
            assert array.dtype == np.float32
            assert np.isfinite(array).all()
            assert (np.abs(array) <= bound).all()
        assert result.reward.shape == (2,)
        assert np.isfinite(result.reward).all()
        assert (result.reward <= 1.0 + 1e-9).all()
        assert (result.reward >= -0.3).all()
        assert not (result.terminated & result.truncated).any()
        assert set(result.reward_terms) == set(env.task.rewards)
        np.testing.assert_allclose(sum(result.reward_terms.values()), result.reward, atol=1e-12)
        np.testing.assert_array_equal(result.termination != "", result.terminated | result.truncated)
        np.testing.assert_array_equal(result.termination == "time_limit", result.truncated)
        rows = ended(result)
        episodes += len(rows)
        if len(rows):
            observation = env.reset(rows)
            assert observation.shape == (len(rows), env.observation_size)
    assert episodes > 4


@pytest.mark.parametrize("name", TASKS)
def test_the_same_seed_gives_the_same_rollout_and_another_seed_another(name: str) -> None:
    task, commands = at_full_level(load_task(name)), actions(80, 2)
    one, again, other = (play(BatchEnv(task, 2, seed, threads=1), commands) for seed in (SEED, SEED, SEED + 100))
    assert_same(one, again)
    assert any(not np.array_equal(a["reference"], b["reference"]) for a, b in zip(one[1:], other[1:], strict=True))


@pytest.mark.parametrize("name", TASKS)
def test_four_rows_equal_four_environments_of_one_over_resets_too(name: str) -> None:
    task, commands = at_full_level(load_task(name)), actions(100, 4)
    four = play(BatchEnv(task, 4, SEED, threads=1), commands)
    assert sum(step["terminated"].sum() for step in four[1:]) > 4
    for row in range(4):
        one = play(BatchEnv(task, 1, SEED + row, threads=1), commands[:, [row]])
        assert_same(one, four, [row])


@pytest.mark.parametrize("name", TASKS)
def test_rows_do_not_depend_on_the_number_of_threads(name: str) -> None:
    task, commands = at_full_level(load_task(name)), actions(60, 5)
    one, two = (play(BatchEnv(task, 5, SEED, threads), commands) for threads in (1, 2))
    assert_same(one, two)


@pytest.mark.parametrize("name", TASKS)
def test_an_environment_of_its_own_seed_equals_a_row_that_is_seeded_later(name: str) -> None:
    task, commands = at_full_level(load_task(name)), actions(40, 1)
    fresh, used = BatchEnv(task, 1, SEED, threads=1), BatchEnv(task, 1, 99, threads=1)
    fresh.seed(SEED)
    play(used, commands)
    used.seed_row(0, SEED)
    assert_same(play(fresh, commands), play(used, commands))


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("rho", [0.05, 0.1])
def test_an_episode_ends_by_the_bound_if_and_only_if_the_deviation_exceeds_rho(name: str, rho: float) -> None:
    task = at_full_level(load_task(name, {"rho": rho}))
    env = BatchEnv(task, 6, SEED, threads=1)
    env.reset()
    causes = set()
    for command in actions(40, 6):
        result = env.step(command)
        weighted = (result.view.state - result.view.reference) * np.array(task.bound_weights)
        np.testing.assert_allclose(result.view.deviation, np.linalg.norm(weighted, axis=1), atol=1e-12)
        np.testing.assert_array_equal(result.termination == "bound", result.view.deviation > rho)
        assert result.terminated[result.termination == "bound"].all()
        causes |= set(result.termination.tolist())
        if len(ended(result)):
            env.reset(ended(result))
    assert "bound" in causes
    assert len(causes) > 1  # both sides were seen


@pytest.mark.parametrize("name", TASKS)
def test_every_other_cause_is_what_the_step_shows(name: str) -> None:
    task = at_full_level(load_task(name, {"rho": None, "episode_steps": 40, "min_step_reward": 0.5}))
    task = replace(task, terminations={"fall": {"min_height": 0.4}})
    env = BatchEnv(task, 4, SEED, threads=1)
    env.reset()
    causes = set()
    for command in actions(90, 4, scale=0.1):
        count = env.step_count + 1
        result = env.step(command)
        view = result.view
        low = view.base_pos_w[:, 2] - np.maximum(view.ground_height, 0.0) < 0.4
        poor = result.reward < 0.5
        expected = np.select([low, poor, count >= 40], ["fall", "low_reward", "time_limit"], "")
        np.testing.assert_array_equal(result.termination, expected)
        causes |= set(expected.tolist())
        if len(ended(result)):
            env.reset(ended(result))
    assert {"", "fall"} <= causes


@pytest.mark.parametrize("name", TASKS)
def test_the_time_limit_is_a_truncation_at_exactly_the_step_asked_for(name: str) -> None:
    env = BatchEnv(replace(load_task(name, {**OPEN, "episode_steps": 7}), terminations={}), 2, SEED, threads=1)
    for _ in range(2):
        env.reset()
        for step in range(1, 8):
            result = env.step(np.zeros((2, 10)))
            np.testing.assert_array_equal(result.truncated, step == 7)
            assert not result.terminated.any()
        np.testing.assert_array_equal(result.termination, "time_limit")


@pytest.mark.parametrize("name", TASKS)
def test_an_unguided_episode_never_ends_by_the_bound(name: str) -> None:
    env = BatchEnv(load_task(name, {"rho": None, "min_step_reward": None}), 4, SEED, threads=1)
    env.reset()
    furthest = 0.0
    for command in actions(100, 4, scale=1.0):
        result = env.step(command)
        furthest = max(furthest, result.view.deviation.max())
        assert not (result.termination == "bound").any()
        assert not (result.termination == "low_reward").any()
    assert furthest > 0.3


@pytest.mark.parametrize("name", TASKS)
def test_a_start_stands_on_the_ground_on_its_reference(name: str) -> None:
    env = BatchEnv(load_task(name), 4, SEED, threads=1)
    env.reset()
    view = env.view()
    np.testing.assert_allclose(view.base_pos_w[:, 2] - view.ground_height, 0.5, atol=1e-12)
    np.testing.assert_array_equal(view.deviation, 0.0)
    np.testing.assert_array_equal(view.base_quat, [[1.0, 0.0, 0.0, 0.0]] * 4)
    np.testing.assert_array_equal(view.torque, 0.0)
    assert not view.body_contact.any()


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("oracle", ["linear", "lqr", "preview"])
def test_knot_0_is_the_state_fed_back_and_the_oracle_is_asked_exactly_when_due(name: str, oracle: str) -> None:
    overrides: dict[str, Any] = {"rho": None, "min_step_reward": None}
    if oracle == "lqr":  # not every file lists it
        params = load_task(name).oracle_params
        overrides["oracle_params"] = {"lqr": params.get("lqr", params["preview"])}
    task = replace(load_task(name, {**overrides, "oracle": oracle}), terminations={})
    env = BatchEnv(at_full_level(task), 2, SEED, threads=1)
    env.reset()
    fed_back = np.array([state in task.feedback for state in STATE_NAMES])
    queries, since = 0, np.zeros(2, dtype=int)
    periods = env.view().period
    for command in actions(95, 2, scale=0.1):
        view = env.step(command).view
        since += 1
        np.testing.assert_array_equal(view.phase, since)  # the step is judged before the next query
        now = env.view()
        for row in range(2):
            if since[row] == periods[row]:
                expected = np.where(fed_back, now.state[row], 0.0)
                np.testing.assert_allclose(now.reference[row], expected, atol=1e-9)
                assert now.phase[row] == 0
                since[row], periods[row], queries = 0, now.period[row], queries + 1
            else:
                assert now.phase[row] == since[row]
            if task.horizon is not None:
                assert now.period[row] == task.horizon
    assert queries >= 4


@pytest.mark.parametrize("name", TASKS)
def test_the_clock_seen_by_the_policy_starts_anew_with_every_query(name: str) -> None:
    task = replace(load_task(name, {"rho": None, "min_step_reward": None}), terminations={}, observations={"clock": {}})
    env = BatchEnv(task, 1, SEED, threads=1)
    observation = env.reset()
    for _ in range(70):
        view = env.view()
        angle = 2 * np.pi * view.phase / view.period
        np.testing.assert_allclose(observation, np.stack([np.sin(angle), np.cos(angle)], axis=1), atol=1e-6)
        observation = env.step(np.zeros((1, 10))).observation


@pytest.mark.parametrize("name", TASKS)
def test_resetting_some_rows_leaves_the_others_bitwise_untouched(name: str) -> None:
    task, commands = at_full_level(load_task(name, {"rho": None, "min_step_reward": None})), actions(80, 4, 0.05)
    env, control = (BatchEnv(task, 4, SEED, threads=1) for _ in range(2))
    env.reset(), control.reset()
    kept = np.array([1, 3])
    for step, command in enumerate(commands):
        if step == 35:
            before = env.sim.qpos[kept].copy(), env.terrain[kept].copy()
            env.reset(np.array([0, 2]))
            np.testing.assert_array_equal(env.sim.qpos[kept], before[0])
            np.testing.assert_array_equal(env.terrain[kept], before[1])
            assert (env.step_count == [0, 35, 0, 35]).all()
        result, expected = env.step(command), control.step(command)
        np.testing.assert_array_equal(result.observation[kept], expected.observation[kept])
        np.testing.assert_array_equal(result.reward[kept], expected.reward[kept])
        np.testing.assert_array_equal(result.view.reference[kept], expected.view.reference[kept])
        np.testing.assert_array_equal(result.view.deviation[kept], expected.view.deviation[kept])
    assert not np.array_equal(result.view.state[0], expected.view.state[0])


@pytest.mark.parametrize("name", TASKS)
def test_reset_gives_the_observations_of_the_rows_asked_for(name: str) -> None:
    env = BatchEnv(at_full_level(load_task(name)), 3, SEED, threads=1)
    env.reset()
    observation = env.reset(np.array([0, 2]))
    view = env.view()
    height = (view.base_pos_w[:, 2] - view.ground_height)[[0, 2]]
    np.testing.assert_allclose(observation[:, 0], height, atol=1e-6)
    assert observation.shape == (2, env.observation_size)


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("field, value", [("qvel", np.nan), ("qpos", np.nan), ("qvel", 1e12)])
def test_a_row_that_explodes_ends_as_unstable_and_no_other_row_changes(name: str, field: str, value: float) -> None:
    task, commands = at_full_level(load_task(name)), actions(12, 3, 0.02)
    env, control = (BatchEnv(task, 3, SEED, threads=1) for _ in range(2))
    env.reset(), control.reset()
    for step, command in enumerate(commands):
        if step == 4:
            getattr(env.sim, field)[1, 2] = value
        result, expected = env.step(command), control.step(command)
        assert np.isfinite(result.observation).all()
        assert np.isfinite(result.reward).all()
        for name_ in ("observation", "reward", "termination"):
            np.testing.assert_array_equal(getattr(result, name_)[[0, 2]], getattr(expected, name_)[[0, 2]])
        if step == 4:
            assert result.termination[1] == "unstable"
            assert result.terminated[1]
            assert np.isfinite(env.reset(np.array([1]))).all()
        else:
            assert result.termination[1] != "unstable"


@pytest.mark.parametrize("name", TASKS)
def test_an_action_that_is_not_a_number_ends_its_own_row(name: str) -> None:
    env = BatchEnv(load_task(name), 2, SEED, threads=1)
    env.reset()
    command = np.zeros((2, 10))
    command[1, 3] = np.nan
    result = env.step(command)
    np.testing.assert_array_equal(result.termination, ["", "unstable"])
    assert np.isfinite(result.reward).all()


@pytest.mark.parametrize("name", TASKS)
def test_actions_beyond_one_are_those_of_one(name: str) -> None:
    results = []
    for scale in (1.0, 7.0):
        env = BatchEnv(load_task(name), 1, SEED, threads=1)
        env.reset()
        results.append(env.step(scale * np.array([[1, -1] * 5])).observation)
    np.testing.assert_array_equal(*results)


def test_an_action_is_an_offset_of_the_nominal_pose_in_rad() -> None:
    task = load_task("parkour", {"action": {"scale": 0.5}})
    env = BatchEnv(task, 1, SEED, threads=1)
    env.reset()
    command = np.linspace(-1, 1, 10)[None]
    view = env.step(command).view
    np.testing.assert_allclose(env.sim.ctrl[0, env.sim.actuators], 0.5 * command[0])
    expected = 30.0 * (0.5 * command - view.joint_pos) - 0.5 * view.joint_vel
    np.testing.assert_allclose(view.torque, expected)


def test_a_number_of_environments_below_one_is_an_error() -> None:
    with pytest.raises(ValueError, match="'num_envs' must be at least 1 and at most 100,000, found 0"):
        BatchEnv(load_task("parkour"), 0)


# ---- the endless track ----


def check_track(env: BatchEnv) -> None:
    """Ground ahead and behind, no hole or overlap, within the pool, and MuJoCo has the same boxes."""
    for row, x in enumerate(base_x(env)):
        used = env.terrain[row][env.terrain[row, :, 4] > NOTHING]
        assert len(used) <= env.task.track.boxes
        assert used[0, X0] <= max(x - 0.8, -2.0)
        assert used[-1, X1] >= x + 1.2
        np.testing.assert_allclose(used[1:, X0], used[:-1, X1], atol=1e-9)
        assert (used[:, X1] > used[:, X0]).all()
        half_width = 0.5 * env.task.track.width
        np.testing.assert_array_equal(used[:, [Y0, Y1]], [[-half_width, half_width]] * len(used))
        model = env.sim.batch.get_model(row)
        for box, (x0, x1, y0, y1, top) in enumerate(env.terrain[row]):
            geom = model.geom(f"terrain_{box}")
            if top > NOTHING:
                np.testing.assert_allclose(geom.pos - geom.size, [x0, y0, top - BOX_DEPTH], atol=1e-9)
                np.testing.assert_allclose(geom.pos + geom.size, [x1, y1, top], atol=1e-9)
                assert geom.rbound[0] >= np.linalg.norm(geom.size) - 1e-9
            else:
                assert geom.pos[2] + geom.size[2] < -10.0


def inside(ranges: dict[str, Any], parameters: dict[str, Any]) -> bool:
    return all(ranges[key].low <= value <= ranges[key].high for key, value in parameters.items())


@pytest.mark.parametrize("name", ON_TRACK)
def test_the_track_goes_on_for_hundreds_of_metres_and_ten_kilometres_away(name: str) -> None:
    env = BatchEnv(at_full_level(load_task(name, OPEN)), 2, SEED, threads=1)
    env.reset()
    check_track(env)
    heights: set[float] = set()
    for step in range(700):
        put_upright(env, base_x(env) + np.array([0.3, 0.28]))
        result = env.step(np.zeros((2, 10)))
        assert (result.termination == "").all()
        assert (result.view.ground_height > -10.0).all()
        heights |= set(result.view.ground_height.round(6).tolist())
        if step % 25 == 0:
            check_track(env)
    assert base_x(env).min() > 190.0
    assert len(heights) > 50  # not one flat box
    put_upright(env, np.array([1.0e4, 250.0]))
    env.step(np.zeros((2, 10)))
    check_track(env)
    put_upright(env, base_x(env) + 0.01)
    view = env.step(np.zeros((2, 10))).view
    check_track(env)
    assert np.isfinite(view.reference).all()
    assert view.ground_height[0] > -10.0
    assert abs(view.base_pos_w[0, 0] - 1.0e4) < 0.1


@pytest.mark.parametrize("name", ON_TRACK)
def test_the_reference_far_away_is_that_of_home(name: str) -> None:
    """On flat ground, 12 km away; 12 060 m and 60 m both hold a whole number of hops, so hops are equally long."""
    flat = {
        "modes.pace.v": 0.8,
        "modes.pace.length": 1.2e4 + 60.0,
        "sampling": {"order": "sequence", "sequence": ["pace"], "repeat": "all"},
    }
    task = at_full_level(load_task(name, {**OPEN, **flat, "sampling.weights": {}}))
    env = BatchEnv(task, 2, SEED, threads=1)
    env.reset()
    offset = np.where(np.array(STATE_NAMES) == "x", 1.2e4, 0.0)
    no_physics = np.array([], dtype=int)
    for _ in range(2 * task.horizon):  # up to the first query from there, and over its whole horizon
        put_upright(env, np.array([0.0, 1.2e4]))
        view = env.step(np.zeros((2, 10)), no_physics).view
    np.testing.assert_array_equal(view.phase, task.horizon)
    np.testing.assert_allclose(view.reference[1] - offset, view.reference[0], atol=1e-6)
    assert view.reference[0, STATE_NAMES.index("x")] > 0.4


@pytest.mark.parametrize("name", ON_TRACK)
def test_modes_and_parameters_stay_in_their_ranges_and_fill_them(name: str) -> None:
    task = at_full_level(load_task(name, OPEN))
    env = BatchEnv(task, 1, SEED, threads=1)
    env.reset()
    put_upright(env, np.array([400.0]))
    env.step(np.zeros((1, 10)))
    drawn: dict[tuple[str, str], list[float]] = {}
    for call in env.modes[0]:
        assert inside(task.mode_ranges[call.name], call.parameters)
        assert set(call.parameters) == set(task.mode_ranges[call.name])
        for key, value in call.parameters.items():
            drawn.setdefault((call.name, key), []).append(float(value))
    assert {mode for mode, _ in drawn} == set(task.mode_ranges)
    for (mode, key), values in drawn.items():
        range_ = task.mode_ranges[mode][key]
        assert max(values) - min(values) >= 0.9 * (range_.high - range_.low)


def test_a_dive_draws_its_direction_and_height_and_then_settles() -> None:
    task = load_task("dive", {"rho": None, "min_step_reward": None})
    env = BatchEnv(task, 24, SEED, threads=1)
    env.reset()
    ranges = task.mode_ranges["flip"]
    starts = env.view().base_pos_w[:, 2]
    for start, (flip, *others) in zip(starts, env.modes, strict=True):
        assert flip.name == "flip"
        assert not others
        assert ranges["h"].low <= float(flip.parameters["h"]) <= ranges["h"].high
        assert start == pytest.approx(float(flip.parameters["h"]) + 0.5)
    assert {modes[0].parameters["r"] for modes in env.modes} == set(ranges["r"].words)
    for _ in range(90):
        env.step(np.zeros((24, 10)), np.array([], dtype=int))
    for modes in env.modes:
        assert len(modes) >= 2
        assert {call.name for call in modes[1:]} == {"settle"}


@pytest.mark.parametrize("name", ON_TRACK)
def test_behind_the_end_of_a_finite_track_the_ground_is_flat_for_ever(name: str) -> None:
    task = at_full_level(load_task(name, {**OPEN, "track.length": 5.0}))
    env = BatchEnv(task, 1, SEED, threads=1)
    env.reset()
    longest = max(call.segment().length for call in env.modes[0]) + 1.0
    seen = []
    for _ in range(200):
        put_upright(env, base_x(env) + 0.1)
        view = env.step(np.zeros((1, 10))).view
        seen.append((base_x(env)[0], view.ground_height[0]))
    x, height = np.array(seen).T
    assert (height[x > 5.0 + longest] == 0.0).all()
    assert (height[x < 5.0] != 0.0).any()
    assert x.max() > 15.0


@pytest.mark.parametrize("name", ON_TRACK)
def test_a_long_height_scan_never_sees_the_end_of_the_laid_track(name: str) -> None:
    """However far the scan looks, the track is laid at least as far."""
    scan = {"points": 61, "spacing": 0.04}  # 2.4 m
    task = replace(at_full_level(load_task(name, OPEN)), observations={"height_scan": scan})
    env = BatchEnv(task, 1, SEED, threads=1)
    env.reset()
    for _ in range(40):
        put_upright(env, base_x(env) + 0.05)
        heights = env.step(np.zeros((1, 10))).observation
        assert heights.min() > -1.0  # of the pit where there is no ground


def test_a_pool_too_small_for_the_track_is_an_error_that_names_the_key() -> None:
    env = BatchEnv(at_full_level(load_task("parkour", {**OPEN, "track.boxes": 16})), 1, SEED, threads=1)
    env.reset()
    with pytest.raises(ValueError, match=r"parkour\.yaml: 'track\.boxes' is 3, too few"):
        small = BatchEnv(at_full_level(load_task("parkour", {**OPEN, "track.boxes": 3})), 1, SEED, threads=1)
        for _ in range(50):
            put_upright(small, base_x(small) + 0.3)
            small.step(np.zeros((1, 10)))


# ---- the curriculum ----


def with_levels(num_envs: int, **overrides: Any) -> BatchEnv:
    """Episodes on a track that last ten steps unless a test ends them; lasting more than 8 raises, under 3 lowers."""
    curriculum = {"step": 0.25, "raise_above": 0.8, "lower_below": 0.3}
    task = load_task("parkour", {**OPEN, "episode_steps": 10, "curriculum": curriculum, **overrides})
    return BatchEnv(task, num_envs, SEED, threads=1)


def last(env: BatchEnv, steps: int) -> None:
    """Go on for some steps, after which all episodes end, as if a rule had ended them."""
    for _ in range(steps):
        env.step(np.zeros((env.num_envs, 10)))
    env._ended[:] = True


def test_a_level_starts_at_zero_and_rises_by_a_step_after_an_episode_that_lasted() -> None:
    env = with_levels(2)
    env.reset()
    np.testing.assert_array_equal(env.level, 0.0)
    for expected in (0.25, 0.5, 0.75, 1.0, 1.0):
        last(env, 9)
        env.reset()
        np.testing.assert_array_equal(env.level, expected)


@pytest.mark.parametrize("steps, change", [(1, -0.25), (2, -0.25), (3, 0.0), (8, 0.0), (9, 0.25), (10, 0.25)])
def test_a_level_moves_with_the_share_of_the_time_limit_survived(steps: int, change: float) -> None:
    env = with_levels(1)
    env.reset()
    env.level[:] = 0.5
    last(env, steps)
    env.reset()
    assert env.level[0] == 0.5 + change


def test_a_level_stays_above_zero_and_only_rows_that_ended_change() -> None:
    env = with_levels(3)
    env.reset()
    env.level[:] = [0.1, 0.5, 0.9]
    last(env, 1)
    env.reset(np.array([0]))
    np.testing.assert_array_equal(env.level, [0.0, 0.5, 0.9])
    last(env, 8)
    env.reset(np.array([2]))
    np.testing.assert_array_equal(env.level, [0.0, 0.5, 1.0])


@pytest.mark.parametrize("steps", [0, 1])
def test_an_episode_that_is_broken_off_is_no_failure(steps: int) -> None:
    env = with_levels(2)
    env.reset()
    env.level[:] = 0.5
    for _ in range(steps):
        assert not env.step(np.zeros((2, 10))).terminated.any()
    env.reset()
    np.testing.assert_array_equal(env.level, 0.5)


def test_an_episode_that_ends_by_its_time_limit_raises_the_level() -> None:
    env = with_levels(1)
    env.reset()
    while not env.step(np.zeros((1, 10))).truncated[0]:
        pass
    env.reset()
    assert env.level[0] == 0.25


@pytest.mark.parametrize("name", [name for name in TASKS if load_task(name).curriculum is not None])
@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_a_level_draws_from_the_ranges_between_the_easy_ones_and_the_task_s(name: str, level: float) -> None:
    task = load_task(name, OPEN)
    env = BatchEnv(task, 1, SEED, threads=1)
    env.level[:] = level
    env.reset()
    assert env.level[0] == level
    put_upright(env, np.array([100.0]))
    env.step(np.zeros((1, 10)))
    for call in env.modes[0]:
        easy = task.curriculum.modes.get(call.name, {})
        for key, value in call.parameters.items():
            full = task.mode_ranges[call.name][key]
            start = easy.get(key, full)
            assert start.low + level * (full.low - start.low) <= value <= start.high + level * (full.high - start.high)
        assert inside(mode_ranges(task, call.name, level), call.parameters)
    drawn = {call.name for call in env.modes[0]}
    weights = {mode: task.curriculum.weights.get(mode, 1.0) for mode in task.mode_ranges}
    assert drawn == {mode for mode in task.mode_ranges if level > 0 or weights[mode] > 0}


def test_without_a_curriculum_every_episode_is_the_whole_task() -> None:
    env = with_levels(2, curriculum=None)
    env.reset()
    last(env, 1)
    env.reset()
    np.testing.assert_array_equal(env.level, 1.0)


# ---- the test protocol ----


@pytest.mark.parametrize("name", TASKS)
def test_the_test_protocol_ends_only_by_a_fall_or_its_time_limit(name: str) -> None:
    task = load_task(name).for_evaluation()
    env = BatchEnv(task, 4, SEED, threads=1)
    env.reset()
    causes = set()
    for command in actions(120, 4, 0.1):
        result = env.step(command)
        causes |= set(result.termination.tolist())
        if len(ended(result)):
            env.reset(ended(result))
    assert causes <= {"", *task.terminations, "time_limit"}
    assert "fall" in causes
    np.testing.assert_array_equal(env.level, 1.0)


def test_only_the_rows_asked_for_are_stepped() -> None:
    env = BatchEnv(load_task("parkour"), 3, SEED, threads=1)
    env.reset()
    before = env.sim.qpos.copy()
    env.step(np.zeros((3, 10)), rows=np.array([1]))
    np.testing.assert_array_equal(env.sim.qpos[[0, 2]], before[[0, 2]])
    assert (env.sim.qpos[1] != before[1]).any()


# ---- saving and going on ----


@pytest.mark.parametrize("name", TASKS)
def test_a_saved_state_goes_on_bit_for_bit_in_another_environment(name: str) -> None:
    task, commands = load_task(name), actions(70, 3)
    env, other = BatchEnv(task, 3, SEED, threads=1), BatchEnv(task, 3, 77, threads=1)
    env.level[:] = 1.0 if task.curriculum is None else 0.6
    env.reset()
    other.reset()
    for step, command in enumerate(commands):
        if step == 33:
            other.set_state(*env.state())
        result = env.step(command)
        rows = ended(result)
        first = env.reset(rows) if len(rows) else None
        if step >= 33:
            again = other.step(command)
            for field in ("observation", "reward", "terminated", "truncated", "termination"):
                np.testing.assert_array_equal(getattr(again, field), getattr(result, field))
            if first is not None:
                np.testing.assert_array_equal(other.reset(rows), first)


def test_a_saved_state_is_a_copy() -> None:
    env = BatchEnv(load_task("parkour"), 2, SEED, threads=1)
    env.reset()
    arrays, plain = env.state()
    copies, modes = {name: array.copy() for name, array in arrays.items()}, [len(calls) for calls in plain["modes"]]
    last(env, 40)
    env.reset()
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, copies[name])
    assert [len(calls) for calls in plain["modes"]] == modes


def test_a_saved_state_of_another_size_is_an_error() -> None:
    two, three = (BatchEnv(load_task("parkour"), n, SEED, threads=1) for n in (2, 3))
    with pytest.raises(ValueError, match="does not fit this task and 3 environments"):
        three.set_state(*two.state())


# ---- the mode latent and commands ----


def test_the_latent_is_that_of_the_reference_and_changes_only_at_queries() -> None:
    task = load_task("parkour", {"horizon": 7, "min_step_reward": None, "rho": None, "terminations": {"fall": None}})
    env = BatchEnv(task, 3, SEED, threads=1)
    encoder = load_encoder("parkour")
    env.reset()
    for step in range(1, 22):
        before = env.view().latent.copy()
        env.step(np.zeros((3, 10)))
        after = env.view().latent
        if step % 7 == 0:
            np.testing.assert_allclose(after, encoder(env.plans.reference[:, :8], np.full(3, 7)))
        else:
            np.testing.assert_array_equal(after, before)
    assert (env.view().latent != 0).any()


def test_the_latent_is_two_observations_that_one_line_switches_off() -> None:
    task = load_task("parkour")
    on, off = BatchEnv(task, 1), BatchEnv(load_task("parkour", {"observations.mode_latent": None}), 1)
    assert on.observation_size == off.observation_size + 2
    with pytest.raises(ValueError, match="'mode_latent' needs an 'encoder'"):
        BatchEnv(load_task("parkour", {"encoder": None}), 1)


def test_commanded_modes_come_next_in_their_order_and_only_in_their_row() -> None:
    env = BatchEnv(at_full_level(load_task("parkour", OPEN)), 2, SEED, threads=1)
    env.reset()
    laid = len(env.modes[0])
    env.command(0, "jump", h=0.111)
    env.command(0, "leap", w=0.222, d=0.4)
    for _ in range(80):
        env.sim.qpos[:, env.sim.base_qpos] += 0.05
        env.step(np.zeros((2, 10)))
    jump, leap = env.modes[0][laid : laid + 2]
    assert (jump.name, jump.parameters["h"]) == ("jump", 0.111)
    assert (leap.name, leap.parameters["w"], leap.parameters["d"]) == ("leap", 0.222, 0.4)
    assert 0.3 <= jump.parameters["w"] <= 0.5  # drawn
    assert all(call.parameters.get("h") != 0.111 for call in env.modes[1])
    with pytest.raises(KeyError, match=r"no mode 'jmp'.*Did you mean 'jump'"):
        env.command(0, "jmp")
    with pytest.raises(KeyError, match=r"no parameter 'runup'.*Did you mean 'run_up'"):
        env.command(0, "jump", runup=0.1)


def test_the_plan_is_what_rewards_compare_with() -> None:
    env = BatchEnv(load_task("parkour", OPEN), num_envs=2, seed=0)
    env.reset()
    plan = env.plan(1)
    assert len(plan) == 31
    for knot in range(1, 30):
        view = env.step(np.zeros((2, 10))).view
        np.testing.assert_array_equal(view.reference[1], plan[knot])
        np.testing.assert_array_equal(env.plan(1), plan)
