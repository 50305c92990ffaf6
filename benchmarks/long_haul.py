"""A million control steps with resets: does the memory grow, are files left open, is anything ever not finite?

    python benchmarks/long_haul.py [steps] [out.json]

The shipped parkour policy acts at random, so that robots run far, fall and begin anew, on tracks that go on for ever,
with every disturbance switched on.
"""

from __future__ import annotations

import copy
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch as th

from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.yaml_files import apply_overrides
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

NUM_ENVS = 64
WARM_UP = 0.1  # share of the steps before memory counts: caches fill, buffers reach their size
DISTURBED = {
    "mass": {"scale": [0.8, 1.2]},
    "friction": {"coefficient": [0.5, 1.2]},
    "gains": {"scale": [0.8, 1.2]},
    "action_delay": {"delay": [0, 0.06]},
    "sensor_noise": {"scale": 0.1},
    "push": {"every": 1.0, "speed": [0.0, 0.3]},
}


def resident_bytes() -> int:
    """Memory of this process that is in RAM."""
    fields = Path("/proc/self/statm").read_text(encoding="ascii").split()
    return int(fields[1]) * 4096


def open_files() -> int:
    """File handles of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def haul(steps: int, num_envs: int = NUM_ENVS, points: int = 100) -> dict[str, Any]:
    """Step a batch of environments and watch the process.

    :param steps: control steps of all environments together
    :param num_envs: number of environments
    :param points: how often memory is looked at
    :return: plain data: a row for each look, and what it came to
    """
    loaded = load_policy("parkour")
    overrides = {"randomisation": DISTURBED, "rho": None, "curriculum": None}
    task = task_from_data(apply_overrides(copy.deepcopy(loaded.task_data), overrides, "long_haul"), loaded.task_path)
    env = OgmpVecEnv(task, num_envs, seed=0, threads=1)
    policy = loaded.policy
    policy.set_training_mode(False)
    th.manual_seed(0)
    observation, state, starts = env.reset(), None, np.ones(num_envs, dtype=bool)
    rounds = max(steps // num_envs, points)
    rows: list[dict[str, float]] = []
    episodes, farthest, began = 0, 0.0, time.perf_counter()
    for k in range(1, rounds + 1):
        action, state = policy.predict(observation, state, starts, deterministic=False)
        observation, reward, starts, _ = env.step(action)
        if not (np.isfinite(observation).all() and np.isfinite(reward).all()):
            raise ValueError(f"step {k}: an observation or a reward is not finite.")
        episodes += int(starts.sum())
        farthest = max(farthest, float(env.batch.sim.qpos[:, env.batch.sim.base_qpos].max()))
        if k % (rounds // points) == 0:
            rows.append(
                {"steps": k * num_envs, "episodes": episodes, "resident_bytes": resident_bytes(), "files": open_files()}
            )
    env.close()
    warm = rows[int(WARM_UP * len(rows)) :]
    return {
        "steps": rounds * num_envs,
        "episodes": episodes,
        "farthest_m": farthest,
        "seconds": time.perf_counter() - began,
        "growth": warm[-1]["resident_bytes"] / warm[0]["resident_bytes"] - 1.0,
        "highest": max(row["resident_bytes"] for row in warm) / warm[0]["resident_bytes"] - 1.0,
        "more_files": warm[-1]["files"] - warm[0]["files"],
        "rows": rows,
    }


def main() -> None:
    """Entry point."""
    th.set_num_threads(1)
    found = haul(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
    if len(sys.argv) > 2:
        Path(sys.argv[2]).write_text(json.dumps(found, indent=1), encoding="utf-8")
    print({key: value for key, value in found.items() if key != "rows"})


if __name__ == "__main__":
    main()
