"""Domain randomisation: off it is not there, on it is what was declared, and every row has its own."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from helpers.batches import actions, assert_same, ended, play
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.disturbances import Disturbances

TASKS = sorted(path.stem for path in TASKS_DIR.glob("*.yaml") if not path.stem.endswith("_robot"))
SEED = 5
EVERYTHING = {
    "mass": {"scale": [0.8, 1.2]},
    "friction": {"coefficient": [0.4, 1.2]},
    "gains": {"scale": [0.8, 1.2]},
    "action_delay": {"delay": [0, 0.07]},
    "sensor_noise": {"scale": 0.1},
    "push": {"every": 0.3, "speed": [0.1, 0.5]},
}
NEUTRAL = {
    "mass": {"scale": 1.0},
    "friction": {"coefficient": 1.0},
    "gains": {"scale": [1.0, 1.0]},
    "action_delay": {"delay": 0},
    "sensor_noise": {"scale": 0.0},
    "push": {"every": 0.3, "speed": 0.0},
}


def task(name: str = "parkour", **randomisation: Any) -> TaskConfig:
    """Without curriculum, so that the first episode meets every mode."""
    return load_task(name, {"curriculum": None, "randomisation": randomisation or None})


def drawn(rows: int = 400, **randomisation: Any) -> Disturbances:
    """Disturbances that have begun."""
    env = BatchEnv(task(**randomisation), rows, SEED, threads=1)
    env.reset()
    return env.disturbances


# ---- what a task declares ----


def test_a_number_is_fixed_a_pair_a_range_and_what_is_left_out_or_null_is_off() -> None:
    found = task(mass={"scale": 1.1}, friction={"coefficient": [0.5, 1.2]}, gains=None).randomised
    assert found == {"mass": {"scale": Range(1.1, 1.1)}, "friction": {"coefficient": Range(0.5, 1.2)}}


@pytest.mark.parametrize("name", TASKS)
def test_it_is_off_by_default(name: str) -> None:
    assert load_task(name).randomisation is None


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("mass", {"scale": 0}, "'randomisation.mass.scale' must be from 0.05 to 20, found 0."),
        ("mass", 1.1, "'randomisation.mass' must be a mapping, found the number 1.1."),
        (
            "mass",
            {"scal": 1},
            "'randomisation.mass': randomisation 'mass' has no parameter 'scal' (allowed: ",
        ),
        (
            "friction",
            {"coefficient": [-0.1, 1]},
            "'randomisation.friction.coefficient' must be from 0.01 to 10, found -0.1.",
        ),
        ("gains", {"scale": "high"}, "'randomisation.gains.scale' must be a number or [low, high], found high."),
        ("gains", {"scale": [1.1, 0.9]}, "'randomisation.gains.scale' is a reversed range"),
        ("action_delay", {"delay": [0, 1]}, "'randomisation.action_delay.delay' must be from 0 to 0.5, found 1."),
        ("action_delay", {"delay": -1}, "'randomisation.action_delay.delay' must be from 0 to 0.5, found -1."),
        ("sensor_noise", {"scale": -0.1}, "'randomisation.sensor_noise.scale' must be from 0 to 10, found -0.1."),
        ("push", {"every": 1, "speed": -1}, "'randomisation.push.speed' must be from 0 to 100, found -1."),
        ("pushes", {"speed": 1}, "'randomisation': unknown randomisation 'pushes' (allowed: action_delay, "),
    ],
)
def test_a_mistake_is_one_sentence(key: str, value: Any, message: str) -> None:
    with pytest.raises((ValueError, KeyError, TypeError)) as caught:
        task(**{key: value})
    assert caught.value.args[0].startswith("tasks/parkour.yaml: ")
    assert message in caught.value.args[0]


def test_a_test_protocol_s_latency_in_control_steps_is_refused_too() -> None:
    with pytest.raises(
        ValueError, match=r"'evaluation\.randomisation\.action_delay\.delay' must be from 0 to 0.5, found 1"
    ):
        load_task("parkour", {"evaluation.randomisation.action_delay.delay": 1})


def test_the_test_protocol_has_disturbances_of_its_own() -> None:
    config = load_task("parkour", {"randomisation.mass.scale": 1.1})
    assert config.for_evaluation().randomisation is None
    config = load_task(
        "parkour", {"randomisation.mass.scale": 1.1, "evaluation.randomisation.friction.coefficient": 0.4}
    )
    assert config.for_evaluation().randomised == {"friction": {"coefficient": Range(0.4, 0.4)}}


# ---- off, and rows ----


@pytest.mark.parametrize("name", TASKS)
def test_disturbances_of_no_size_leave_every_bit_as_it_is_without(name: str) -> None:
    commands = actions(60, 3)
    without, neutral = (BatchEnv(task(name, **given), 3, SEED, threads=1) for given in ({}, NEUTRAL))
    assert_same(play(without, commands), play(neutral, commands))


def test_off_it_gives_no_simulation_a_model_of_its_own_and_saves_nothing() -> None:
    env = BatchEnv(task(), 2, SEED, threads=1)
    env.reset()
    model, base = env.sim.mj.get_model(0), env.sim.model
    for field in ("body_mass", "geom_friction", "actuator_gainprm", "actuator_biasprm", "dof_invweight0"):
        np.testing.assert_array_equal(getattr(model, field), getattr(base, field))
    arrays, plain = env.state()
    assert not [name for name in (*arrays, *plain) if name.startswith("disturbances")]


@pytest.mark.parametrize("name", TASKS)
def test_on_it_changes_the_trajectory_but_not_the_track(name: str) -> None:
    without, disturbed = (BatchEnv(task(name, **given), 3, SEED, threads=1) for given in ({}, EVERYTHING))
    first, second = without.reset(), disturbed.reset()
    np.testing.assert_array_equal(without.terrain, disturbed.terrain)
    assert (first != second).any()
    commands = actions(10, 3)
    for command in commands:
        without.step(command)
        disturbed.step(command)
    assert (np.abs(without.sim.qpos - disturbed.sim.qpos).max(axis=1) > 1e-3).all()


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_four_rows_equal_four_environments_of_one(name: str) -> None:
    commands = actions(60, 4)
    four = play(BatchEnv(task(name, **EVERYTHING), 4, SEED, threads=1), commands)
    for row in range(4):
        one = play(BatchEnv(task(name, **EVERYTHING), 1, SEED + row, threads=1), commands[:, row : row + 1])
        assert_same(one, four, rows=[row])


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_a_saved_state_goes_on_bit_for_bit_in_another_environment(name: str) -> None:
    config, commands = task(name, **EVERYTHING), actions(80, 3)
    env, other = BatchEnv(config, 3, SEED, threads=1), BatchEnv(config, 3, 77, threads=1)
    env.reset()
    other.reset()
    episodes = 0
    for step, command in enumerate(commands):
        if step == 33:
            other.set_state(*env.state())
        result = env.step(command)
        rows = ended(result)
        first = env.reset(rows) if len(rows) else None
        if step >= 33:
            again = other.step(command)
            np.testing.assert_array_equal(again.observation, result.observation)
            going_on = np.setdiff1d(np.arange(3), rows)
            np.testing.assert_array_equal(other.sim.qpos[going_on], env.sim.qpos[going_on])
            if first is not None:
                episodes += 1
                np.testing.assert_array_equal(other.reset(rows), first)
    assert episodes > 0


def test_a_state_saved_without_disturbances_does_not_fit_a_task_that_has_them() -> None:
    state = BatchEnv(task(), 2, SEED, threads=1).state()
    with pytest.raises(ValueError, match="does not fit this task"):
        BatchEnv(task(**EVERYTHING), 2, SEED, threads=1).set_state(*state)


# ---- what is drawn ----


def test_draws_fill_their_ranges_and_change_with_every_episode() -> None:
    disturbances = drawn(**EVERYTHING)
    first = disturbances.varied(np.arange(400))
    for name, (low, high) in (("geom_friction", (0.4, 1.2)), ("gains", (0.8, 1.2))):
        values = first[name].reshape(400, -1)[:, 0]
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high >= values.max() > high - 0.05 * (high - low)
    disturbances.begin(np.array([3, 5]), np.ones(400))
    second = disturbances.varied(np.arange(400))["body_mass"]
    assert (second[[3, 5], 1] != first["body_mass"][[3, 5], 1]).all()
    others = np.delete(np.arange(400), [3, 5])
    np.testing.assert_array_equal(second[others], first["body_mass"][others])


def test_what_is_not_declared_is_not_changed() -> None:
    varied = drawn(2, friction={"coefficient": 0.5}, action_delay={"delay": 0.01}).varied(np.arange(2))
    assert set(varied) == {"geom_friction", "gains", "force", "ground"}
    assert (varied["gains"] == 1.0).all() and not varied["force"].any() and not varied["ground"].any()


def test_the_robots_simulated_are_those_that_were_drawn() -> None:
    env = BatchEnv(task(mass={"scale": [0.5, 2.0]}, gains={"scale": [0.5, 2.0], "each": 0.1}), 3, SEED, threads=1)
    env.reset()
    wanted = env.disturbances.varied(np.arange(3))
    for row in range(3):
        model = env.sim.mj.get_model(row)
        np.testing.assert_array_equal(model.body_mass, wanted["body_mass"][row])
        np.testing.assert_allclose(model.body_subtreemass[0], wanted["body_mass"][row].sum())
        np.testing.assert_allclose(model.actuator_gainprm[:, 0], 30.0 * wanted["gains"][row])
        np.testing.assert_allclose(model.actuator_biasprm[:, 1], -30.0 * wanted["gains"][row])


# ---- latency and pushes, between control steps ----

SUBSTEPS, PHYSICS_DT = 15, 0.002


def by_hand(env: BatchEnv) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """MuJoCo's own simulation of an environment of one that was just reset."""
    model, data = env.sim.mj.get_model(0), env.sim.mj.get_data(0)
    assert (data.time, model.opt.timestep) == (0.0, PHYSICS_DT)
    return model, data


