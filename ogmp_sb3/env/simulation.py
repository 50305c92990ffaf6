"""Batched MuJoCo: state arrays in, state arrays out. The only module that steps physics."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.guidance.terrain import geom_boxes

# We count, report and keep simulations that fail; MuJoCo would print each and leave MUJOCO_LOG.TXT in the user's
# directory.
_QUIET = mujoco.MjLogConfig()
_QUIET.logto_console = _QUIET.logto_file = False


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
        self.qacc = self.mj.bind("qacc")
        self._sensors = self.mj.bind("sensordata")

        model = self.model
        free = model.body(robot.base).jntadr[0]
        if free < 0 or model.jnt_type[free] != mujoco.mjtJoint.mjJNT_FREE:
            raise ValueError(f"{robot.mjcf_path}: the base '{robot.base}' must have a free joint.")
        self.base_qpos = int(model.jnt_qposadr[free])
        self.base_qvel = int(model.jnt_dofadr[free])
        self.joint_qpos = np.array([model.joint(name).qposadr[0] for name in robot.joints])
        self.joint_qvel = np.array([model.joint(name).dofadr[0] for name in robot.joints])
        self.actuators = np.array([model.actuator(name).id for name in robot.joints])
        self.kp = model.actuator_gainprm[self.actuators, 0].copy()
        self.kd = -model.actuator_biasprm[self.actuators, 2].copy()
        self.gain_factor = np.ones((num_envs, 1))  # on both gains, see vary
        self._body_contacts = self._contact_addresses(robot)

        self._first_box = model.geom("terrain_0").id
        self._boxes = slice(self._first_box, self._first_box + terrain_boxes)
        self._geom_pos = self.mj.expand("geom_pos")
        self._geom_size = self.mj.expand("geom_size")
        self._geom_rbound = self.mj.expand("geom_rbound")
        self._warnings_seen = self._warning_counts()
        self._failed = np.zeros(num_envs, dtype=bool)  # MuJoCo gave up in the last step
        self.before = self.mj.state.copy()
        """states, with their controls, as they were before the last step, shape (num_envs, size)"""

    def _contact_addresses(self, robot: RobotConfig) -> np.ndarray:
        """Addresses of the contact sensors of all bodies but the feet."""
        sensors = [self.model.sensor(i) for i in range(self.model.nsensor)]
        contacts = [s for s in sensors if s.type[0] == mujoco.mjtSensor.mjSENS_CONTACT]
        if not contacts:
            raise ValueError(f"{robot.mjcf_path}: no contact sensors; each body that may touch the ground needs one.")
        bodies = {s.id: self.model.body(int(self.model.sensor_objid[s.id])).name for s in contacts}
        colliding = (self.model.geom_contype | self.model.geom_conaffinity) & 1 > 0  # with the terrain
        for body in dict.fromkeys(self.model.geom_bodyid[colliding & (self.model.geom_bodyid > 0)].tolist()):
            name = self.model.body(body).name
            if name not in {*bodies.values(), *robot.feet}:
                raise ValueError(
                    f"{robot.mjcf_path}: body '{name or body}' can touch the ground but has no contact sensor, e.g. "
                    f'<contact name="{name}_contact" body1="{name}" body2="world" num="1" data="found"/>.'
                )
        return np.array([s.adr[0] for s in contacts if bodies[s.id] not in robot.feet], dtype=int)

    def set_terrain(self, rows: np.ndarray, terrain: np.ndarray) -> None:
        """Move the boxes of some simulations.

        :param rows: simulations, shape (n,), int
        :param terrain: shape (n, boxes, 5)
        """
        centre, half = geom_boxes(terrain)
        self._geom_pos[rows, self._boxes] = centre
        self._geom_size[rows, self._boxes] = half
        self._geom_rbound[rows, self._boxes] = np.linalg.norm(half, axis=-1)

    def vary(
        self,
        rows: np.ndarray,
        mass: np.ndarray | None = None,
        friction: np.ndarray | None = None,
        gains: np.ndarray | None = None,
    ) -> None:
        """Change the robots of some simulations; what is None is left alone.

        :param rows: simulations, shape (n,), int
        :param mass: factor on mass and inertia of every body, shape (n,)
        :param friction: sliding friction coefficient of every geom, shape (n,)
        :param gains: factor on kp and kd of every servo, shape (n,)
        """
        model, mj = self.model, self.mj
        if mass is not None:
            mj.expand("body_mass")[rows] = mass[:, None] * model.body_mass
            mj.expand("body_inertia")[rows] = mass[:, None, None] * model.body_inertia
            mj.set_const(rows)
        if friction is not None:
            mj.expand("geom_friction")[rows, :, 0] = friction[:, None]
        if gains is not None:
            self.gain_factor[rows] = gains[:, None]
            servos = rows[:, None], self.actuators
            mj.expand("actuator_gainprm")[*servos, 0] = gains[:, None] * self.kp
            mj.expand("actuator_biasprm")[*servos, 1] = -gains[:, None] * self.kp
            mj.expand("actuator_biasprm")[*servos, 2] = -gains[:, None] * self.kd

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
        """Put robots down upright, with the controls at their joint positions.

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
        self.ctrl[rows[:, None], self.actuators] = joint_pos
        self._warnings_seen[rows] = self._warning_counts()[rows]
        self._failed[rows] = False

    def step(self, rows: np.ndarray | None, substeps: int) -> None:
        """Advance simulations by physics steps.

        :param rows: which, or None for all
        :param substeps: physics steps
        """
        np.copyto(self.before, self.mj.state)
        logging = mujoco.MjLogConfig.get()
        _QUIET.set()
        try:
            self.mj.step(rows, substeps)
        except SimulationError as error:
            self._failed[error.ids] = True
        finally:
            logging.set()

    def torque(self, rows: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
        """PD torque before the limits, shape (n, joints), N m.

        :param rows: simulations, shape (n,), int
        :param joint_pos: shape (n, joints), rad
        :param joint_vel: shape (n, joints), rad/s
        """
        error = self.ctrl[rows].take(self.actuators, axis=1) - joint_pos
        return self.gain_factor[rows] * (self.kp * error - self.kd * joint_vel)  # type: ignore[no-any-return]

    def body_contact(self) -> np.ndarray:
        """Whether anything but a foot touches the terrain, shape (num_envs,), bool."""
        touching: np.ndarray = (self._sensors[:, self._body_contacts] > 0).any(axis=1)
        return touching

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
