"""A control step in which a simulation failed."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.yaml_files import apply_overrides, read_yaml
from ogmp_sb3.env.failed_step import UnstableStep
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

PATH = TASKS_DIR / "parkour.yaml"
VARIED = {
    "randomisation": {
        "mass": {"scale": [0.8, 1.2]},
        "friction": {"coefficient": [0.5, 1.0]},
        "gains": {"scale": [0.8, 1.2]},
        "action_delay": {"delay": 0.03},
    }
}


def failed_step() -> tuple[UnstableStep, dict]:
    """A step in which a joint of environment 1 was as fast as no joint can be, on a robot that is varied."""
    data = apply_overrides(read_yaml(PATH), VARIED, "test")
    vec = OgmpVecEnv(task_from_data(data, PATH), 3, seed=4, threads=1)
    vec.reset()
    rng = np.random.default_rng(0)
    for _ in range(3):
        vec.step(rng.uniform(-0.1, 0.1, (3, 10)))
    vec.batch.sim.qvel[1, vec.batch.sim.joint_qvel[3]] = 4e4
    before = vec.batch.sim.qpos[1].copy()
    actions = rng.uniform(-0.1, 0.1, (3, 10))
    _, _, done, infos = vec.step(actions)
    assert done.tolist() == [False, True, False]
    assert ["unstable" in info for info in infos] == [False, True, False]
    step = infos[1]["unstable"]
    np.testing.assert_array_equal(step.action, actions[1])
    position = 1  # behind the time
    np.testing.assert_array_equal(step.state[position : position + len(before)], before)
    assert step.info["environment"] == 1 and step.info["control_step"] == 4
    assert set(step.varied) == {"body_mass", "body_inertia", "geom_friction", "gains", "force", "ground"}
    return step, data
