"""ogmp-export: the exported policy is the policy, its description is the environment's, and it runs alone."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from helpers.learners import make_policy
from helpers.programs import program
from ogmp_sb3.commands.export import bundle
from ogmp_sb3.commands.export.controller import Controller
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.observations import CLIP
from ogmp_sb3.runs.policies import LoadedPolicy, load_policy

ALONE = """
import json, sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("torch", "ogmp_sb3"):
            raise ImportError(f"{name} is blocked")

sys.meta_path.insert(0, Blocked())
import numpy as np
from controller import Controller

controller = Controller(sys.argv[1])
for line in sys.stdin:
    observation = json.loads(line)
    if observation is None:
        controller.reset()
    else:
        print(json.dumps(controller.step(np.array(observation)).tolist()), flush=True)
"""


@pytest.fixture(scope="module")
def policies(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("policies")
    return {
        "parkour": make_policy(folder / "parkour", "parkour", 2),
        "dive": make_policy(folder / "dive", "dive", 1),
        "blind": make_policy(folder / "blind", "parkour", 3, "observations.mode_latent=null", "action.scale=0.5"),
    }


@pytest.fixture(scope="module")
def exported(policies, tmp_path_factory) -> Callable[[str], tuple[LoadedPolicy, BatchEnv, Path]]:
    folder = tmp_path_factory.mktemp("exported")

    def get(name: str) -> tuple[LoadedPolicy, BatchEnv, Path]:
        loaded = load_policy(policies[name])
        env = BatchEnv(loaded.task.for_evaluation(), threads=1)
        if not (folder / name).exists():
            bundle.export(loaded, env, folder / name)
        return loaded, env, folder / name

    return get


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
    for joint, kp, kd, limit in zip(info["action"]["joints"], *info["gains"].values(), strict=True):
        servo = env.sim.model.actuator(joint)
        assert (servo.gainprm[0], servo.biasprm[1], servo.biasprm[2]) == (kp, -kp, -kd)
        assert servo.forcerange.tolist() == [-limit, limit]
    action = np.linspace(-1, 1, env.action_size)
    env.reset()
    env.step(action[None])
    targets = np.array(info["action"]["nominal"]) + info["action"]["scale"] * action
    np.testing.assert_allclose(env.sim.ctrl[0, env.sim.actuators], targets)


def test_a_servo_without_a_limit_has_none(exported) -> None:
    loaded, env, _ = exported("blind")
    env.sim.model.actuator_forcelimited[env.sim.actuators[0]] = 0
    limits = bundle.description(loaded, env)["gains"]["torque_limit"]
    assert limits[0] is None and None not in limits[1:]


@contextmanager
def alone(out: Path) -> Iterator[Callable[[np.ndarray | None], np.ndarray]]:
    """The exported controller in an interpreter that has neither torch nor this package."""
    command = [sys.executable, "-c", ALONE, str(out)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": {"PYTHONPATH": str(out)}}
    with subprocess.Popen(command, **pipes) as process:
        assert process.stdin is not None and process.stdout is not None

        def ask(observation: np.ndarray | None) -> np.ndarray:
            process.stdin.write(json.dumps(None if observation is None else observation.tolist()) + "\n")
            process.stdin.flush()
            return np.zeros(0) if observation is None else np.array(json.loads(process.stdout.readline()))

        yield ask
        process.stdin.close()
        assert process.wait(timeout=20) == 0


def drive(env: BatchEnv, act: Callable[[np.ndarray, bool], np.ndarray]) -> tuple[np.ndarray, int]:
    """Positions over 80 steps of episodes, and how many episodes began; ``act`` gets an observation and its start."""
    env.seed(4)
    observation, start, positions, episodes = env.reset(), True, [], 0
    for _ in range(80):
        episodes += start
        result = env.step(act(observation, start))
        positions.append(env.sim.qpos[0].copy())
        observation, start = result.observation, bool((result.terminated | result.truncated)[0])
        if start:
            observation = env.reset()
    return np.array(positions), episodes


def test_the_example_alone_drives_a_robot_as_the_policy_does(exported) -> None:
    loaded, env, out = exported("parkour")
    state = None

    def pytorch(observation: np.ndarray, start: bool) -> np.ndarray:
        nonlocal state
        action, state = loaded.policy.predict(observation, state, np.array([start]), deterministic=True)
        return action

    with alone(out) as ask:

        def example(observation: np.ndarray, start: bool) -> np.ndarray:
            if start:
                ask(None)
            return (ask(observation[0])[None] - loaded.task.robot_config.nominal_joints) / loaded.task.action.scale

        (expected, episodes), (found, _) = drive(env, pytorch), drive(env, example)
    assert episodes > 1
    assert np.ptp(expected, axis=0).max() > 0.1
    # Rounding differs, and what is thrown about by contacts doubles a difference every few steps.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)


def test_the_program_exports_checks_and_times(policies, tmp_path: Path) -> None:
    done = program("export", f"run={policies['dive']}", "out=there", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Actions over 1000 steps differ from PyTorch's by at most" in done.stdout
    assert "99th percentile" in done.stdout
    names = ["controller.json", "controller.py", "encoder.onnx", "policy.onnx"]
    assert sorted(file.name for file in (tmp_path / "there").iterdir()) == names


def test_a_model_of_another_policy_does_not_stay(policies, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "encoder.onnx").write_bytes(b"of another policy")
    done = program("export", f"run={policies['blind']}", "out=there", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(file.name for file in (tmp_path / "there").iterdir()) == [
        "controller.json",
        "controller.py",
        "policy.onnx",
    ]


def test_a_model_that_strays_from_pytorch_is_reported(policies, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bundle, "TOLERANCE", 1e-12)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "policy.onnx").write_bytes(b"an earlier one")
    done = program("export", f"run={policies['blind']}", "out=there", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("ogmp-export: the actor strays from PyTorch by")
    assert [(file.name, file.read_bytes()) for file in (tmp_path / "there").iterdir()] == [
        ("policy.onnx", b"an earlier one")
    ]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["run=nowhere", "out=x"], "'nowhere' is neither a run directory nor a shipped policy"),
        (["run={policy}"], "'out' is missing"),
        (["run={damaged}", "out=x"], "policy.safetensors: damaged or missing"),
    ],
)
def test_mistakes_are_a_sentence(arguments, sentence, policies, tmp_path: Path) -> None:
    damaged = shutil.copytree(policies["dive"], tmp_path / "damaged") / "policy.safetensors"
    content = bytearray(damaged.read_bytes())
    content[-1] ^= 1
    damaged.write_bytes(content)
    given = [a.format(policy=policies["dive"], damaged=damaged.parent) for a in arguments]
    done = program("export", *given, cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert sentence in done.stderr


@pytest.mark.parametrize("package", ["onnx", "onnxruntime"])
def test_without_what_it_needs_the_program_names_the_extra(package: str, policies, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    done = program("export", f"run={policies['dive']}", "out=x", cwd=tmp_path)
    assert done.returncode == 2
    assert f"the package '{package}' is missing: pip install \"ogmp_sb3[export]\"" in done.stderr


@pytest.mark.parametrize(
    ("name", "change", "sentence"),
    [
        ("policy.onnx", lambda content: content[:-1] + b"x", "policy.onnx: not the file that was exported"),
        ("encoder.onnx", None, "encoder.onnx: not readable"),
        ("controller.json", None, "controller.json: not readable"),
        ("controller.json", lambda content: content[:-1], "controller.json: not what ogmp-export writes"),
        ("controller.json", lambda content: b"[]", "controller.json: not what ogmp-export writes"),
        ("controller.json", lambda content: b'{"sha256": {}}', "controller.json: not what ogmp-export writes"),
    ],
)
def test_the_example_refuses_files_that_are_missing_or_changed(name, change, sentence, exported, tmp_path) -> None:
    folder = shutil.copytree(exported("parkour")[2], tmp_path / "copy")
    content = (folder / name).read_bytes()
    (folder / name).unlink()
    if change is not None:
        (folder / name).write_bytes(change(content))
    with pytest.raises(ValueError, match=sentence):
        Controller(folder)


def test_the_example_refuses_an_observation_of_another_size(exported) -> None:
    with pytest.raises(ValueError, match=r"an observation has shape \(60,\), found \(59,\)"):
        Controller(exported("parkour")[2]).step(np.zeros(59))
