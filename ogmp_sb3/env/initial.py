"""How robots begin episodes: where they are put down, in which pose, how fast, and never in the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.config.variation import InitialConfig
from ogmp_sb3.env.ground_contacts import geom_extents, ground_geoms
from ogmp_sb3.env.simulation import Simulation
from ogmp_sb3.guidance.terrain import NOTHING, TOP, X0, X1, Y0, Y1

FLAT = np.array([[-10.0, 10.0, -10.0, 10.0, 0.0]])  # a terrain, m


@dataclass(frozen=True)
class Start:
    """How some robots begin."""

    xy: np.ndarray
    """base, shape (n, 2), m"""
    yaw: np.ndarray
    """heading, shape (n,), rad"""
    joint_pos: np.ndarray
    """shape (n, joints), rad"""
    velocity: np.ndarray
    """of the base, world frame, shape (n, 3), m/s"""


class InitialStates:
    """Draws how robots begin, and puts them down.

    The generators are apart from those of the tracks, so that tracks are the same with and without.

    :param config: what is drawn; None: all robots begin alike
    :param robot: the robot
    :param sim: where it is put down
    """

    def __init__(self, config: InitialConfig | None, robot: RobotConfig, sim: Simulation) -> None:
        self.config = config
        self._sim, self._height, self._nominal = sim, robot.nominal_height, np.array(robot.nominal_joints)
        self._limits = _joint_limits(sim.model, robot.joints)
        self._rng = [np.random.default_rng() for _ in range(len(sim.qpos))]
        self._data = mujoco.MjData(sim.model)  # to look at poses; to make one takes longer than all else of a reset
        self._usual_depth = 0.0 if config is None else max(0.0, depth_in_ground(self._data, self._nominal_qpos(), FLAT))

    def seed_row(self, row: int, rng: np.random.Generator) -> None:
        """Give an environment a generator spawned from its own one."""
        self._rng[row] = rng.spawn(1)[0]

    def draw(self, rows: np.ndarray) -> Start:
        """Draw anew for the next episodes of some environments.

        :param rows: shape (n,), int
        """
        count, joints = len(rows), len(self._nominal)
        xy, yaw, velocity = np.zeros((count, 2)), np.zeros(count), np.zeros((count, 3))
        joint_pos = np.tile(self._nominal, (count, 1))
        config = self.config
        for i, row in enumerate(rows if config is not None else ()):
            assert config is not None
            rng = self._rng[row]
            xy[i] = _uniform(rng, config.x), _uniform(rng, config.y)
            yaw[i] = _uniform(rng, config.yaw)
            if config.joint_pos is not None:
                moved = self._nominal + rng.uniform(config.joint_pos.low, config.joint_pos.high, joints)
                joint_pos[i] = np.clip(moved, self._limits[:, 0], self._limits[:, 1])
            if config.velocity is not None:
                velocity[i] = rng.uniform(config.velocity.low, config.velocity.high, 3)
        return Start(xy, yaw, joint_pos, velocity)

    def put_down(self, rows: np.ndarray, start: Start, ground: np.ndarray, terrain: np.ndarray) -> None:
        """Put robots down at their nominal height, or higher, so that none is deeper in the ground than usual.

        :param rows: shape (n,), int
        :param start: how they begin
        :param ground: height of the ground at the start of their tracks, shape (n,), m
        :param terrain: shape (n, boxes, 5)
        """
        sim = self._sim
        base = np.column_stack([start.xy, ground + self._height])
        sim.place(rows, base, start.joint_pos, start.yaw, start.velocity)
        for row, boxes in zip(rows, terrain, strict=True) if self.config is not None else ():
            depth = depth_in_ground(self._data, sim.qpos[row], boxes)
            sim.qpos[row, sim.base_qpos + 2] += max(0.0, depth - self._usual_depth)

    def _nominal_qpos(self) -> np.ndarray:
        """Of a robot in its nominal pose, at its nominal height."""
        sim = self._sim
        qpos: np.ndarray = sim.model.qpos0.copy()
        qpos[sim.base_qpos : sim.base_qpos + 7] = 0.0, 0.0, self._height, 1.0, 0.0, 0.0, 0.0
        qpos[sim.joint_qpos] = self._nominal
        return qpos

    def arrays(self) -> dict[str, np.ndarray]:
        """Nothing: what was drawn is in the robots' states."""
        return {}

    def plain(self) -> dict[str, Any]:
        """The generators, if anything is drawn."""
        return {} if self.config is None else {"initial": [rng.bit_generator.state for rng in self._rng]}

    def set_plain(self, plain: Mapping[str, Any]) -> None:
        """Put back what :meth:`plain` gave."""
        for rng, state in zip(self._rng if self.config else (), plain.get("initial", ()), strict=True):
            rng.bit_generator.state = state


def _uniform(rng: np.random.Generator, range_: Range | None) -> float:
    return 0.0 if range_ is None else float(rng.uniform(range_.low, range_.high))


def _joint_limits(model: mujoco.MjModel, joints: tuple[str, ...]) -> np.ndarray:
    """Least and greatest position of each joint, infinite without a limit, shape (joints, 2), rad."""
    ids = [model.joint(name).id for name in joints]
    limits: np.ndarray = np.where(model.jnt_limited[ids, None] > 0, model.jnt_range[ids], (-np.inf, np.inf))
    return limits


def depth_in_ground(data: mujoco.MjData, qpos: np.ndarray, terrain: np.ndarray) -> float:
    """How far a robot would have to be raised to touch the ground from above; below 0 for one that is over it.

    What meets the ground counts by the box around it, so this is somewhat too much for round shapes (not for meshes).

    :param data: of the robot's model, to work in
    :param qpos: shape (nq,)
    :param terrain: shape (boxes, 5)
    :return: m
    """
    model = data.model
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    geoms = ground_geoms(model)
    low, high = (ends[:, None] for ends in geom_extents(data, geoms))  # (geoms, 1, 3)
    under = (terrain[:, X0] < high[..., 0]) & (low[..., 0] < terrain[:, X1])
    under &= (terrain[:, Y0] < high[..., 1]) & (low[..., 1] < terrain[:, Y1])
    ground = np.where(under, terrain[:, TOP], NOTHING).max(axis=1)  # (geoms,)
    return float((ground - low[:, 0, 2]).max())
