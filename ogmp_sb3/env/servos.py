"""The position servos of a robot's joints, as they act at the joint; what is no such servo is refused."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from ogmp_sb3.config.catalogue import shown_path
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.robot import RobotConfig

FILTERS = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
ONE_AXIS = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
OF_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
ROUNDING = 1e-3  # rad or m by which a pose may lie outside a range, which files often give in degrees


@dataclass(frozen=True)
class Servos:
    """The servo of each joint, in the order of robot.yaml; all arrays have the shape (joints,).

    MuJoCo's actuator sees a joint through a gear ``g``: its control and length are ``g`` times the joint's, its force
    is the joint's torque over ``g``. At the joint this is ``torque = kp (target - position) - kd velocity`` with
    ``g^2`` times the gains of the actuator, held between ``torque_low`` and ``torque_high``.
    """

    ids: np.ndarray
    """actuators"""
    gear: np.ndarray
    """of the actuators; negative where one is mounted the other way round"""
    ctrl: np.ndarray
    """places in ``ctrl``"""
    act: np.ndarray
    """places in ``act`` of the filtered targets; -1 where there is no filter"""
    time_constant: np.ndarray
    """of the filters, s; 0 where there is none"""
    kp: np.ndarray
    """N m/rad"""
    kd: np.ndarray
    """N m s/rad"""
    target_low: np.ndarray
    """least target that is followed (``ctrlrange``, ``actrange``), rad; minus infinity where there is no limit"""
    target_high: np.ndarray
    """greatest target that is followed, rad"""
    torque_low: np.ndarray
    """least torque, the tighter of ``forcerange`` and the joint's ``actuatorfrcrange``, N m"""
    torque_high: np.ndarray
    """greatest torque, N m"""

    def targets(self, ctrl: np.ndarray, act: np.ndarray) -> np.ndarray:
        """The joint positions that servos pull towards: within their range, and behind their filters.

        :param ctrl: shape (n, controls)
        :param act: shape (n, activations)
        :return: shape (n, joints), rad
        """
        targets: np.ndarray = np.clip(ctrl.take(self.ctrl, axis=1) / self.gear, self.target_low, self.target_high)
        filtered = self.act >= 0
        if filtered.any():
            targets[:, filtered] = act.take(self.act[filtered], axis=1) / self.gear[filtered]
        return targets


def read_servos(model: mujoco.MjModel, robot: RobotConfig) -> Servos:
    """The servos of a robot.

    :raises ValueError: if a joint has no position servo of its own, an actuator moves anything else, or the joints or
        servos cannot hold the nominal pose
    """
    joints = np.array([_joint(model, name, robot) for name in robot.joints])
    ids = np.array([_servo(model, joint, robot) for joint in joints])
    for other in np.setdiff1d(np.arange(len(model.actuator_trntype)), ids).tolist():
        raise ValueError(
            f"{robot.mjcf_path}: {_called(model, other)} moves {_moved(model, other)}, "
            f"which is neither among the 'joints' of {robot.path.name or 'robot.yaml'} nor in its 'hold'."
        )
    gear, filtered = model.actuator_gear[ids, 0], model.actuator_actnum[ids] > 0
    limited = model.actuator_ctrllimited[ids].astype(bool)
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL:
        limited[:] = False
    controls = _through(1.0 / gear, model.actuator_ctrlrange[ids], limited)
    states = _through(1.0 / gear, model.actuator_actrange[ids], model.actuator_actlimited[ids].astype(bool))
    target = np.stack([np.maximum(controls[0], states[0]), np.minimum(controls[1], states[1])])
    force = _through(gear, model.actuator_forcerange[ids], model.actuator_forcelimited[ids].astype(bool))
    torque = _through(np.ones(len(ids)), model.jnt_actfrcrange[joints], model.jnt_actfrclimited[joints].astype(bool))
    _check_pose(model, joints, target, robot)
    return Servos(
        ids=ids,
        gear=gear.copy(),
        ctrl=model.actuator_ctrladr[ids].copy(),
        act=np.where(filtered, model.actuator_actadr[ids], -1),
        time_constant=np.where(filtered, model.actuator_dynprm[ids, 0], 0.0),
        kp=gear**2 * model.actuator_gainprm[ids, 0],
        kd=gear**2 * np.abs(model.actuator_biasprm[ids, 2]),
        target_low=target[0],
        target_high=target[1],
        torque_low=np.maximum(force[0], torque[0]),
        torque_high=np.minimum(force[1], torque[1]),
    )


def has_servo(model: mujoco.MjModel, joint: str) -> bool:
    """Whether a joint has one actuator, and that is a position servo."""
    found = joint_actuators(model, model.joint(joint).id)
    return len(found) == 1 and _fault(model, found[0]) is None


def joint_actuators(model: mujoco.MjModel, joint: int) -> list[int]:
    """The actuators that act on a joint."""
    of_it = np.isin(model.actuator_trntype, [int(kind) for kind in OF_JOINTS]) & (model.actuator_trnid[:, 0] == joint)
    return np.flatnonzero(of_it).tolist()


def _through(gear: np.ndarray, ranges: np.ndarray, limited: np.ndarray) -> np.ndarray:
    """Ranges times a gear, low and high, shape (2, joints); infinite where there is no limit."""
    ends = gear[:, None] * np.where(limited[:, None], ranges, (-np.inf, np.inf))
    return np.sort(ends, axis=1).T


