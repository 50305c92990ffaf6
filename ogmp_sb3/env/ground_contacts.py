"""Which parts of a robot meet the ground, and the sensors that tell when they do."""

from __future__ import annotations

import mujoco
import numpy as np

from ogmp_sb3.config.robot import RobotConfig

PLAIN_BITS = 1  # contype and conaffinity of the ground
ALL_BITS = 2**31 - 1
FOUND = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)


def ground_bits(model: mujoco.MjModel, robot: RobotConfig) -> int:
    """The ``contype`` and ``conaffinity`` that the ground needs, for every foot to stand on it.

    :param model: the robot alone
    :return: 1; or all bits if that leaves out a foot, so that the ground meets whatever collides with anything
    :raises ValueError: if a foot cannot touch any ground
    """
    feet = [with_all_below(model, model.body(name).id) for name in robot.feet]
    for name, bodies in zip(robot.feet, feet, strict=True):
        if not np.isin(_bodies_that_meet(model, ALL_BITS), bodies).any():
            colliding = (model.geom_contype | model.geom_conaffinity) != 0
            if (np.isin(model.geom_bodyid, bodies) & colliding).any():
                reason = "an <exclude> keeps it from the world"
            else:
                reason = 'neither it nor a body below it has a geom that collides, e.g. one with conaffinity="1"'
            raise ValueError(f"{robot.mjcf_path}: foot '{name}' cannot touch the ground: {reason}.")
    met = _bodies_that_meet(model, PLAIN_BITS)
    return PLAIN_BITS if all(np.isin(met, bodies).any() for bodies in feet) else ALL_BITS


def add_missing_sensors(spec: mujoco.MjSpec, model: mujoco.MjModel, robot: RobotConfig, bits: int) -> None:
    """Add a contact sensor to every body that can touch the ground, is not of a foot, and has none.

    :param spec: what ``model`` was compiled of; all its bodies have names
    :param bits: of the ground
    """
    sensed = {model.sensor_objid[i] for i in _ground_sensors(model)} | set(foot_bodies(model, robot))
    for body in dict.fromkeys(_bodies_that_meet(model, bits).tolist()):
        if body not in sensed:
            spec.add_sensor(
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                objname=model.body(body).name,
                reftype=mujoco.mjtObj.mjOBJ_BODY,
                refname="world",
                intprm=[FOUND, 0, 1],  # data, reduce, num
            )


def body_contact_addresses(model: mujoco.MjModel, robot: RobotConfig) -> np.ndarray:
    """Places in ``sensordata`` that are above 0 where a body that is not of a foot touches the ground."""
    feet = foot_bodies(model, robot)
    sensors = [i for i in _ground_sensors(model) if model.sensor_objid[i] not in feet]
    return np.array(model.sensor_adr[sensors], dtype=int)


def ground_geoms(model: mujoco.MjModel) -> np.ndarray:
    """The geoms of a robot that meet the ground.

    :param model: the robot with terrain
    :return: shape (n,), int
    """
    return np.flatnonzero(_meet(model, int(model.geom("terrain_0").contype[0])))


def touching(model: mujoco.MjModel) -> np.ndarray:
    """Geoms that can touch something, shape (geoms,), bool."""
    can: np.ndarray = (model.geom_contype | model.geom_conaffinity) != 0
    can[np.concatenate([model.pair_geom1, model.pair_geom2])] = True
    return can


def geom_extents(data: mujoco.MjData, geoms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest coordinates of geoms, world frame, shapes (n, 3), m.

    A mesh counts by its vertices, any other by the box around it in its own frame.

    :param geoms: shape (n,), int
    """
    model, rotation = data.model, data.geom_xmat[geoms].reshape(-1, 3, 3)
    centre = data.geom_xpos[geoms] + np.einsum("gij,gj->gi", rotation, model.geom_aabb[geoms, :3])
    reach = np.einsum("gij,gj->gi", np.abs(rotation), model.geom_aabb[geoms, 3:])
    low, high = centre - reach, centre + reach
    for i in np.flatnonzero(model.geom_type[geoms] == int(mujoco.mjtGeom.mjGEOM_MESH)):
        mesh = model.geom_dataid[geoms[i]]
        first = model.mesh_vertadr[mesh]
        points = model.mesh_vert[first : first + model.mesh_vertnum[mesh]] @ rotation[i].T + data.geom_xpos[geoms[i]]
        low[i], high[i] = points.min(axis=0), points.max(axis=0)
    return low, high


def foot_geoms(model: mujoco.MjModel, robot: RobotConfig) -> np.ndarray:
    """Those of its feet; as :func:`ground_geoms`."""
    geoms = ground_geoms(model)
    return geoms[np.isin(model.geom_bodyid[geoms], list(foot_bodies(model, robot)))]


def _ground_sensors(model: mujoco.MjModel) -> list[int]:
    """Sensors whose first number says how often one body, whole, touches the world: ``body1="..." body2="world"``."""
    body = int(mujoco.mjtObj.mjOBJ_BODY)
    return np.flatnonzero(
        (model.sensor_type == int(mujoco.mjtSensor.mjSENS_CONTACT))
        & (model.sensor_objtype == body)
        & (model.sensor_reftype == body)
        & (model.sensor_refid == 0)
        & (model.sensor_intprm[:, 0] & FOUND > 0)
        & (model.sensor_historyadr < 0)  # neither delayed nor read now and then
    ).tolist()


def _meet(model: mujoco.MjModel, bits: int) -> np.ndarray:
    """Geoms of moving bodies that collide with ground of these bits, shape (geoms,), bool."""
    excluded = [int(pair) & 0xFFFF for pair in model.exclude_signature if int(pair) >> 16 == 0]  # from the world
    can_touch = (model.body_weldid > 0) & ~np.isin(np.arange(model.nbody), excluded)
    meet: np.ndarray = can_touch[model.geom_bodyid] & ((model.geom_contype | model.geom_conaffinity) & bits != 0)
    return meet


def _bodies_that_meet(model: mujoco.MjModel, bits: int) -> np.ndarray:
    return model.geom_bodyid[_meet(model, bits)]  # type: ignore[no-any-return]


def foot_bodies(model: mujoco.MjModel, robot: RobotConfig) -> set[int]:
    """Every body of a foot."""
    return {body for name in robot.feet for body in with_all_below(model, model.body(name).id)}


def with_all_below(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and its descendants, whose numbers are higher than those of their parents."""
    family = {body}
    for other in range(body + 1, model.nbody):
        if model.body_parentid[other] in family:
            family.add(other)
    return sorted(family)
