"""How far a physics step of some length strays from one of 0.5 ms, and what it costs: ``ogmp-bench physics``."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import Actor, AnyPolicy
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.simulation import Simulation
from ogmp_sb3.guidance.terrain import geom_boxes

REFERENCE_DT = 0.0005  # s
COMPARED_DT = (0.001, 0.002, 0.003, 0.005)  # s
WINDOW = 10  # control steps that are replayed
WINDOWS = 40  # how many are compared
WARM_UP = 20  # control steps before the first window


@dataclass(frozen=True)
class Window:
    """A stretch of a run: where it begins, and the joint targets that follow."""

    state: np.ndarray
    """MuJoCo's integration state"""
    terrain: np.ndarray
    """shape (boxes, 5)"""
    ctrl: np.ndarray
    """shape (WINDOW, joints), rad"""


@dataclass(frozen=True)
class Outcome:
    """What a replay of one window gave."""

    base_pos: np.ndarray
    """at its end, m"""
    energy: float
    """at its end, J"""
    penetration: float
    """deepest of all contacts, m"""
    slip: float
    """mean horizontal speed of contact points of the robot, m/s"""


def record_windows(task: TaskConfig, policy: AnyPolicy | None, num_envs: int = 16) -> list[Window]:
    """Windows of a run in which no episode ends, of a policy or of exploration noise."""
    env = BatchEnv(task, num_envs, seed=0)
    rng = np.random.default_rng(0)
    observation, actor = env.reset(), None if policy is None else Actor(policy, num_envs, env.observation_size)
    windows: list[Window] = []
    open_windows: list[tuple[int, np.ndarray, np.ndarray, list[np.ndarray]]] = []
    for step in range(100_000):
        if step >= WARM_UP and step % WINDOW == 0:
            windows += [Window(s, t, np.array(c)) for _, s, t, c in open_windows]
            if len(windows) >= WINDOWS:
                break
            open_windows = [(row, env.sim.mj.state[row].copy(), env.terrain[row].copy(), []) for row in range(num_envs)]
        if actor is None:
            action = task.action.noise / task.action.scale * rng.standard_normal((num_envs, env.action_size))
        else:
            action = actor.act(observation)
        result = env.step(action)
        for row, _, _, commands in open_windows:
            commands.append(env.sim.ctrl[row].copy())
        observation, ended = result.observation, np.flatnonzero(result.terminated | result.truncated)
        open_windows = [window for window in open_windows if window[0] not in ended]
        if len(ended):
            observation[ended] = env.reset(ended)
            if actor is not None:
                actor.restart(ended)
    return windows[:WINDOWS]


def replay_windows(task: TaskConfig, windows: list[Window], dt: float) -> list[Outcome]:
    """Replay windows with another physics step."""
    model = build_model(task.robot_config, dt, task.track.boxes)
    data = mujoco.MjData(model)
    boxes = slice(model.geom("terrain_0").id, model.geom("terrain_0").id + task.track.boxes)
    return [_replay_one(model, data, boxes, window, round(task.control_dt / dt)) for window in windows]


def _replay_one(model: mujoco.MjModel, data: mujoco.MjData, boxes: slice, window: Window, substeps: int) -> Outcome:
    centre, half = geom_boxes(window.terrain)
    model.geom_pos[boxes], model.geom_size[boxes] = centre, half
    model.geom_rbound[boxes] = np.linalg.norm(half, axis=-1)
    mujoco.mj_resetData(model, data)
    data.qpos[:] = window.state[1 : 1 + model.nq]
    data.qvel[:] = window.state[1 + model.nq : 1 + model.nq + model.nv]
    penetration, slips = 0.0, []
    velocity = np.zeros(6)
    for ctrl in window.ctrl:
        data.ctrl[:] = ctrl
        for _ in range(substeps):
            mujoco.mj_step(model, data)
            for contact in data.contact:
                penetration = max(penetration, -contact.dist)
                body = max(model.geom_bodyid[contact.geom1], model.geom_bodyid[contact.geom2])
                mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
                point = velocity[3:] + np.cross(velocity[:3], contact.pos - data.xpos[body])
                slips.append(float(np.hypot(point[0], point[1])))
    mujoco.mj_forward(model, data)
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    slip = float(np.mean(slips)) if slips else 0.0
    return Outcome(data.qpos[:3].copy(), float(data.energy.sum()), penetration, slip)


def bench_physics(task: TaskConfig, policy: AnyPolicy | None, num_envs: int, repeats: int) -> dict[str, float]:
    """Errors of each physics step against 0.5 ms over 0.3 s, and its cost relative to the task's own."""
    windows = record_windows(task, policy)
    reference = replay_windows(task, windows, REFERENCE_DT)
    numbers: dict[str, float] = {}
    own = _milliseconds(task, windows, num_envs, repeats)
    for dt in COMPARED_DT:
        name = f"{1000 * dt:g}_ms"
        outcomes = replay_windows(task, windows, dt)
        pairs = list(zip(outcomes, reference, strict=True))
        error = [float(np.linalg.norm(a.base_pos - b.base_pos)) for a, b in pairs]
        cost = _milliseconds(replace(task, physics_dt=dt), windows, num_envs, repeats)
        numbers[f"{name}_cost"] = cost / own
        numbers[f"{name}_base_error_mm"] = 1000 * float(np.median(error))
        numbers[f"{name}_energy_error_j"] = float(np.mean([a.energy - b.energy for a, b in pairs]))
        numbers[f"{name}_penetration_mm"] = 1000 * float(np.median([a.penetration for a in outcomes]))
        numbers[f"{name}_slip_mps"] = float(np.mean([a.slip for a in outcomes]))
    numbers["reference_penetration_mm"] = 1000 * float(np.median([a.penetration for a in reference]))
    numbers["reference_slip_mps"] = float(np.mean([a.slip for a in reference]))
    return numbers


def _milliseconds(task: TaskConfig, windows: list[Window], num_envs: int, repeats: int) -> float:
    """Median time of a control step of all simulations, from the windows' states, ms."""
    sim = Simulation(task.robot_config, num_envs, task.physics_dt, task.track.boxes, 0)
    chosen = [windows[i % len(windows)] for i in range(num_envs)]
    sim.set_terrain(np.arange(num_envs), np.stack([w.terrain for w in chosen]))
    times = []
    for _ in range(repeats):
        sim.mj.state[:] = np.stack([w.state for w in chosen])
        begin = time.perf_counter()
        for k in range(WINDOW):
            sim.ctrl[:] = np.stack([w.ctrl[k] for w in chosen])
            sim.mj.step(None, task.substeps)
        times.append((time.perf_counter() - begin) / WINDOW)
    return 1000 * float(np.median(times))
