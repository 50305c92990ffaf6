"""Control steps in which a simulation failed: captured as they began, and replayed to see why.

A file holds arrays and plain data as safetensors: the state before the step, the action, what reached the robot on the
way, the terrain, the robot as it was varied, the task, and where all this comes from. Physics are deterministic, so the
step fails again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.events import Events
from ogmp_sb3.env.simulation import Simulation

REASONS = {
    "mjWARN_INERTIA": "the inertia matrix is close to singular",
    "mjWARN_CONTACTFULL": "too many contacts",
    "mjWARN_CNSTRFULL": "too many constraints",
    "mjWARN_BADQPOS": "a position is not finite or huge",
    "mjWARN_BADQVEL": "a velocity is not finite or huge",
    "mjWARN_BADQACC": "an acceleration is not finite or huge",
    "mjWARN_BADCTRL": "a control is not finite or huge",
}


@dataclass(frozen=True)
class UnstableStep:
    """A control step in which one simulation failed."""

    state: np.ndarray
    """MuJoCo's integration state before it, with the controls, shape (size,)"""
    terrain: np.ndarray
    """shape (boxes, 5)"""
    action: np.ndarray
    """as the policy gave it, shape (joints,)"""
    targets: Events
    """joint targets that reached the servos after the first physics step, rad"""
    kicks: Events
    """changes of the base's horizontal velocity after the first physics step, m/s"""
    varied: dict[str, np.ndarray]
    """how the robot was changed, as :meth:`~ogmp_sb3.env.simulation.Simulation.vary` takes it, without the row"""
    substeps: int
    """physics steps of the control step"""
    info: dict[str, Any]
    """plain data: environment, control step, curriculum level, modes so far; and what the one who saves it adds"""


@dataclass(frozen=True)
class Replay:
    """The outcome of replaying a failed step."""

    substeps: int
    """physics steps of the control step"""
    failed_at: int | None
    """the first physics step behind which the simulation had failed, from 1; None: it did not"""
    reasons: list[str]
    """what MuJoCo said, or what is not finite"""
    height: float
    """of the base before the step, m"""
    fastest: tuple[str, float]
    """the joint that moved fastest before the step, and how fast, rad/s"""


def capture(env: BatchEnv, row: int, action: np.ndarray) -> UnstableStep:
    """The last step of an environment, of which nothing has been reset yet.

    :param action: shape (joints,)
    """
    targets, kicks = env.sim.events
    return UnstableStep(
        state=env.sim.before[row].copy(),
        terrain=env.terrain[row].copy(),
        action=np.array(action, dtype=float),
        targets=targets.later(row),
        kicks=kicks.later(row),
        varied={name: values[0].copy() for name, values in env.disturbances.varied(np.array([row])).items()},
        substeps=int(np.broadcast_to(env.sim.substeps, env.num_envs)[row]),
        info={
            "environment": row,
            "control_step": int(env.step_count[row]),
            "level": float(env.level[row]),
            "modes": [[call.name, call.parameters] for call in env.modes[row]],
        },
    )


def replay(step: UnstableStep, task: TaskConfig) -> Replay:
    """Replay a failed step, one physics step after another.

    :raises ValueError: if the step is not of this task's robot and track
    """
    sim = Simulation(task.robot_config, 1, task.physics_dt, task.track.boxes, threads=1)
    row, joints = np.array([0]), task.robot_config.joints
    for name, array, shape in (
        ("state", step.state, sim.mj.state[0].shape),
        ("terrain", step.terrain, (task.track.boxes, 5)),
        ("action", step.action, (len(joints),)),
        ("targets", step.targets.values, (len(step.targets.at), len(joints))),
        ("kicks", step.kicks.values, (len(step.kicks.at), 2)),
    ):
        if array.shape != shape:
            raise ValueError(f"'{name}' has the shape {array.shape}; the task's robot and track need {shape}.")
    sim.vary(row, {name: values[None] for name, values in step.varied.items()})
    sim.set_terrain(row, step.terrain[None])
    sim.place(row, np.zeros((1, 3)), np.array(task.robot_config.nominal_joints))
    sim.mj.state[0] = step.state
    speeds = np.abs(np.nan_to_num(sim.qvel[0, sim.joint_qvel], nan=np.inf))
    fastest = int(speeds.argmax())
    height = float(sim.qpos[0, sim.base_qpos + 2])
    failed_at, reasons = None, []
    for substep in range(1, step.substeps + 1):
        sim.step(None, 1, step.targets.at_once(substep - 1), step.kicks.at_once(substep - 1))
        if sim.unstable()[0]:
            failed_at, reasons = substep, _reasons(sim)
            break
    return Replay(step.substeps, failed_at, reasons, height, (joints[fastest], float(speeds[fastest])))


def _reasons(sim: Simulation) -> list[str]:
    """What is wrong, in words, with the joint it is about."""
    reasons = []
    for kind, index in sim.complaints(0):
        about = ""
        if kind in ("mjWARN_BADQVEL", "mjWARN_BADQACC"):
            about = f" ({sim.model.joint(int(sim.model.dof_jntid[index])).name or 'base'})"
        reasons.append(f"{REASONS.get(kind, kind)}{about}")
    return reasons or ["the state is not finite"]