@pytest.mark.parametrize("seconds", [0.0, 0.002, 0.016, 0.028, 0.03, 0.044, 0.06, 0.5])
def test_an_action_reaches_the_servos_in_the_physics_step_at_its_latency(seconds: float) -> None:
    """A robot moves as in a loop of ``mj_step`` in which the control changes at exactly that step."""
    env = BatchEnv(task(action_delay={"delay": seconds}), 1, SEED, threads=1)
    env.reset()
    model, data = by_hand(env)
    commands, late = actions(20, 1), round(seconds / PHYSICS_DT)
    for k in range(20):
        view = env.step(commands[k]).view
        for step in range(SUBSTEPS * k, SUBSTEPS * (k + 1)):
            arrived = (step - late) // SUBSTEPS
            data.ctrl[:] = 2.0 * commands[arrived, 0] if arrived >= 0 else 0.0  # the nominal pose is all zeros
            mujoco.mj_step(model, data)
        np.testing.assert_array_equal(env.sim.qpos[0], data.qpos)
        np.testing.assert_array_equal(env.sim.qvel[0], data.qvel)
        torque = 30.0 * (data.ctrl - data.qpos[7:]) - 0.5 * data.qvel[6:]
        np.testing.assert_allclose(view.torque[0], torque, rtol=1e-9, atol=1e-9)