def _joint(model: mujoco.MjModel, name: str, robot: RobotConfig) -> int:
    joint = model.joint(name)
    kind = mujoco.mjtJoint(int(joint.type[0]))
    if int(kind) not in ONE_AXIS:
        where = Where(shown_path(robot.path)) / "joints"
        raise ValueError(f"{where}: '{name}' is a {_word(kind)} joint; servos move joints of one axis, hinge or slide.")
    return int(joint.id)


def _servo(model: mujoco.MjModel, joint: int, robot: RobotConfig) -> int:
    """The actuator of a joint."""
    name = model.joint(joint).name
    found = joint_actuators(model, joint)
    must = f'must have a position servo, e.g. <position name="{name}" joint="{name}" kp="30" kv="1"/>'
    if len(found) != 1:
        has = f"has {len(found)}: {', '.join(_called(model, i) for i in found)}" if found else "has no actuator"
        raise ValueError(f"{robot.mjcf_path}: joint '{name}' {must}, and no other actuator; it {has}.")
    fault = _fault(model, found[0])
    if fault:
        raise ValueError(f"{robot.mjcf_path}: joint '{name}' {must}; {_called(model, found[0])} {fault}.")
    return int(found[0])


def _fault(model: mujoco.MjModel, i: int) -> str | None:
    """What keeps an actuator from being a position servo, kp (target - position) - kv velocity."""
    dynamics = mujoco.mjtDyn(int(model.actuator_dyntype[i]))
    gain, form = mujoco.mjtGain(int(model.actuator_gaintype[i])), mujoco.mjtBias(int(model.actuator_biastype[i]))
    kp, bias = model.actuator_gainprm[i, 0], model.actuator_biasprm[i, :3]
    group = int(model.actuator_group[i])
    if model.actuator_plugin[i] >= 0 or model.actuator_ctrlnum[i] != 1:
        return "is of another kind"
    if dynamics not in (mujoco.mjtDyn.mjDYN_NONE, *FILTERS):
        return f"has a state of its own (dyntype {_word(dynamics)})"
    if gain != mujoco.mjtGain.mjGAIN_FIXED:
        return f"has a gain of its own (gaintype {_word(gain)})"
    if form == mujoco.mjtBias.mjBIAS_NONE:
        return "is a motor: its control is a force (biastype none)"
    if form != mujoco.mjtBias.mjBIAS_AFFINE or bias[0] or bias[1] != -kp or bias[2] > 0:
        return f"gives {kp:g} * control + ({bias[0]:g} {bias[1]:+g} * position {bias[2]:+g} * velocity)"
    if not kp > 0:
        return f"has kp = {kp:g}"
    if not model.actuator_gear[i, 0]:
        return "has a gear of 0"
    if model.actuator_delay[i] > 0:
        return f"has a delay of {model.actuator_delay[i]:g} s; latency belongs to 'randomisation' of the task"
    if 0 <= group < 31 and model.opt.disableactuator & (1 << group):
        return f"is in group {group}, which 'actuatorgroupdisable' turns off"
    return None


def _word(kind: mujoco.mjtDyn | mujoco.mjtGain | mujoco.mjtTrn | mujoco.mjtJoint) -> str:
    """MJCF's word for a kind: ``muscle`` for ``mjDYN_MUSCLE``."""
    return str(kind.name).partition("_")[2].lower()


def _called(model: mujoco.MjModel, i: int) -> str:
    return f"actuator '{model.actuator(i).name or i}'"


def _moved(model: mujoco.MjModel, i: int) -> str:
    """What an actuator acts on."""
    kind = mujoco.mjtTrn(int(model.actuator_trntype[i]))
    if kind in (*OF_JOINTS, mujoco.mjtTrn.mjTRN_SO3):
        return f"joint '{model.joint(model.actuator_trnid[i, 0]).name}'"
    return f"a {_word(kind)}"


def _check_pose(model: mujoco.MjModel, joints: np.ndarray, target: np.ndarray, robot: RobotConfig) -> None:
    """Refuse a nominal pose that is out of reach.

    :param target: what servos follow, shape (2, joints), rad
    """
    held = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_LIMIT
    for name, joint, value, low, high in zip(robot.joints, joints, robot.nominal_joints, *target, strict=True):
        where = Where(shown_path(robot.path)) / "nominal_joints"
        unit = "rad" if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE else "m"
        ranges = {"the joint's range": model.jnt_range[joint]} if held and model.jnt_limited[joint] else {}
        ranges["what its servo follows (ctrlrange)"] = np.array([low, high])
        for what, (least, greatest) in ranges.items():
            if not least - ROUNDING <= value <= greatest + ROUNDING:
                degrees = " Is it in degrees?" if unit == "rad" and abs(value) > 2 * np.pi else ""
                raise ValueError(
                    f"{where}: joint '{name}' is at {value:g} {unit}, outside {what}, {least:g} to {greatest:g} {unit} "
                    f"({robot.mjcf}).{degrees}"
                )
        if unit == "rad" and abs(value) > 2 * np.pi:
            raise ValueError(f"{where}: joint '{name}' is at {value:g} rad, over a whole turn. Is it in degrees?")
