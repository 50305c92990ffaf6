"""BatchEnv over every shipped task: one row is the same as many, and the rules hold at every step."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.batches import OPEN, SEED, TASKS, actions, assert_same, at_full_level, ended, last, play
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.guidance.latent import load_encoder

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
    task = load_task(name, {"rho": None, "min_step_reward": None})
    task = replace(task, terminations={}, observations={"clock": {}}, randomisation=None)
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
    task = replace(load_task(name), observations={"proprioception": {}}, randomisation=None)
    env = BatchEnv(at_full_level(task), 3, SEED, threads=1)
    env.reset()
    observation = env.reset(np.array([0, 2]))
    view = env.view()
    height = (view.base_pos_w[:, 2] - view.ground_height)[[0, 2]]
    np.testing.assert_allclose(observation[:, 0], height, atol=1e-6)
    assert observation.shape == (2, env.observation_size)


@pytest.mark.parametrize("name", TASKS)
def test_actions_beyond_one_are_those_of_one(name: str) -> None:
    results = []
    for scale in (1.0, 7.0):
        env = BatchEnv(load_task(name), 1, SEED, threads=1)
        env.reset()
        results.append(env.step(scale * np.array([[1, -1] * 5])).observation)
    np.testing.assert_array_equal(*results)


@pytest.mark.parametrize("servo", ['kp="0.3" kv="0.005" gear="10"', 'kp="7.5" kv="0.125" gear="-2"'])
def test_gears_of_servos_change_nothing(servo: str, tmp_path: Path) -> None:
    """Neither control, reward nor gains that vary; the limits of the actuators are the joints' over the gear."""
    task = load_task("dive", {"randomisation": {"gains": {"scale": [0.8, 1.2]}}, "rho": None})
    robot, gear = task.robot_config, abs(float(servo.split('"')[-2]))
    mjcf = robot.mjcf_path.read_text(encoding="utf-8")
    for found, written in (
        (
            '<position kp="30" kv="0.5" forcerange="-30 30"/>',
            f'<position {servo} forcerange="{-30 / gear} {30 / gear}"/>',
        ),
        ('<position forcerange="-50 50"/>', f'<position forcerange="{-50 / gear} {50 / gear}"/>'),
    ):
        assert found in mjcf
        mjcf = mjcf.replace(found, written)
    (tmp_path / "geared.xml").write_text(mjcf, encoding="utf-8")
    results = []
    for each in (robot, replace(robot, mjcf=str(tmp_path / "geared.xml"))):
        env = BatchEnv(replace(task, robot_config=each), 2, SEED, threads=1)
        env.reset()
        rng = np.random.default_rng(0)
        steps = [env.step(rng.uniform(-0.2, 0.2, (2, 10))) for _ in range(8)]
        results.append((steps[-1].view.joint_pos, steps[-1].reward_terms["torque_regulation"], steps[-1].view.torque))
    assert np.ptp(results[0][0]) > 0.1
    for plain, geared in zip(*results, strict=True):
        np.testing.assert_allclose(geared, plain, rtol=0, atol=1e-6)


def test_an_action_is_an_offset_of_the_nominal_pose_in_rad() -> None:
    task = load_task("parkour", {"action": {"scale": 0.5}})
    env = BatchEnv(task, 1, SEED, threads=1)
    env.reset()
    command = np.linspace(-1, 1, 10)[None]
    view = env.step(command).view
    np.testing.assert_allclose(env.sim.ctrl[0, env.sim.servos.ctrl], 0.5 * command[0])
    expected = 30.0 * (0.5 * command - view.joint_pos) - 0.5 * view.joint_vel
    np.testing.assert_allclose(view.torque, expected)


def test_a_number_of_environments_below_one_is_an_error() -> None:
    with pytest.raises(ValueError, match="'num_envs' must be at least 1 and at most 100,000, found 0"):
        BatchEnv(load_task("parkour"), 0)


# ---- some rows only ----


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
            np.testing.assert_allclose(after, encoder(env.guide.plans.reference[:, :8], np.full(3, 7)))
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
    with pytest.raises(ValueError, match=r"'jump.h' must be at least 0, found -1"):
        env.command(0, "jump", h=-1.0)
    with pytest.raises(TypeError, match=r"'jump.h' must be a number or \[low, high\], found high"):
        env.command(0, "jump", h="high")
    with pytest.raises(KeyError, match=r"'flip.r' has 'fron'.*Did you mean 'front'"):
        BatchEnv(load_task("dive"), 1).command(0, "flip", r="fron")
    assert not env.guide.course.commands[0]


@pytest.mark.parametrize("shape", [(2, 1), (10,), (1, 10), (2, 11)])
def test_actions_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"actions must be of shape \(2, 10\), found"):
        BatchEnv(load_task("parkour"), 2).step(np.zeros(shape))


def test_the_plan_is_what_rewards_compare_with() -> None:
    env = BatchEnv(load_task("parkour", OPEN), num_envs=2, seed=0)
    env.reset()
    plan = env.plan(1)
    assert len(plan) == 31
    for knot in range(1, 30):
        view = env.step(np.zeros((2, 10))).view
        np.testing.assert_array_equal(view.reference[1], plan[knot])
        np.testing.assert_array_equal(env.plan(1), plan)