def test_a_latency_of_a_control_step_holds_every_action_back_by_one() -> None:
    late, prompt = (BatchEnv(task(**given), 2, SEED, threads=1) for given in ({"action_delay": {"delay": 0.03}}, {}))
    late.reset()
    prompt.reset()
    commands = actions(10, 2)
    for now, before in zip(commands, [np.zeros((2, 10)), *commands[:-1]], strict=True):
        late.step(now)
        prompt.step(before)
        np.testing.assert_array_equal(late.sim.mj.state, prompt.sim.mj.state)


def test_every_row_has_its_latency_drawn_in_seconds() -> None:
    disturbances = drawn(action_delay={"delay": [0.01, 0.07]})
    latencies = disturbances.arrays()["action_delay"]
    assert 0.01 <= latencies.min() < 0.012 and 0.068 < latencies.max() <= 0.07
    assert np.std(latencies) == pytest.approx(0.06 / np.sqrt(12), rel=0.1)
    for k in range(5):
        arrivals = disturbances.arrivals(np.full((400, 10), float(k)), None, None)
    np.testing.assert_array_equal(np.sort(arrivals.rows), np.arange(400))
    after = (4 - arrivals.values[:, 0]) * 0.03 + arrivals.at * PHYSICS_DT
    np.testing.assert_allclose(after, latencies[arrivals.rows], atol=PHYSICS_DT / 2 + 1e-9)


