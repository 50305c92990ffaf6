"""Batched MuJoCo: state arrays in, state arrays out. The only module that steps physics."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.events import NOTHING, Events
from ogmp_sb3.env.ground_contacts import body_contact_addresses
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.servos import read_servos
from ogmp_sb3.guidance.terrain import geom_boxes

# We count, report and keep simulations that fail; MuJoCo would print each and leave MUJOCO_LOG.TXT in the user's
# directory.
_QUIET = mujoco.MjLogConfig()
_QUIET.logto_console = _QUIET.logto_file = False
GRAVITY = "opt.gravity"
SETS_CONSTANTS = frozenset(mujoco.MjModel._setconst_inputs)  # fields that others follow from


class Simulation:
    """Many simulations of one robot on boxes.

    Arrays are live views, one row a simulation. Sensors and accelerations lag one physics step behind the state.

    :param robot: the robot
    :param num_envs: number of simulations
    :param physics_dt: physics step, s
    :param terrain_boxes: boxes of each simulation
    :param threads: physics threads, 0 for one per CPU
    """

    def __init__(self, robot: RobotConfig, num_envs: int, physics_dt: float, terrain_boxes: int, threads: int) -> None:
        self.model, self.threads = build_model(robot, physics_dt, terrain_boxes), threads
        self.mj = Batch(self.model, nsim=num_envs, nthread=threads)
        self.qpos = self.mj.bind("qpos")
        self.qvel = self.mj.bind("qvel")
        self.ctrl = self.mj.bind("ctrl")
        self._act = self.mj.bind("act")
        self.qacc = self.mj.bind("qacc")
        self._sensors = self.mj.bind("sensordata")

        model = self.model
        free = model.body(robot.base).jntadr[0]
        self.base_qpos = int(model.jnt_qposadr[free])
        self.base_qvel = int(model.jnt_dofadr[free])
        self.joint_qpos = np.array([model.joint(name).qposadr[0] for name in robot.joints])
        self.joint_qvel = np.array([model.joint(name).dofadr[0] for name in robot.joints])
        self.servos = read_servos(model, robot)
        self.gain_factor = np.ones((num_envs, len(robot.joints)))  # on both gains, see vary
        self._base, self._force = model.body(robot.base).id, np.zeros((num_envs, 3))  # on the base, see vary
        self._applied = self.mj.bind("xfrc_applied")
        self.down = np.tile(_direction(model.opt.gravity), (num_envs, 1))
        """direction of gravity, shape (num_envs, 3)"""
        self._body_contacts = body_contact_addresses(model, robot)

        self._first_box = model.geom("terrain_0").id
        self._boxes = slice(self._first_box, self._first_box + terrain_boxes)
        self._raised = np.zeros((num_envs, terrain_boxes))  # how much higher the boxes are, see vary
        self._geom_pos = self.mj.expand("geom_pos")
        self._geom_size = self.mj.expand("geom_size")
        self._geom_rbound = self.mj.expand("geom_rbound")
        self._warnings_seen = self._warning_counts()
        self._failed = np.zeros(num_envs, dtype=bool)  # MuJoCo gave up in the last step
        self.before = self.mj.state.copy()
        """states, with their controls, as they were before the last step, shape (num_envs, size)"""
        self.events = NOTHING, NOTHING
        """joint targets and kicks of the last step, as :meth:`step` took them"""
        self.substeps: int | np.ndarray = 0
        """physics steps of the last step, as :meth:`step` took them"""
        self.sensed_at: np.ndarray | None = None
        """behind which of them :attr:`sensed` was read, shape (num_envs,), int; None: it was not"""
        self.sensed = {"qpos": self.qpos.copy(), "qvel": self.qvel.copy()}
        """positions and velocities when :meth:`step` was told to read them"""

    def set_terrain(self, rows: np.ndarray, terrain: np.ndarray) -> None:
        """Move the boxes of some simulations.

        :param rows: simulations, shape (n,), int
        :param terrain: shape (n, boxes, 5)
        """
        centre, half = geom_boxes(terrain)
        centre[..., 2] += self._raised[rows]
        self._geom_pos[rows, self._boxes] = centre
        self._geom_size[rows, self._boxes] = half
        self._geom_rbound[rows, self._boxes] = np.linalg.norm(half, axis=-1)

    def vary(self, rows: np.ndarray, varied: Mapping[str, np.ndarray]) -> None:
        """Change the robots of some simulations.

        :param rows: simulations, shape (n,), int
        :param varied: factors on kp and kd of the servos, ``gains`` (n, joints); a steady force on the base, ``force``
            (n, 3), N; how much higher each box is than :meth:`set_terrain` says, ``ground`` (n, boxes), m; anything
            else is a field of the model, shapes (n, ...)
        """
        model, ids, fields = self.model, self.servos.ids, dict(varied)
        if "gains" in fields:
            self.gain_factor[rows] = gains = fields.pop("gains")
            for name in ("actuator_gainprm", "actuator_biasprm"):
                self.mj.expand(name)[rows[:, None], ids] = gains[..., None] * getattr(model, name)[ids]
        self._force[rows] = fields.pop("force", 0.0)
        self._raised[rows] = fields.pop("ground", 0.0)
        for name, values in fields.items():
            self.mj.expand(name)[rows] = values
        if GRAVITY in fields:
            self.down[rows] = _direction(fields[GRAVITY])
        if any(name in SETS_CONSTANTS or name.startswith("opt.") for name in fields):
            self.mj.set_const(rows)

    def push(self, rows: np.ndarray, velocity: np.ndarray) -> None:
        """Change the horizontal velocity of some robots at once.

        :param rows: simulations, shape (n,), int
        :param velocity: change, world frame, shape (n, 2), m/s
        """
        self.qvel[rows, self.base_qvel : self.base_qvel + 2] += velocity

    def place(
        self,
        rows: np.ndarray,
        base_pos: np.ndarray,
        joint_pos: np.ndarray,
        yaw: np.ndarray | float = 0.0,
        velocity: np.ndarray | float = 0.0,
    ) -> None:
        """Put robots down upright, with the controls and what filters them at their joint positions.

        :param rows: simulations, shape (n,), int
        :param base_pos: shape (n, 3), m
        :param joint_pos: shape (joints,) or (n, joints), rad
        :param yaw: heading, shape (n,), rad
        :param velocity: of the base, world frame, shape (n, 3), m/s
        """
        self.mj.reset(rows, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self.qpos[rows[:, None], np.arange(self.base_qpos, self.base_qpos + 3)] = base_pos
        self.qpos[rows[:, None], np.arange(self.base_qpos + 3, self.base_qpos + 7)] = 0.0
        self.qpos[rows, self.base_qpos + 3] = np.cos(0.5 * np.asarray(yaw))
        self.qpos[rows, self.base_qpos + 6] = np.sin(0.5 * np.asarray(yaw))
        self.qvel[rows[:, None], np.arange(self.base_qvel, self.base_qvel + 3)] = velocity
        self.qpos[rows[:, None], self.joint_qpos] = joint_pos
        self.set_targets(joint_pos, rows)
        filtered = self.servos.act >= 0
        self._act[rows[:, None], self.servos.act[filtered]] = (joint_pos * self.servos.gear)[..., filtered]
        self.apply_force(rows)
        for name in ("qpos", "qvel"):
            self.sensed[name][rows] = getattr(self, name)[rows]
        self._warnings_seen[rows] = self._warning_counts()[rows]
        self._failed[rows] = False

    def apply_force(self, rows: np.ndarray) -> None:
        """Let the steady force of :meth:`vary` act on the base of some robots; :meth:`place` does so too."""
        self._applied[rows, self._base, :3] = self._force[rows]

    def set_targets(self, joint_pos: np.ndarray, rows: np.ndarray | None = None) -> None:
        """Tell the servos where to go.

        :param joint_pos: shape (n, joints) or (joints,), rad
        :param rows: simulations, shape (n,), int, or None for all
        """
        rows = np.arange(len(self.ctrl)) if rows is None else rows
        self.ctrl[rows[:, None], self.servos.ctrl] = joint_pos * self.servos.gear

    def step(
        self,
        rows: np.ndarray | None,
        substeps: int | np.ndarray,
        targets: Events = NOTHING,
        kicks: Events = NOTHING,
        sensed_at: np.ndarray | None = None,
    ) -> None:
        """Advance simulations by physics steps, in one call from each event to the next.

        :param rows: which, or None for all
        :param substeps: physics steps, one number or shape (num_envs,)
        :param targets: joint targets that reach the servos, rad
        :param kicks: changes of the base's horizontal velocity, world frame, m/s
        :param sensed_at: behind which physics step :attr:`sensed` is read, shape (num_envs,), int; None: it is not
        """
        self.events, self.substeps, self.sensed_at = (targets, kicks), substeps, sensed_at
        self._receive(0)
        np.copyto(self.before, self.mj.state)
        self._read(0)
        most = int(np.max(substeps))
        stops = {0, *targets.at.tolist(), *kicks.at.tolist(), *np.ravel(substeps).tolist()}
        stops |= set() if sensed_at is None else set(sensed_at.tolist())
        logging = mujoco.MjLogConfig.get()
        _QUIET.set()
        try:
            for begin, end in pairwise(sorted(stop for stop in stops if 0 <= stop <= most)):
                if begin > 0:
                    self._receive(begin)
                self._run(rows if np.ndim(substeps) == 0 else _still_running(rows, substeps, begin), end - begin)
                self._read(end)
        finally:
            logging.set()

    def _receive(self, at: int) -> None:
        """Let the events of a physics step happen."""
        targets, kicks = self.events
        rows, values = targets.due(at)
        if len(rows):
            self.set_targets(values, rows)
        rows, values = kicks.due(at)
        if len(rows):
            self.push(rows, values)

    def _read(self, at: int) -> None:
        """Read the sensors that are read behind a physics step."""
        if self.sensed_at is not None:
            rows = np.flatnonzero(self.sensed_at == at)
            self.sensed["qpos"][rows], self.sensed["qvel"][rows] = self.qpos[rows], self.qvel[rows]

    def _run(self, rows: np.ndarray | None, substeps: int) -> None:
        if rows is not None and not len(rows):
            return
        try:
            self.mj.step(rows, substeps)
        except SimulationError as error:
            self._failed[error.ids] = True

    def torque(self, rows: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
        """PD torque before the limits, shape (n, joints), N m.

        :param rows: simulations, shape (n,), int
        :param joint_pos: shape (n, joints), rad
        :param joint_vel: shape (n, joints), rad/s
        """
        servos = self.servos
        error = servos.targets(self.ctrl[rows], self._act[rows]) - joint_pos
        return self.gain_factor[rows] * (servos.kp * error - servos.kd * joint_vel)  # type: ignore[no-any-return]

    def body_contact(self) -> np.ndarray:
        """Whether anything but a foot touches the terrain, shape (num_envs,), bool."""
        touching: np.ndarray = (self._sensors[:, self._body_contacts] > 0).any(axis=1)
        return touching

    def contacts(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the robot of a simulation touches the ground now, and the forces on it.

        They are computed anew, which takes a millisecond or more: for who looks at one simulation.

        :return: points, shape (n, 3), m, and forces, shape (n, 3), N, both in the world frame
        """
        model, data = self.mj.get_model(row), self.mj.get_data(row)
        mujoco.mj_forward(model, data)
        contact, wrench = data.contact, np.zeros(6)
        forces = np.zeros((data.ncon, 3))
        for i in range(data.ncon):
            mujoco.mj_contactForce(model, data, i, wrench)
            forces[i] = contact.frame[i].reshape(3, 3).T @ wrench[:3]  # on the second geom
        bodies = model.geom_bodyid[contact.geom.reshape(-1, 2)]  # (n, 2); the world is 0
        forces[bodies[:, 1] == 0] *= -1.0
        grounded = (bodies == 0).any(axis=1)
        return contact.pos[grounded], forces[grounded]

    def unstable(self) -> np.ndarray:
        """Simulations that MuJoCo failed in or warned about since they were placed, or that are not finite.

        :return: shape (num_envs,), bool
        """
        finite = np.isfinite(self.qpos).all(axis=1) & np.isfinite(self.qvel).all(axis=1)
        unstable: np.ndarray = ~finite | self._failed | (self._warning_counts() != self._warnings_seen)
        return unstable

    def complaints(self, row: int) -> list[tuple[str, int]]:
        """What MuJoCo warned of in a simulation since it was placed: the kind, and the index it is about."""
        warnings = np.asarray(self.mj.warning)[row]  # (kinds, 2): index, count
        error = [(self.mj.error(row), 0)] if self._failed[row] else []
        return error + [
            (mujoco.mjtWarning(kind).name, int(warnings[kind, 0])) for kind in np.flatnonzero(warnings[:, 1])
        ]

    def _warning_counts(self) -> np.ndarray:
        counts: np.ndarray = np.asarray(self.mj.warning).reshape(len(self.qpos), -1).sum(axis=1)
        return counts


def _direction(vectors: np.ndarray) -> np.ndarray:
    """Vectors at length 1; where there is no gravity, 0."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    directions: np.ndarray = vectors / np.where(length > 0.0, length, 1.0)
    return directions


def _still_running(rows: np.ndarray | None, substeps: Any, begun: int) -> np.ndarray:
    """Those of the rows, or of all, that go on behind a number of physics steps."""
    rows = np.arange(len(substeps)) if rows is None else rows
    running: np.ndarray = rows[substeps[rows] > begun]
    return running
