"""Randomisation terms: what each does to a robot, against MuJoCo's own simulation and the laws of mechanics."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from helpers.batches import actions, assert_same, ended, play
from ogmp_sb3.config import registry
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.episode_disturbance import Disturbance, Subject

SEED, SUBSTEPS, PHYSICS_DT = 5, 15, 0.002
EVERYTHING = {
    "mass": {"scale": [0.8, 1.2], "each": 0.1},
    "centre_of_mass": {"spread": 0.02},
    "payload": {"mass": [0, 1]},
    "friction": {"coefficient": [0.4, 1.2]},
    "motor_strength": {"scale": [0.85, 1.15]},
    "joint_friction": {"torque": [0, 0.3]},
    "joint_damping": {"coefficient": [0, 0.1]},
    "armature": {"scale": [0.9, 1.1]},
    "joint_offset": {"spread": 0.02},
    "action_delay": {"delay": [0, 0.04], "jitter": 0.01},
    "sensor_delay": {"delay": [0, 0.01], "jitter": 0.004},
    "control_jitter": {"jitter": 0.004},
    "imu": {"rate": 0.1, "tilt": 0.02, "rate_bias": 0.05},
    "scan": {"height": 0.01, "offset": 0.01, "dropout": 0.1, "delay": [0, 0.05]},
    "push": {"speed": [0, 0.6], "every": 0.3},
    "wind": {"force": [0, 10]},
    "slope": {"pitch": [-0.05, 0.05], "roll": [-0.05, 0.05]},
    "rough_ground": {"height": 0.01},
}


def begun(rows: int = 2, **randomisation: Any) -> BatchEnv:
    """Environments of parkour at full level, just reset."""
    task = load_task("parkour", {"curriculum": None, "restarts": None, "randomisation": randomisation})
    env = BatchEnv(task, rows, SEED, threads=1)
    env.reset()
    return env


def in_the_air(env: BatchEnv) -> BatchEnv:
    env.sim.qpos[:, 2] += 5.0
    return env


def still(env: BatchEnv) -> np.ndarray:
    """Actions that keep the nominal pose."""
    return np.zeros((env.num_envs, env.action_size))


# ---- the robot ----


def test_a_centre_of_mass_lies_where_it_was_put_and_the_shapes_stay() -> None:
    env, as_it_is = begun(3, centre_of_mass={"spread": 0.05}), begun(1)
    base = as_it_is.sim.model
    for row in range(3):
        model = env.sim.mj.get_model(row)
        moved = model.body_ipos - base.body_ipos
        assert not moved[0].any() and (np.abs(moved[1:]) <= 0.05).all() and np.abs(moved[1:]).min() > 0.0
        data, plain = mujoco.MjData(model), mujoco.MjData(base)
        data.qpos[:] = plain.qpos[:] = env.sim.qpos[row]
        mujoco.mj_forward(model, data)
        mujoco.mj_forward(base, plain)
        rotation = plain.xmat.reshape(-1, 3, 3)
        np.testing.assert_allclose(data.xipos, plain.xipos + np.einsum("bij,bj->bi", rotation, moved), atol=1e-12)
        robot = base.geom_bodyid > 0
        np.testing.assert_allclose(data.geom_xpos[robot], plain.geom_xpos[robot], atol=1e-12)


def test_a_payload_and_factors_on_masses_are_weighed_together() -> None:
    env = begun(4, mass={"scale": 1.1}, payload={"mass": 2.0})
    total = [env.sim.mj.get_model(row).body_mass.sum() for row in range(4)]
    np.testing.assert_allclose(total, 1.1 * env.sim.model.body_mass.sum() + 2.0)


def test_each_body_and_servo_has_a_factor_of_its_own() -> None:
    env = begun(50, mass={"each": 0.2}, gains={"scale": 0.9, "each": 0.1})
    factor = env.disturbances.varied(np.arange(50))["body_mass"][:, 1:] / env.sim.model.body_mass[1:]
    assert 0.8 <= factor.min() < 0.82 and 1.18 < factor.max() <= 1.2
    assert np.abs(np.corrcoef(factor.T) - np.eye(factor.shape[1])).max() < 0.6
    gains = env.sim.gain_factor
    assert 0.81 <= gains.min() < 0.82 and 0.98 < gains.max() <= 0.99


def test_the_strength_of_a_motor_is_what_it_gives_at_its_limit() -> None:
    env, as_it_is = (in_the_air(begun(1, **given)) for given in ({"motor_strength": {"scale": 0.5}}, {}))
    for each in (env, as_it_is):
        each.step(np.ones((1, each.action_size)))
    weak, full = (each.sim.mj.get_data(0).actuator_force for each in (env, as_it_is))
    assert np.abs(weak).max() == pytest.approx(0.5 * np.abs(full).max())
    np.testing.assert_allclose(env.sim.mj.get_model(0).actuator_gainprm[:, 0], 15.0)


def test_friction_damping_and_armature_of_the_joints_alone_are_changed() -> None:
    given = {"joint_friction": {"torque": 0.2}, "joint_damping": {"coefficient": 0.05}, "armature": {"scale": 2.0}}
    env = begun(1, **given)
    model, base = env.sim.mj.get_model(0), env.sim.model
    np.testing.assert_allclose(model.dof_frictionloss[6:], base.dof_frictionloss[6:] + 0.2)
    np.testing.assert_allclose(model.dof_damping[6:], base.dof_damping[6:] + 0.05)
    np.testing.assert_allclose(model.dof_armature[6:], 2.0 * base.dof_armature[6:])
    assert not model.dof_frictionloss[:6].any() and not model.dof_damping[:6].any()


def test_every_contact_is_as_hard_as_was_drawn() -> None:
    env = begun(1, contact={"time_constant": 0.006})
    for _ in range(10):
        env.step(still(env))
    model, data = env.sim.mj.get_model(0), env.sim.mj.get_data(0)
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    np.testing.assert_allclose([contact.solref[0] for contact in data.contact], 0.006)


# ---- the world ----


def test_wind_accelerates_the_robot_by_its_force_over_the_mass() -> None:
    env = in_the_air(begun(3, wind={"force": 7.0}))
    env.step(still(env))
    momentum = []
    for row in range(3):
        model, data = env.sim.mj.get_model(row), env.sim.mj.get_data(row)
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        momentum.append(data.subtree_linvel[1].copy())
    impulse = np.array(momentum)[:, :2] * env.sim.model.body_mass.sum()
    np.testing.assert_allclose(np.linalg.norm(impulse, axis=1), 7.0 * SUBSTEPS * PHYSICS_DT, rtol=1e-2)
    assert np.std(np.arctan2(impulse[:, 1], impulse[:, 0])) > 0.1


@pytest.mark.parametrize(("pitch", "roll"), [(0.1, 0.0), (0.0, -0.2), (-0.3, 0.2)])
def test_on_a_slope_gravity_leans_as_much_as_the_ground_would(pitch: float, roll: float) -> None:
    gravity = begun(1, slope={"pitch": pitch, "roll": roll}).sim.mj.get_model(0).opt.gravity
    assert np.linalg.norm(gravity) == pytest.approx(9.81)
    assert -gravity[0] / -gravity[2] == pytest.approx(np.tan(pitch))  # a track that rises pulls back
    assert -gravity[1] / -gravity[2] == pytest.approx(np.tan(roll))


def test_rough_ground_is_higher_or_lower_than_the_policy_sees_it() -> None:
    env, as_it_is = (begun(20, **given) for given in ({"rough_ground": {"height": 0.02}}, {}))
    boxes = env.sim._boxes
    raised = env.sim._geom_pos[:, boxes, 2] - as_it_is.sim._geom_pos[:, boxes, 2]
    assert 0.019 < np.abs(raised).max() <= 0.02 and np.std(raised) == pytest.approx(0.02 / np.sqrt(3), rel=0.2)
    np.testing.assert_array_equal(env.view().ground_height, as_it_is.view().ground_height)


# ---- time ----


def test_a_jitter_of_actions_lies_on_top_of_their_delay_and_none_is_lost() -> None:
    env = begun(200, action_delay={"delay": 0.01, "jitter": 0.02})
    late = []
    for k in range(30):
        arrivals = env.disturbances.arrivals(np.full((200, 10), float(k)), None, None)
        late += [(k - value[0]) * SUBSTEPS + at for at, value in zip(arrivals.at, arrivals.values, strict=True)]
    assert (min(late), max(late)) == (5, 15)  # 10 to 30 ms
    assert 200 * 29 <= len(late) <= 200 * 30
    counts = np.bincount(np.array(late, dtype=int))[6:15]
    assert counts.min() > 0.9 * counts.mean()


def test_an_observation_is_of_the_physics_step_that_it_is_old() -> None:
    """As in a loop of ``mj_step`` in which the robot is looked at just then."""
    env = begun(1, sensor_delay={"delay": 0.008})
    model, data = env.sim.mj.get_model(0), env.sim.mj.get_data(0)
    for command in actions(5, 1):
        observation = env.step(command).observation[0]
        data.ctrl[:] = 2.0 * command[0]
        for step in range(SUBSTEPS):
            if step == SUBSTEPS - 4:
                joints, rates = data.qpos[7:].copy(), data.qvel[6:].copy()
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(observation[5:15], joints, atol=1e-6)
        np.testing.assert_allclose(observation[21:31], rates, rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(env.sim.qpos[0], data.qpos)


def test_an_observation_that_is_a_control_step_old_is_the_one_before() -> None:
    late, prompt = begun(2, sensor_delay={"delay": 0.03}), begun(2)
    before = prompt.step(still(prompt)).observation
    late.step(still(late))
    for command in actions(4, 2):
        now = prompt.step(command).observation
        np.testing.assert_array_equal(late.step(command).observation[:, :31], before[:, :31])
        before = now


@pytest.mark.parametrize("within", [0.0, 0.01])
def test_an_observation_may_be_some_control_steps_old(within: float) -> None:
    """Two control steps and a part of one: what a delay of that part gave two control steps ago."""
    late, less = begun(2, sensor_delay={"delay": 0.06 + within}), begun(2, sensor_delay={"delay": within})
    seen = [less.step(still(less)).observation[:, :31] for _ in range(4)]
    for _ in range(4):
        late.step(still(late))
    for command in actions(6, 2):
        seen.append(less.step(command).observation[:, :31])
        np.testing.assert_array_equal(late.step(command).observation[:, :31], seen[-3])


def test_what_is_older_than_an_episode_is_its_start() -> None:
    late = begun(1, sensor_delay={"delay": 0.09})
    start = late.reset()
    for _ in range(3):
        np.testing.assert_array_equal(late.step(still(late)).observation[:, :31], start[:, :31])
    assert (late.step(still(late)).observation[:, 5:15] != start[:, 5:15]).any()


def test_only_what_a_robot_senses_grows_old() -> None:
    observations = {"proprioception": None, "mode_latent": None, "height_scan": None, "joints": {}, "last_action": {}}
    changes = {"observations": observations, "randomisation": {"sensor_delay": {"delay": 0.09}}}
    env = BatchEnv(load_task("parkour", changes), 2, SEED, threads=1)
    env.reset()
    for command in actions(3, 2):
        observation = env.step(command).observation
    np.testing.assert_allclose(observation[:, -10:], np.clip(command, -1.0, 1.0), atol=1e-6)


def test_a_control_loop_that_does_not_keep_its_time_takes_more_or_fewer_physics_steps() -> None:
    env = begun(30, control_jitter={"jitter": 0.004})
    clock = env.sim.mj.bind("time")
    lengths, before = [], clock.copy()
    for _ in range(20):
        env.step(still(env))
        lengths.append(np.rint((clock - before) / PHYSICS_DT).astype(int).ravel())
        before = clock.copy()
    counts = np.bincount(np.concatenate(lengths), minlength=18)
    assert counts[:13].sum() == 0 and (counts[13:18] > 0.7 * 120).all()


# ---- sensors ----


def test_an_encoder_s_offset_is_in_what_is_measured_and_in_what_is_commanded() -> None:
    env = in_the_air(begun(1, joint_offset={"spread": 0.1}))
    observation = env.step(still(env)).observation[0, 5:15]
    offset = observation - env.sim.qpos[0, 7:]
    assert np.abs(offset).max() <= 0.1 and np.abs(offset).max() > 0.02
    np.testing.assert_allclose(env.sim.ctrl[0], -offset, atol=1e-6)


def test_errors_of_the_imu_fall_on_rates_and_orientation_and_a_bias_stays() -> None:
    env, clean = begun(200, imu={"rate": 0.2, "tilt": 0.04, "rate_bias": 0.5, "heading_bias": 0.1}), begun(200)
    first, second = (env.step(still(env)).observation - clean.step(still(clean)).observation for _ in range(2))
    bias = 0.5 * (first + second)[:, 18:21]
    assert 0.4 < np.abs(bias).max() < 0.5 + 0.2 * 4
    np.testing.assert_allclose((first - second)[:, 18:21].std(), 0.2 * np.sqrt(2), rtol=0.1)
    np.testing.assert_allclose((first - second)[:, 1:5].std(), 0.02 * np.sqrt(2), rtol=0.1)
    assert not first[:, [0, *range(5, 18), *range(21, 60)]].any()


def test_a_scan_may_be_older_than_the_rest() -> None:
    late, prompt = begun(3, scan={"delay": 0.06}), begun(3)
    seen = []
    for each in (late, prompt):
        each.sim.qvel[:, 0] = 3.0  # so that heights change
    for command in actions(12, 3):
        seen.append(prompt.step(command).observation)
        observation = late.step(command).observation
        np.testing.assert_array_equal(observation[:, :31], seen[-1][:, :31])
        if len(seen) > 2:
            np.testing.assert_array_equal(observation[:, -25:], seen[-3][:, -25:])
    assert np.ptp([each[:, -25:] for each in seen], axis=0).max() > 0.05


def test_points_of_a_scan_that_drop_out_keep_their_height() -> None:
    env, clean = begun(300, scan={"dropout": 0.3}), begun(300)
    for each in (env, clean):
        each.sim.qvel[:, 0] = 3.0  # so that heights change
    heights = [(e.step(still(e)).observation[:, -25:], o) for e, o in ((env, None), (clean, None))]
    (seen, _), (true, _) = heights
    start = begun(300).observer.policy(begun(300).view())[:, -25:]
    differ = true != start
    kept = seen == start
    assert (seen[~kept] == true[~kept]).all()
    assert kept[differ].mean() == pytest.approx(0.3, abs=0.05)


def test_an_error_of_what_is_not_observed_is_one_sentence() -> None:
    given = {"randomisation": {"scan": {"height": 0.1}}, "observations.height_scan": None}
    with pytest.raises(ValueError, match=r"'scan' gives disturbs 'height_scan', which is not observed"):
        BatchEnv(load_task("parkour", given))
    given = {"randomisation": {"sensor_noise": {"scale": 0.1}}, "observations.proprioception": None}
    with pytest.raises(ValueError, match="disturbs 'proprioception', which is not observed"):
        BatchEnv(load_task("parkour", given))
    given = {"randomisation": {"imu": {"rate": 0.1}}, "observations.proprioception": None}
    with pytest.raises(
        ValueError, match="disturbs 'base_angvel_b', 'gravity_b', 'heading', 'base_quat', which is not observed"
    ):
        BatchEnv(load_task("parkour", given))


# ---- episodes ----


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sensor_delay": {"delay": 0.49, "jitter": 0.02}}, "observations are old by up to 0.51 s; at most 0.5 s"),
        ({"sensor_delay": {"jitter": 0.04}}, "the age of observations differs by up to 0.04 s; at most 0.03 s"),
        (
            {"sensor_delay": {"delay": 0.3}, "scan": {"delay": 0.3}},
            "'height_scan' is old by up to 0.6 s",
        ),
        ({"action_delay": {"jitter": 0.04}}, "the delay of actions differs by up to 0.04 s; at most 0.03 s"),
        ({"action_delay": {"delay": [0, 0.5], "jitter": 0.01}}, "actions are late by up to 0.51 s; at most 0.5 s"),
        ({"control_jitter": {"jitter": 0.02}}, "control steps differ by up to 0.02 s; at most 0.015 s"),
    ],
)
def test_times_that_cannot_be_are_one_sentence(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"tasks/parkour.yaml: by its 'randomisation' {message}"):
        begun(1, **given)


def test_a_saved_state_goes_on_bit_for_bit_under_everything_at_once() -> None:
    env, other = begun(3, **EVERYTHING), begun(3, **EVERYTHING)
    for command in actions(7, 3):
        env.step(command)
    other.set_state(*env.state())
    for command in actions(60, 3)[7:]:
        first, second = env.step(command), other.step(command)
        np.testing.assert_array_equal(first.observation, second.observation)
        np.testing.assert_array_equal(env.sim.qpos, other.sim.qpos)
        rows = ended(first)
        if len(rows):
            np.testing.assert_array_equal(env.reset(rows), other.reset(rows))


def test_four_rows_equal_four_environments_of_one_under_everything_at_once() -> None:
    task = load_task("parkour", {"curriculum": None, "randomisation": EVERYTHING})
    commands = actions(40, 4)
    four = play(BatchEnv(task, 4, SEED, threads=1), commands)
    for row in range(4):
        assert_same(play(BatchEnv(task, 1, SEED + row, threads=1), commands[:, row : row + 1]), four, rows=[row])


def test_a_curriculum_widens_what_is_drawn() -> None:
    given = {"friction": {"coefficient": [0.4, 1.2]}, "action_delay": {"delay": [0.0, 0.04]}}
    easy = {"friction": {"coefficient": 0.8}, "action_delay": {"delay": 0.0}}
    task = load_task("parkour", {"randomisation": given, "curriculum.randomisation": easy})
    env = BatchEnv(task, 200, SEED, threads=1)
    for level in (0.0, 0.5, 1.0):
        env.disturbances.begin(np.arange(200), np.full(200, level))
        friction = env.disturbances.varied(np.arange(200))["geom_friction"][:, 0, 0]
        delay = env.disturbances.arrays()["action_delay"]
        assert friction.min() == pytest.approx(0.8 - 0.4 * level, abs=0.02)
        assert friction.max() == pytest.approx(0.8 + 0.4 * level, abs=0.02)
        assert delay.max() == pytest.approx(0.04 * level, abs=0.002)


def test_a_word_of_the_curriculum_that_the_task_does_not_have_is_one_sentence() -> None:
    with pytest.raises(KeyError, match=r"'curriculum\.randomisation' has 'mass'"):
        keys = {"randomisation": {"push": {"speed": 1.0}}, "curriculum.randomisation": {"mass": {"scale": 1.0}}}
        load_task("parkour", keys)
    assert load_task("parkour_robot", {"randomisation": None}).randomised == {}


@pytest.mark.parametrize("name", ["parkour_robot", "dive_robot"])
def test_the_policy_of_a_robot_s_task_sees_only_what_a_robot_has(name: str) -> None:
    env = BatchEnv(load_task(name), 8, SEED, threads=1)
    env.reset()
    for command in actions(3, 8):
        observation = env.step(command).observation
    assert np.isfinite(observation).all()
    parts = {part.name for part in env.observer.parts(env.view())}
    assert {"gravity_b", "base_angvel_b", "joint_pos", "joint_vel", "last_action"} < parts
    assert not {"base_height", "base_quat", "base_linvel_b", "position_error"} & parts
    assert env.critic_observation().shape == (8, 31 + 12)


# ---- plug-ins ----


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (1.0, "what randomisation 'mine' returns must be a Disturbance; it is"),
        (Disturbance(model={"body_weight": np.ones(3)}), "varies 'body_weight', which is no field of MuJoCo's model"),
        (Disturbance(model={"body_mass": np.ones(3)}), r"has 'body_mass' of the model of the shape \(3,\); it must be"),
        (Disturbance(gains=np.ones(4)), r"has gains of the shape \(4,\); it must be \(10,\)"),
        (
            Disturbance(bias={"joint_pos": np.ones(3)}),
            r"has bias of 'joint_pos' of the shape \(3,\); it must be \(10,\)",
        ),
        (Disturbance(force=np.full(3, np.nan)), "has force that is not finite"),
    ],
)
def test_a_wrong_answer_of_a_term_is_one_sentence(answer: Any, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry.randomisations, "_functions", dict(registry.randomisations._functions))

    def mine(subject: Subject, size: float) -> Disturbance:
        return answer

    registry.randomisations.register()(mine)
    with pytest.raises((ValueError, TypeError), match=message):
        begun(1, mine={"size": 1.0})


def test_a_term_of_a_plug_in_sees_what_the_terms_before_have_made_of_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry.randomisations, "_functions", dict(registry.randomisations._functions))

    def heavier(subject: Subject, factor: float) -> Disturbance:
        return Disturbance(model={"body_mass": factor * subject.field("body_mass")})

    registry.randomisations.register()(heavier)
    env = begun(1, mass={"scale": 1.5}, heavier={"factor": 2.0})
    np.testing.assert_allclose(env.sim.mj.get_model(0).body_mass, 3.0 * env.sim.model.body_mass)