def test_rows_of_different_latency_stepped_alone_move_as_they_do_together() -> None:
    together, apart = (BatchEnv(task(**{**EVERYTHING, "sensor_noise": None}), 4, SEED, threads=1) for _ in range(2))
    together.reset()
    apart.reset()
    assert len(np.unique(together.disturbances.arrays()["action_delay"])) == 4
    rows = np.array([1, 3])
    for command in actions(6, 4):
        together.step(command)
        apart.step(command, rows)
        np.testing.assert_array_equal(apart.sim.qpos[rows], together.sim.qpos[rows])


def test_the_servos_keep_their_targets_until_the_first_action_arrives() -> None:
    env = BatchEnv(task(action_delay={"delay": 0.04}), 1, SEED, threads=1)
    env.reset()
    env.sim.ctrl[:] = 0.3
    for expected in (0.3, 1.0):
        env.step(np.full((1, 10), 0.5))
        np.testing.assert_array_equal(env.sim.ctrl, expected)


def test_an_action_that_is_not_a_number_arrives_too_and_is_noticed() -> None:
    env = BatchEnv(task(action_delay={"delay": 0.016}), 1, SEED, threads=1)
    env.reset()
    assert env.step(np.full((1, 10), np.nan)).termination.tolist() == ["unstable"]


def test_a_new_episode_forgets_what_was_under_way() -> None:
    env = BatchEnv(task(action_delay={"delay": 0.04}), 2, SEED, threads=1)
    env.reset()
    for _ in range(3):
        env.step(np.full((2, 10), 0.5))
    env.reset(np.array([1]))
    env.step(np.full((2, 10), 0.5))
    np.testing.assert_array_equal(env.sim.ctrl, np.repeat([[1.0], [0.0]], 10, axis=1))
    env.step(np.full((2, 10), 0.5))
    np.testing.assert_array_equal(env.sim.ctrl, 1.0)


@pytest.mark.parametrize("every", [0.004, 0.03, 0.1])
def test_a_kick_comes_in_the_physics_step_at_its_time(every: float) -> None:
    """A robot moves as in a loop of ``mj_step`` in which the velocity changes before exactly that step."""
    env = BatchEnv(task(action_delay={"delay": 0.01}, push={"every": every, "speed": 0.2}), 1, SEED, threads=1)
    env.reset()
    model, data = by_hand(env)
    first, apart = int(env.disturbances.arrays()["next_push"][0]), round(every / PHYSICS_DT)
    assert 0 <= first < apart
    commands, found = actions(10, 1), 0
    for k in range(10):
        env.step(commands[k])
        kicks = iter(env.sim.events[1].values)
        for step in range(SUBSTEPS * k, SUBSTEPS * (k + 1)):
            arrived = (step - 5) // SUBSTEPS
            data.ctrl[:] = 2.0 * commands[arrived, 0] if arrived >= 0 else 0.0
            if step >= first and (step - first) % apart == 0:
                kick = next(kicks)
                assert np.linalg.norm(kick) == pytest.approx(0.2)
                data.qvel[:2] += kick
                found += 1
            mujoco.mj_step(model, data)
        assert next(kicks, None) is None
        np.testing.assert_array_equal(env.sim.qpos[0], data.qpos)
    assert found == len(range(first, 10 * SUBSTEPS, apart)) > 0


