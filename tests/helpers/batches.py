"""Many environments in a test: how they are stepped, compared and put where a test wants them."""

from dataclasses import replace
from typing import Any

import numpy as np

from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv, StepResult
from ogmp_sb3.guidance.terrain import height_at

TASKS = sorted(path.stem for path in TASKS_DIR.glob("*.yaml"))
ON_TRACK = [name for name in TASKS if load_task(name).horizon is not None]
SEED = 5
OPEN = {
    "rho": None,
    "min_step_reward": None,
    "terminations": {"fall": None},
    "episode_steps": 100_000,
    "randomisation": None,
}
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


def inside(ranges: dict[str, Any], parameters: dict[str, Any]) -> bool:
    return all(ranges[key].low <= value <= ranges[key].high for key, value in parameters.items())
