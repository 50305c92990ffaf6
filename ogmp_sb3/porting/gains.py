"""Gains of position servos for joints that have none, from their torque limits and what they move."""

from __future__ import annotations

import mujoco
import numpy as np

from ogmp_sb3.config.robot import ServoConfig
from ogmp_sb3.env.robot_spec import torque_limit
from ogmp_sb3.env.servos import has_servo, joint_actuators

REACH = 1.0  # rad: the error at which a servo gives all of its torque
DAMPING_RATIO = 0.3  # of the joint with all that it moves, in the air


def servo_gains(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    joints: tuple[str, ...],
    kp: float | None = None,
    kd: float | None = None,
    torque: float | None = None,
) -> ServoConfig:
    """Servos with what is given; else as in the model; else as stiff as their torque allows, and damped.

    By the rule ``kp`` is the torque limit over 1 rad, ``kd`` 0.3 of critical damping of the inertia that the joint
    moves in this pose. Legged robots of today are run at 0.7 to 1.9 rad, and 0.02 to 0.05 of kp in s.

    :param model: the robot
    :param qpos: the pose, shape (nq,)
    :param joints: whose they are
    :param kp: of all of them, N m/rad; None: the model's where it has a servo, else by the rule
    :param kd: N m s/rad, likewise
    :param torque: greatest, N m; None: as in the model
    :raises ValueError: if the model has no limit of a joint's torque, and none is given
    """
    limits = [torque if torque is not None else _limit(model, name) for name in joints]
    own = [model_gains(model, name) for name in joints]
    if torque is None and kp is None:
        for name, limit, has in zip(joints, limits, own, strict=True):
            if has is None and not limit:
                raise ValueError(
                    f"joint '{name}' has no limit of its torque in the model, from which its gains would come: "
                    "give torque=<N m>, or kp=<N m/rad>."
                )
    inertia = _moved_inertia(model, qpos, joints)
    stiff, damped = [], []
    for has, limit, moved in zip(own, limits, inertia, strict=True):
        stiff.append(kp if kp is not None else has[0] if has else _short(float(limit or 0.0) / REACH))
        by_rule = _short(2.0 * DAMPING_RATIO * float(np.sqrt(stiff[-1] * moved)))
        damped.append(kd if kd is not None else has[1] if has else by_rule)
    known = all(limit is not None for limit in limits)
    return ServoConfig(
        kp=tuple(stiff),
        kd=tuple(damped),
        torque=tuple(float(limit or 0.0) for limit in limits) if known else None,
    )


def model_gains(model: mujoco.MjModel, joint: str) -> tuple[float, float] | None:
    """kp and kd of the position servo that a joint has in the model, as they act at the joint; None: it has none."""
    if not has_servo(model, joint):
        return None
    (i,) = joint_actuators(model, model.joint(joint).id)
    gear = model.actuator_gear[i, 0] ** 2
    return float(gear * model.actuator_gainprm[i, 0]), float(-gear * model.actuator_biasprm[i, 2] + 0.0)


def _limit(model: mujoco.MjModel, name: str) -> float | None:
    """The tighter of a joint's and its actuator's torque limit, N m."""
    joint, limits = model.joint(name).id, []
    if model.jnt_actfrclimited[joint]:
        limits.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    driven = torque_limit(model, name)
    return min([*limits, *([] if driven is None else [driven])], default=None)


def _moved_inertia(model: mujoco.MjModel, qpos: np.ndarray, joints: tuple[str, ...]) -> list[float]:
    """Inertia about each joint of all that it moves, with its rotor, kg m^2."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return [float(mass[dof, dof]) for dof in (model.joint(name).dofadr[0] for name in joints)]


def _short(value: float) -> float:
    """A number of two digits, as people give gains."""
    return float(f"{value:.2g}")