def test_noise_has_the_size_asked_for_and_falls_on_the_proprioception_alone() -> None:
    clean, noisy = (BatchEnv(task(**given), 300, SEED, threads=1) for given in ({}, {"sensor_noise": {"scale": 0.2}}))
    difference = (noisy.reset() - clean.reset()) / clean.observation_scale
    np.testing.assert_array_equal(difference[:, 31:], 0.0)
    np.testing.assert_allclose(difference[:, :31].std(axis=0), 0.2, rtol=0.2)
    np.testing.assert_allclose(difference[:, :31].mean(axis=0), 0.0, atol=0.05)
    assert np.abs(np.corrcoef(difference[:, :31].T) - np.eye(31)).max() < 0.3


def test_pushes_come_at_their_time_first_at_a_random_one_in_all_directions() -> None:
    disturbances = drawn(push={"every": 0.301, "speed": [0.2, 0.4]})
    times = [[] for _ in range(400)]
    kicks = []
    for step in range(40):
        events = disturbances.kicks(None, None)
        for row, at in zip(events.rows, events.at, strict=True):
            times[row].append(SUBSTEPS * step + at)
        kicks.append(events.values)
    firsts = [first for first, *_ in times]
    assert (min(firsts), max(firsts)) == (pytest.approx(0, abs=3), pytest.approx(149, abs=3))
    counts, _ = np.histogram(np.array(firsts) % SUBSTEPS, bins=SUBSTEPS)
    assert counts.min() > 0.3 * counts.mean()  # at every physics step of a control step
    assert all((np.diff(steps) == 150).all() for steps in times)  # 0.301 s, rounded
    assert {len(steps) for steps in times} == {4}
    kick = np.concatenate(kicks)
    speed, angle = np.linalg.norm(kick, axis=1), np.arctan2(kick[:, 1], kick[:, 0])
    assert (speed.min(), speed.max()) == (pytest.approx(0.2, abs=0.01), pytest.approx(0.4, abs=0.01))
    counts, _ = np.histogram(angle, bins=8, range=(-np.pi, np.pi))
    assert counts.min() > 0.7 * counts.mean()


def test_pushes_keep_their_time_where_control_steps_are_longer_or_shorter() -> None:
    """One second of physics has as many kicks, as far apart, however it is cut into control steps."""
    disturbances = drawn(20, push={"every": 0.014, "speed": 0.2}, control_jitter={"jitter": 0.014})
    begun = np.zeros(20, dtype=int)
    times: list[list[int]] = [[] for _ in range(20)]
    for _ in range(40):
        lengths = disturbances.lengths(None)
        events = disturbances.kicks(None, lengths)
        assert (events.at < lengths[events.rows]).all()
        for row, at in zip(events.rows, events.at, strict=True):
            times[row].append(int(begun[row]) + int(at))
        begun += lengths
    assert len(set(begun)) > 1
    for row, at in enumerate(times):
        assert at == list(range(at[0], begun[row], 7))  # 14 ms of 2 ms steps


def test_only_rows_that_are_stepped_are_pushed() -> None:
    disturbances = drawn(4, push={"every": 0.03, "speed": 1.0})
    assert disturbances.kicks(np.array([1, 3]), None).rows.tolist() == [1, 3]


def test_a_push_moves_the_base_as_fast_as_it_says() -> None:
    still, pushed = (
        BatchEnv(task(**given), 2, SEED, threads=1) for given in ({}, {"push": {"every": 0.03, "speed": 0.5}})
    )
    velocities = []
    for env in (still, pushed):
        env.reset()
        env.sim.qpos[:, 2] += 1.0  # in the air, where nothing else acts
        env.step(np.zeros((2, 10)))
        velocities.append(env.sim.qvel[:, :3].copy())
    change = velocities[1] - velocities[0]
    np.testing.assert_allclose(np.linalg.norm(change[:, :2], axis=1), 0.5, rtol=1e-3)
    np.testing.assert_allclose(change[:, 2], 0.0, atol=1e-6)
