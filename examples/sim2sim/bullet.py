"""The exported robot in PyBullet: its bodies from robot.urdf, the ground as boxes, its servos as torques."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
from observe import State

GRAVITY = 9.81  # m/s^2
BOX_DEPTH = 2.0  # m: of a box of the ground that is not higher
GROUND_COLOUR = (0.72, 0.70, 0.66, 1.0)
SOLVER_ITERATIONS = 200
FAST = 1e4  # rad/s: PyBullet holds joints below 100 otherwise


class Client:
    """PyBullet's functions, bound to a simulation of their own. (PyBullet's own BulletClient prints when it starts.)"""

    def __init__(self) -> None:
        self._id = pybullet.connect(pybullet.DIRECT)

    def __getattr__(self, name: str) -> Any:
        return partial(getattr(pybullet, name), physicsClientId=self._id)


class World:
    """One robot on one track.

    :param folder: with robot.urdf and robot.json
    :param info: controller.json
    :param engine_dt: step of the engine, s
    :raises ValueError: if the files do not hold what the controller moves
    """

    def __init__(self, folder: Path, info: dict[str, Any], engine_dt: float) -> None:
        self.bullet = bullet = Client()
        bullet.setGravity(0.0, 0.0, -GRAVITY)
        bullet.setPhysicsEngineParameter(fixedTimeStep=engine_dt, numSolverIterations=SOLVER_ITERATIONS)
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_SELF_COLLISION
        flags |= pybullet.URDF_USE_IMPLICIT_CYLINDER | pybullet.URDF_MAINTAIN_LINK_ORDER
        self.robot = bullet.loadURDF(str(folder / "robot.urdf"), flags=flags)
        self.data = json.loads((folder / "robot.json").read_text(encoding="utf-8"))
        self._dt, self._ground = engine_dt, []
        self._read(info)
        self._set_up_links()
        self._set_up_joints()

    def _read(self, info: dict[str, Any]) -> None:
        """Joints and gains, in the controller's order."""
        joints = [self.bullet.getJointInfo(self.robot, i) for i in range(self.bullet.getNumJoints(self.robot))]
        by_name = {joint[1].decode(): joint for joint in joints}
        missing = [name for name in info["action"]["joints"] if name not in by_name]
        if missing:
            raise ValueError(
                f"robot.urdf has no joint '{missing[0]}', which controller.json moves: run prepare.py again."
            )
        self.link = {self.data["base"]: -1, **{joint[12].decode(): joint[0] for joint in joints}}
        self.joints = [by_name[name][0] for name in info["action"]["joints"]]
        self._all_joints, gains = joints, info["gains"]
        self._kp, self._kd = np.array(gains["kp"]), np.array(gains["kd"])
        ends = [limit if isinstance(limit, list) else [limit and -limit, limit] for limit in gains["torque_limit"]]
        self._torque_limit = np.array(ends, dtype=float)  # nan where there is none
        constant = np.array(gains["time_constant"])
        self._follow = np.where(constant > 0, 1.0 - np.exp(-self._dt / np.maximum(constant, 1e-12)), 1.0)

    def _set_up_links(self) -> None:
        """No damping that the robot does not have, its frictions, and contacts only where MuJoCo has them."""
        bullet, robot = self.bullet, self.robot
        for link in self.link.values():
            bullet.changeDynamics(
                robot, link, linearDamping=0.0, angularDamping=0.0, maxJointVelocity=FAST, restitution=0.0,
                lateralFriction=0.0, spinningFriction=0.0, rollingFriction=0.0,
            )  # fmt: skip
            bullet.setCollisionFilterGroupMask(robot, link, 0, 0)
        for name, its in self.data["links"].items():
            bullet.changeDynamics(robot, self.link[name], lateralFriction=its["friction"])
            for other in its["links"]:
                bullet.setCollisionFilterPair(robot, robot, self.link[name], self.link[other], 1)

    def _set_up_joints(self) -> None:
        """PyBullet's own motors are switched off; what is left of them is the joint's dry friction."""
        for joint in self._all_joints:
            damping, friction = joint[6], joint[7]
            self.bullet.changeDynamics(self.robot, joint[0], jointDamping=damping)
            if joint[2] != pybullet.JOINT_FIXED:
                self.bullet.setJointMotorControl2(
                    self.robot, joint[0], pybullet.VELOCITY_CONTROL, targetVelocity=0.0, force=friction
                )

    def put_ground(self, boxes: np.ndarray) -> None:
        """Replace the ground.

        :param boxes: x0 x1 y0 y1 top, shape (n, 5), m
        """
        bullet = self.bullet
        for body in self._ground:
            bullet.removeBody(body)
        self._ground = []
        for x0, x1, y0, y1, top in boxes:
            depth = max(BOX_DEPTH, top)
            half = [0.5 * (x1 - x0), 0.5 * (y1 - y0), 0.5 * depth]
            shape = bullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
            seen = bullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=half, rgbaColor=GROUND_COLOUR)
            centre = [0.5 * (x0 + x1), 0.5 * (y0 + y1), top - 0.5 * depth]
            body = bullet.createMultiBody(0.0, shape, seen, centre)
            bullet.changeDynamics(body, -1, lateralFriction=self.data["ground_friction"], restitution=0.0)
            for name, its in self.data["links"].items():
                if its["ground"]:
                    bullet.setCollisionFilterPair(self.robot, body, self.link[name], -1, 1)
            self._ground.append(body)

    def put_robot(self, base_pos: Any, base_quat: Any, base_linvel: Any, joint_pos: Any) -> None:
        """Put the robot down: the base's origin in the world, w x y z, m/s without rotation, and joints in rad."""
        offset, turn = self.bullet.getDynamicsInfo(self.robot, -1)[3:5]  # PyBullet speaks of the centre of mass
        pos, quat = self.bullet.multiplyTransforms(base_pos, np.roll(base_quat, -1).tolist(), offset, turn)
        self.bullet.resetBasePositionAndOrientation(self.robot, pos, quat)
        self.bullet.resetBaseVelocity(self.robot, base_linvel, [0.0, 0.0, 0.0])
        for joint, angle in zip(self.joints, joint_pos, strict=True):
            self.bullet.resetJointState(self.robot, joint, angle, 0.0)
        self._filtered, self._last_quat = np.array(joint_pos, dtype=float), np.array(base_quat, dtype=float)

    def state(self) -> State:
        """The robot's state; its quaternion never flips its sign."""
        bullet, robot = self.bullet, self.robot
        pos, xyzw = bullet.getBasePositionAndOrientation(robot)
        linvel, angvel = (np.array(each) for each in bullet.getBaseVelocity(robot))
        back = bullet.invertTransform(*bullet.getDynamicsInfo(robot, -1)[3:5])
        origin, xyzw = (np.array(each) for each in bullet.multiplyTransforms(pos, xyzw, *back))
        quat = np.roll(xyzw, 1)
        quat *= 1.0 if quat @ self._last_quat >= 0.0 else -1.0
        self._last_quat = quat
        linvel = linvel + np.cross(angvel, origin - pos)
        joint_pos, joint_vel = self._joint_states()
        return State(origin, quat, linvel, angvel, joint_pos, joint_vel)

    def _joint_states(self) -> tuple[np.ndarray, np.ndarray]:
        states = self.bullet.getJointStates(self.robot, self.joints)
        return np.array([state[0] for state in states]), np.array([state[1] for state in states])

    def step(self, targets: np.ndarray, seconds: float) -> None:
        """Hold joint targets for a while; the servos act at every step of the engine.

        :param targets: rad
        :param seconds: how long, a whole number of steps of the engine
        """
        low, high = self._torque_limit.T
        for _ in range(round(seconds / self._dt)):
            joint_pos, joint_vel = self._joint_states()
            self._filtered += self._follow * (targets - self._filtered)
            torque = self._kp * (self._filtered - joint_pos) - self._kd * joint_vel
            torque = np.fmin(np.fmax(torque, low), high)
            self.bullet.setJointMotorControlArray(
                self.robot, self.joints, pybullet.TORQUE_CONTROL, forces=torque.tolist()
            )
            self.bullet.stepSimulation()

    def picture(self, width: int, height: int) -> np.ndarray:
        """The robot from its right side, by PyBullet's own renderer, shape (height, width, 3), uint8."""
        x = self.state().pos[0]
        view = self.bullet.computeViewMatrix([x + 0.3, -1.9, 0.8], [x + 0.3, 0.0, 0.4], [0.0, 0.0, 1.0])
        lens = self.bullet.computeProjectionMatrixFOV(50.0, width / height, 0.05, 20.0)
        pixels = self.bullet.getCameraImage(width, height, view, lens, renderer=pybullet.ER_TINY_RENDERER)[2]
        return np.reshape(np.array(pixels, dtype=np.uint8), (height, width, 4))[..., :3]
