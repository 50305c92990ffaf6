"""The files of an exported policy, against the policy."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ogmp_sb3.commands.export import bundle
from ogmp_sb3.commands.export import controller as example
from ogmp_sb3.commands.export.controller import Controller
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.observations import CLIP


@pytest.mark.parametrize("name", ["parkour", "dive", "blind"])
def test_actions_are_those_of_pytorch_over_1000_random_observations(name: str, exported) -> None:
    loaded, env, out = exported(name)
    controller = Controller(out)
    rng = np.random.default_rng(0)
    limit = CLIP * env.observation_scale
    state, actions = None, np.zeros((1000, env.action_size))
    for k in range(1000):
        observation = rng.normal(size=len(limit)) * env.observation_scale * rng.choice([0.3, 3.0, 300.0])
        observation = np.clip(observation, -limit, limit).astype(np.float32)
        start = np.array([k % 250 == 0])
        if start[0]:
            controller.reset()
        expected, state = loaded.policy.predict(observation[None], state, start, deterministic=True)
        actions[k] = controller.act(observation)
        np.testing.assert_allclose(actions[k], expected[0], rtol=0, atol=1e-5)
    assert (np.abs(actions) == 1.0).any() and (np.abs(actions) < 0.5).any()


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_actions_are_those_of_pytorch_over_1000_steps_of_episodes(name: str, exported) -> None:
    loaded, env, out = exported(name)
    difference, seconds = bundle.parity(loaded, env, Controller(out))
    assert 0.0 < difference < bundle.TOLERANCE
    assert (seconds > 0).all()


def test_parity_sees_a_state_that_is_not_carried_along(exported, monkeypatch) -> None:
    loaded, env, out = exported("parkour")

    class Forgetful(Controller):
        def act(self, observation: np.ndarray) -> np.ndarray:
            self.reset()
            return super().act(observation)

    assert bundle.parity(loaded, env, Forgetful(out))[0] > 1e-3


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_latents_are_those_of_the_environment(name: str, exported) -> None:
    loaded, _, out = exported(name)
    assert bundle.encoder_parity(loaded, out / "encoder.onnx") < bundle.TOLERANCE


def test_a_policy_without_latent_needs_no_encoder(exported) -> None:
    _, _, out = exported("blind")
    assert sorted(file.name for file in out.iterdir()) == ["controller.json", "controller.py", "policy.onnx"]


@pytest.mark.parametrize("name", ["parkour", "dive", "blind"])
def test_components_cover_the_observation_without_gap_and_with_its_scales(name: str, exported) -> None:
    _, env, out = exported(name)
    components = json.loads((out / "controller.json").read_text())["observation"]["components"]
    ends = [0, *(c["slice"][1] for c in components)]
    assert [c["slice"][0] for c in components] == ends[:-1]
    assert ends[-1] == env.observation_size
    np.testing.assert_array_equal(np.concatenate([c["scale"] for c in components]), env.observation_scale)
    assert all(c["unit"] in ("m", "m/s", "rad", "rad/s", "1") for c in components)


def test_components_name_what_the_simulation_holds_there(exported) -> None:
    _, env, out = exported("parkour")
    components = json.loads((out / "controller.json").read_text())["observation"]["components"]
    places = {c["name"]: slice(*c["slice"]) for c in components}
    env.reset()
    rng = np.random.default_rng(3)
    for _ in range(7):
        observation = env.step(rng.uniform(-0.2, 0.2, (1, env.action_size))).observation[0]
    sim, p, v = env.sim, env.sim.base_qpos, env.sim.base_qvel
    truth = {
        "base_quat": sim.qpos[0, p + 3 : p + 7],
        "joint_pos": [sim.qpos[0, sim.model.joint(name).qposadr[0]] for name in env.task.robot_config.joints],
        "base_angvel_b": sim.qvel[0, v + 3 : v + 6],
        "joint_vel": [sim.qvel[0, sim.model.joint(name).dofadr[0]] for name in env.task.robot_config.joints],
        "clock_sin": [np.sin(2 * np.pi * 7 / 30)],
        "clock_cos": [np.cos(2 * np.pi * 7 / 30)],
        "mode_latent": env.view().latent[0],
    }
    for name, value in truth.items():
        np.testing.assert_allclose(observation[places[name]], value, rtol=1e-6, atol=1e-6, err_msg=name)


def test_gains_and_targets_are_those_of_the_servos(exported) -> None:
    _, env, out = exported("blind")
    info = json.loads((out / "controller.json").read_text())
    gains = [info["gains"][name] for name in ("kp", "kd", "torque_limit", "time_constant")]
    for joint, kp, kd, limit, time_constant in zip(info["action"]["joints"], *gains, strict=True):
        servo = env.sim.model.actuator(joint)
        assert (servo.gainprm[0], servo.biasprm[1], servo.biasprm[2]) == (kp, -kp, -kd)
        assert servo.forcerange.tolist() == [-limit, limit]
        assert time_constant == 0
    assert info["action"]["low"] == info["action"]["high"] == [None] * env.action_size
    action = np.linspace(-1, 1, env.action_size)
    env.reset()
    env.step(action[None])
    targets = np.array(info["action"]["nominal"]) + info["action"]["scale"] * action
    np.testing.assert_allclose(env.sim.ctrl[0, env.sim.servos.ctrl], targets)


def test_what_the_oracle_plans_with_is_that_of_the_task(exported) -> None:
    loaded, _, out = exported("parkour")
    task, guidance = loaded.task, json.loads((out / "controller.json").read_text())["guidance"]
    assert guidance["oracle_params"] == task.oracle_params["preview"]
    assert guidance["oracle_params"]["Q"]["z"] == 11000.0
    assert guidance["feedback"] == ["x", "y", "z", "vx", "vy", "vz"]
    assert guidance["gait"] == {"height": 0.55, "cycle": 0.25}
    assert guidance["srb"] == {"mass": 14.046, "inertia": [0.36634, 0.333831, 0.133149]}
    assert guidance["feet"] == 2
    assert json.loads((exported("blind")[2] / "controller.json").read_text())["guidance"] is None


def test_every_component_of_a_shipped_term_is_in_the_docstring_of_the_controller() -> None:
    both_sides = {"observations.commanded_speed": {}, "observations.mode_latent.both_sides": True}
    tasks = load_task("parkour", both_sides), load_task("parkour_robot")
    names = [part["name"] for task in tasks for part in bundle.observation_components(BatchEnv(task, threads=1))]
    assert {"commanded_speed", "mirrored_mode_latent", "height_scan", "gravity_b", "last_action"} < set(names)
    words = (example.__doc__ or "").replace(",", " ").split()
    assert [name for name in names if name not in words] == []


SERVO = '<position kp="30" kv="0.5" forcerange="-30 30"/>'
KNEE = '<position forcerange="-50 50"/>'
ANKLE = '<joint axis="0 1 0" range="-1.4 1.4"/>'


def test_what_is_exported_acts_at_the_joint(exported, tmp_path: Path) -> None:
    """Gears, limits of actuators and of joints, ranges of targets, filters."""
    loaded, _, _ = exported("blind")
    robot = loaded.task.robot_config
    mjcf = robot.mjcf_path.read_text(encoding="utf-8")
    for found, written in (
        (SERVO, '<position kp="7.5" kv="0.125" gear="-2" forcerange="-15 15" ctrlrange="-1.8 1.6" timeconst="0.02"/>'),
        (KNEE, '<position forcerange="-25 10"/>'),
        (ANKLE, '<joint axis="0 1 0" range="-1.4 1.4" actuatorfrcrange="-12 12"/>'),
        ('joint="L_hip_yaw" class', 'joint="L_hip_yaw" forcelimited="false" ctrllimited="false" class'),
        ('joint="R_hip_yaw" class', 'joint="R_hip_yaw" forcelimited="false" ctrllimited="false" class'),
    ):
        assert found in mjcf, found
        mjcf = mjcf.replace(found, written)
    (tmp_path / "model.xml").write_text(mjcf, encoding="utf-8")
    task = replace(loaded.task, robot_config=replace(robot, mjcf=str(tmp_path / "model.xml")))
    info = bundle.description(loaded, BatchEnv(task, threads=1))
    gains, action = info["gains"], info["action"]
    np.testing.assert_allclose(gains["kp"], 30.0)
    np.testing.assert_allclose(gains["kd"], 0.5)
    np.testing.assert_allclose(gains["time_constant"], 0.02)
    assert gains["torque_limit"] == [None, 30, 30, [-20, 50], 12] * 2
    assert action["low"] == [None, -0.8, -0.8, -0.8, -0.8] * 2
    assert action["high"] == [None, 0.9, 0.9, 0.9, 0.9] * 2
    assert json.loads(json.dumps(info)) == info
