"""The example controller, alone."""

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

from ogmp_sb3.commands.export.controller import Controller
from ogmp_sb3.env.batch_env import BatchEnv

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


def test_the_example_keeps_its_targets_within_the_range_of_the_servos(exported, tmp_path) -> None:
    folder = shutil.copytree(exported("parkour")[2], tmp_path / "copy")
    info = json.loads((folder / "controller.json").read_text())
    free = Controller(folder)
    observation = np.full(60, 0.3)
    targets = free.step(observation)
    middle = float(np.median(targets))
    info["action"] |= {"low": [middle] * 5 + [None] * 5, "high": [None] * 5 + [middle] * 5}
    (folder / "controller.json").write_text(json.dumps(info))
    expected = np.concatenate([np.maximum(targets[:5], middle), np.minimum(targets[5:], middle)])
    assert not np.array_equal(expected, targets)
    np.testing.assert_array_equal(Controller(folder).step(observation), expected)
