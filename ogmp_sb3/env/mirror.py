"""Mirror images across the plane y = 0: of a robot's joints, of what terms see, and so of observations and actions.

Nothing is declared. The joints are paired by where they are in the model, and the mirror image of an observation is
what its terms make of the mirror image of what they see.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.robot_check import nominal_data
from ogmp_sb3.env.terms import bind
from ogmp_sb3.env.view import EnvView, srb_state
from ogmp_sb3.guidance.rotations import rpy_to_quat
from ogmp_sb3.guidance.srb import AXIAL_MIRROR, POLAR_MIRROR, STATE_MIRROR, STATE_SIZE, deviation
from ogmp_sb3.guidance.terrain import Y0, Y1, height_at

QUAT_MIRROR = np.array([1.0, -1.0, 1.0, -1.0])
NEAR = 0.02  # m: how far a joint may be from the mirror image of its counterpart
ALIGNED = 0.99  # cosine between the axes
PROBES = 64  # views that tell which value of an observation mirrors which
MIRROR_POSES = 10  # that tell how symmetric a robot is


@dataclass(frozen=True)
class Mirror:
    """The mirror image of a vector: ``image[i] = sign[i] * vector[source[i]]``."""

    source: np.ndarray
    """shape (size,), int"""
    sign: np.ndarray
    """1 or -1, shape (size,)"""

    def __call__(self, vectors: np.ndarray) -> np.ndarray:
        """The images of vectors, shape (..., size)."""
        image: np.ndarray = self.sign * vectors[..., self.source]
        return image


class Mirrors(NamedTuple):
    """The mirror images of what a learner handles."""

    observation: Mirror
    """of an observation"""
    action: Mirror
    """of an action"""
    critic: Mirror
    """of an observation and what only the critic sees behind it"""


def mirrors(env: BatchEnv) -> Mirrors:
    """The mirror images of observations and actions of some environments.

    :raises ValueError: if the robot, or an observation, has none
    """
    task = env.task
    joints = joint_mirror(task.robot_config, env.sim.model)
    view, weights = env.view(), np.array(task.bound_weights)
    observation, alone = (
        observation_mirror(bind(registry.observations, terms), view, weights, joints, task.latent_of_both_sides)
        for terms in (task.observations, task.critic_observations)
    )
    critic = Mirror(
        np.concatenate([observation.source, len(observation.source) + alone.source]),
        np.concatenate([observation.sign, alone.sign]),
    )
    return Mirrors(observation, joints, critic)


def joint_mirror(robot: RobotConfig, model: mujoco.MjModel) -> Mirror:
    """The mirror image of joint positions: each joint's counterpart on the other side, which may be itself.

    :param robot: the robot
    :param model: its model, of :func:`~ogmp_sb3.env.robot_model.build_model`
    :raises ValueError: if a joint has no counterpart, or the nominal pose is not its own mirror image
    """
    data = nominal_data(robot, model)
    ids = [model.joint(name).id for name in robot.joints]
    base = data.body(robot.base).xpos
    anchors, axes = data.xanchor[ids] - base, data.xaxis[ids]
    source, sign = np.zeros(len(ids), dtype=int), np.ones(len(ids))
    for i, (anchor, axis, kind) in enumerate(zip(POLAR_MIRROR * anchors, axes, model.jnt_type[ids], strict=True)):
        turns = kind == mujoco.mjtJoint.mjJNT_HINGE
        along = axes @ ((AXIAL_MIRROR if turns else POLAR_MIRROR) * axis)
        distance = np.linalg.norm(anchors - anchor, axis=1)
        fits = (np.abs(along) > ALIGNED) & (distance < NEAR) & (model.jnt_type[ids] == kind)
        if not fits.any():
            alone = f"joint '{robot.joints[i]}' has no counterpart on the other side"
            raise ValueError(f"robot '{robot.name}' is not symmetric: {alone}.")
        source[i] = int(np.where(fits, distance, np.inf).argmin())
        sign[i] = np.sign(along[source[i]])
    mirror, nominal = Mirror(source, sign), np.array(robot.nominal_joints)
    for i in np.flatnonzero(source[source] != np.arange(len(ids)))[:1]:
        raise ValueError(
            f"robot '{robot.name}' is not symmetric: the counterpart of joint '{robot.joints[i]}' is "
            f"'{robot.joints[source[i]]}', whose counterpart is '{robot.joints[source[source[i]]]}'."
        )
    if not np.allclose(mirror(nominal), nominal, atol=1e-3):
        i = int(np.abs(mirror(nominal) - nominal).argmax())
        pair = f"'{robot.joints[i]}' and '{robot.joints[source[i]]}'"
        raise ValueError(f"robot '{robot.name}' is not symmetric in its nominal pose: compare {pair}.")
    return mirror


def mirrored(view: EnvView, joints: Mirror, latent: np.ndarray) -> EnvView:
    """The mirror image of what terms see.

    :param joints: the mirror image of the joints
    :param latent: of the mirrored references
    """
    terrain = view.terrain.copy()
    terrain[..., [Y0, Y1]] = -view.terrain[..., [Y1, Y0]]
    return replace(
        view,
        base_pos_w=POLAR_MIRROR * view.base_pos_w,
        base_quat=QUAT_MIRROR * view.base_quat,
        base_linvel_w=POLAR_MIRROR * view.base_linvel_w,
        base_linvel_b=POLAR_MIRROR * view.base_linvel_b,
        base_angvel_b=AXIAL_MIRROR * view.base_angvel_b,
        joint_pos=joints(view.joint_pos),
        joint_vel=joints(view.joint_vel),
        down=POLAR_MIRROR * view.down,
        action=joints(view.action),
        torque=joints(view.torque),
        terrain=terrain,
        state=STATE_MIRROR * view.state,
        reference=STATE_MIRROR * view.reference,
        reference_quat=QUAT_MIRROR * view.reference_quat,
        latent=latent,
    )


def observation_mirror(
    terms: Mapping[str, Any], view: EnvView, weights: np.ndarray, joints: Mirror, both_sides: bool
) -> Mirror:
    """Which value of an observation becomes which in the mirror image, found by showing its terms random views.

    :param terms: observation terms by name, in order
    :param view: of the environments, whose terrain is used
    :param weights: of the bound, shape (12,)
    :param joints: the mirror image of the joints
    :param both_sides: whether the second half of a latent is that of the mirrored reference
    :raises ValueError: if the mirror image of an observation holds anything but its own values and their negatives
    """
    probe = _random_view(view, weights)
    other = np.random.default_rng(1).uniform(-1.0, 1.0, probe.latent.shape)  # of one side says nothing of the other
    latent = np.roll(probe.latent, probe.latent.shape[1] // 2, axis=1) if both_sides else other
    image = mirrored(probe, joints, latent)
    sources, signs, first = [], [], 0
    for name, term in terms.items():
        value, seen = term(probe).value, term(image).value
        for i in range(value.shape[1]):
            matches = [(sign, np.abs(seen[:, i : i + 1] - sign * value).max(axis=0) < 1e-9) for sign in (1.0, -1.0)]
            own = next((sign for sign, fits in matches if fits[i]), None)
            found = [(int(j), sign) for sign, fits in matches for j in np.flatnonzero(fits)]
            if not found:
                raise ValueError(
                    f"observation '{name}' has no mirror image: seen from the other side, its value {i} is none of its "
                    "values."
                )
            source, sign = (i, own) if own is not None else found[0]
            sources.append(first + source)
            signs.append(sign)
        first += value.shape[1]
    return Mirror(np.array(sources, dtype=int), np.array(signs))


def _random_view(view: EnvView, weights: np.ndarray) -> EnvView:
    """Robots at random places on the terrain of a view, in random states."""
    rng = np.random.default_rng(0)
    rows = np.arange(PROBES) % len(view.state)
    size = view.joint_pos.shape[1]
    terrain = view.terrain[rows]
    position = rng.uniform((0.0, -0.3, 0.3), (1.0, 0.3, 0.8), (PROBES, 3))
    quat = rpy_to_quat(rng.uniform(-0.5, 0.5, (PROBES, 3)))
    velocity = rng.uniform(-1.0, 1.0, (PROBES, 6))
    state, linvel_b = srb_state(np.concatenate([position, quat], axis=1), velocity)
    reference = state + rng.uniform(-0.1, 0.1, (PROBES, STATE_SIZE))
    return EnvView(
        base_pos_w=position,
        base_quat=quat,
        base_linvel_w=velocity[:, :3],
        base_linvel_b=linvel_b,
        base_angvel_b=velocity[:, 3:],
        joint_pos=rng.uniform(-0.5, 0.5, (PROBES, size)),
        joint_vel=rng.uniform(-5.0, 5.0, (PROBES, size)),
        down=rng.uniform(-1.0, 1.0, (PROBES, 3)),
        action=rng.uniform(-1.0, 1.0, (PROBES, size)),
        torque=rng.uniform(-20.0, 20.0, (PROBES, size)),
        body_contact=rng.random(PROBES) < 0.5,
        terrain=terrain,
        ground_height=height_at(terrain, position[:, None, :2])[:, 0],
        state=state,
        reference=reference,
        reference_quat=rpy_to_quat(reference[:, :3]),
        deviation=deviation(state, reference, weights),
        latent=rng.uniform(-1.0, 1.0, (PROBES, view.latent.shape[1])),
        phase=rng.integers(0, 10, PROBES),
        period=np.full(PROBES, 10),
        commanded_speed=rng.uniform(0.5, 1.5, PROBES),
    )


def mirror_error(robot: RobotConfig, model: mujoco.MjModel, joints: Mirror) -> float:
    """How far a robot is from its mirror image: the greatest relative difference of their mass matrices.

    :param joints: the mirror image of the joints, of :func:`joint_mirror`
    :return: over random poses, 0 for a robot that is symmetric
    """
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    nominal, base = np.array(robot.nominal_joints), model.body(robot.base).jntadr[0]
    dofs = np.concatenate([model.jnt_dofadr[base] + np.arange(6), [model.joint(n).dofadr[0] for n in robot.joints]])
    sign = np.concatenate([POLAR_MIRROR, AXIAL_MIRROR, joints.sign])
    source = np.concatenate([np.arange(6), 6 + joints.source])
    errors = []
    for _ in range(MIRROR_POSES):
        pose = nominal + rng.uniform(-0.3, 0.3, len(nominal))
        matrix, image = (
            _mass_matrix(robot, model, data, angles)[np.ix_(dofs, dofs)] for angles in (pose, joints(pose))
        )
        seen = (sign[:, None] * sign) * matrix[np.ix_(source, source)]
        errors.append(np.linalg.norm(image - seen) / np.linalg.norm(matrix))
    return float(max(errors))


def _mass_matrix(robot: RobotConfig, model: mujoco.MjModel, data: mujoco.MjData, joint_pos: np.ndarray) -> np.ndarray:
    mujoco.mj_resetData(model, data)
    base = model.jnt_qposadr[model.body(robot.base).jntadr[0]]
    data.qpos[base + 3 : base + 7] = 1.0, 0.0, 0.0, 0.0
    for name, angle in zip(robot.joints, joint_pos, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_forward(model, data)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return matrix
