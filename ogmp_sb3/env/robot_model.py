"""Compile a robot's MJCF with terrain boxes, and check that it holds what robot.yaml names."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.ground_contacts import add_missing_sensors, ground_bits
from ogmp_sb3.env.robot_spec import in_the_file, robot_spec
from ogmp_sb3.env.servos import read_servos
from ogmp_sb3.guidance.rotations import quat_rotate
from ogmp_sb3.guidance.srb import GRAVITY
from ogmp_sb3.guidance.terrain import NOTHING

TERRAIN_FRICTION = (1.0, 0.005, 0.0001)  # sliding, torsional, rolling: MuJoCo's defaults
NEEDED = {"contact": "CONTACT", "constraint": "CONSTRAINT", "actuation": "ACTUATION", "gravity": "GRAVITY"}
VISIBLE_GROUPS = (0, 1, 2)  # MuJoCo's default: geoms of the other groups are not drawn
UPRIGHT = 0.7  # cosine of the tilt that a base may have in the file
GRAVITY_TOLERANCE = 0.05  # m/s^2: 9.8 is as good as 9.81


def build_model(robot: RobotConfig, physics_dt: float, terrain_boxes: int, visual: bool = False) -> mujoco.MjModel:
    """Compile a robot with a pool of static terrain boxes.

    The robot is compiled alone first: what can touch the ground, and which sensors are missing, is known only then.

    :param robot: the robot
    :param physics_dt: physics step, s
    :param terrain_boxes: number of boxes, named ``terrain_0``, ...
    :param visual: keep the geoms that are only seen, for rendering; the state is the same either way
    :raises ValueError: if the robot's MJCF is unreadable, lacks what robot.yaml names, or cannot be simulated
    """
    spec = robot_spec(robot)
    with in_the_file(robot):
        _prepare(spec, physics_dt, visual)
        alone = spec.compile()
    _check_names(alone, robot)
    _check_options(alone, robot)
    _check_base(alone, robot)
    _check_surroundings(alone, robot)
    read_servos(alone, robot)
    bits = ground_bits(alone, robot)
    add_missing_sensors(spec, alone, robot, bits)
    with in_the_file(robot):
        _add_terrain(spec, terrain_boxes, bits)
        return spec.compile()


def _prepare(spec: mujoco.MjSpec, physics_dt: float, visual: bool) -> None:
    """Set what the simulator decides, whatever the file says."""
    disable, enable = mujoco.mjtDisableBit, mujoco.mjtEnableBit
    spec.option.timestep = physics_dt
    # Terrain boxes move at run time, but the bounding volumes of static geoms are made at compile time.
    spec.option.disableflags |= int(disable.mjDSBL_MIDPHASE | disable.mjDSBL_AUTORESET)
    spec.option.disableflags &= ~int(disable.mjDSBL_SENSOR)
    spec.option.enableflags &= ~int(enable.mjENBL_SLEEP)  # what sleeps does not see the ground move
    # MuJoCo drops the geoms that neither collide nor are named anywhere, and keeps their mass in the body. It cannot
    # where inertias must be inferred from all geoms.
    inferred = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    spec.compiler.discardvisual = not visual and all(b.compiler.inertiafromgeom != inferred for b in spec.bodies)
    for i, body in enumerate(spec.bodies):
        body.name = body.name or f"unnamed body {i}"  # for sensors
    for geom in spec.geoms:
        if not geom.adhesion:
            geom.gap = 0.0  # contacts in the gap have no force, but sensors would count them
    if visual:
        _prepare_pictures(spec)


def _prepare_pictures(spec: mujoco.MjSpec) -> None:
    """Show a robot that is all in hidden groups."""
    if not any(geom.group in VISIBLE_GROUPS for geom in spec.geoms):
        for geom in spec.geoms:
            geom.group = VISIBLE_GROUPS[0]


def _add_terrain(spec: mujoco.MjSpec, boxes: int, bits: int) -> None:
    plain = mujoco.MjSpec().default  # the file's own defaults are for the robot
    for i in range(boxes):
        spec.worldbody.add_geom(
            plain,
            name=f"terrain_{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[1.0, 1.0, 1.0],
            pos=[0.0, 0.0, NOTHING],
            contype=bits,
            conaffinity=bits,
            friction=TERRAIN_FRICTION,
            rgba=[0.72, 0.70, 0.66, 1.0],
        )


def _check_names(model: mujoco.MjModel, robot: RobotConfig) -> None:
    bodies = [model.body(i).name for i in range(model.nbody)]
    joints = [model.joint(i).name for i in range(model.njnt)]
    for kind, wanted, names in (("body", (robot.base, *robot.feet), bodies), ("joint", robot.joints, joints)):
        for name in wanted:
            if name not in names:
                raise ValueError(f"{robot.mjcf_path}: no {kind} '{name}'{did_you_mean(name, names)}")


def _check_base(model: mujoco.MjModel, robot: RobotConfig) -> None:
    base = model.body(robot.base)
    if model.body_jntnum[base.id] != 1 or model.jnt_type[base.jntadr[0]] != mujoco.mjtJoint.mjJNT_FREE:
        raise ValueError(f"{robot.mjcf_path}: the base '{robot.base}' must have a free joint.")
    up = quat_rotate(base.quat, np.array([0.0, 0.0, 1.0]))
    if up[2] < UPRIGHT:
        raise ValueError(
            f"{robot.mjcf_path}: the z axis of the base '{robot.base}' must point up, "
            f"but is tilted by {np.degrees(np.arccos(up[2])):.0f}° there."
        )


def _check_surroundings(model: mujoco.MjModel, robot: RobotConfig) -> None:
    """Refuse what is not of the robot, but moves, can touch it or holds it."""
    base, root = model.body(robot.base).id, model.body_rootid
    other = f"is not of the robot (below '{robot.base}'); remove it"
    for i in np.flatnonzero(root[model.jnt_bodyid] != base)[:1].tolist():
        raise ValueError(f"{robot.mjcf_path}: body '{model.body(int(model.jnt_bodyid[i])).name}' moves, but {other}.")
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    collides[np.concatenate([model.pair_geom1, model.pair_geom2])] = True
    for i in np.flatnonzero(collides & (root[model.geom_bodyid] != base))[:1].tolist():
        body = model.body(int(model.geom_bodyid[i])).name
        owner = "the world" if body == "world" else f"body '{body}'"
        geom = f"geom '{model.geom(i).name or i}' of {owner}"
        raise ValueError(f"{robot.mjcf_path}: {geom} collides, but {other}: the ground is the task's.")
    for tie, bodies in _ties(model):
        if len(set(root[bodies].tolist())) > 1:
            raise ValueError(f"{robot.mjcf_path}: {tie} ties the robot to what {other}.")
    for foot in robot.feet:
        if root[model.body(foot).id] != base:
            raise ValueError(f"{robot.mjcf_path}: foot '{foot}' is not of the robot (below '{robot.base}').")


def _ties(model: mujoco.MjModel) -> Iterator[tuple[str, list[int]]]:
    """What ties bodies together: constraints of bodies or sites, and tendons along sites; each with its bodies."""
    body_of: dict[int, Callable[[int], int]] = {
        int(mujoco.mjtObj.mjOBJ_BODY): int,
        int(mujoco.mjtObj.mjOBJ_SITE): lambda site: int(model.site_bodyid[site]),
    }
    for i in np.flatnonzero(model.eq_active0).tolist():
        of = body_of.get(int(model.eq_objtype[i]))
        if of is not None:
            yield f"equality '{model.equality(i).name or i}'", [of(model.eq_obj1id[i]), of(model.eq_obj2id[i])]
    for i in range(model.ntendon):
        path = slice(model.tendon_adr[i], model.tendon_adr[i] + model.tendon_num[i])
        sites = model.wrap_objid[path][model.wrap_type[path] == int(mujoco.mjtWrap.mjWRAP_SITE)]
        yield f"tendon '{model.tendon(i).name or i}'", model.site_bodyid[sites].tolist()


def _check_options(model: mujoco.MjModel, robot: RobotConfig) -> None:
    """Refuse options under which there is no ground, no torque or no weight."""
    for flag, name in NEEDED.items():
        if model.opt.disableflags & getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"):
            raise ValueError(f"{robot.mjcf_path}: option flag '{flag}' is disabled; the simulation needs it.")
    if not np.allclose(model.opt.gravity, (0.0, 0.0, -GRAVITY), rtol=0.0, atol=GRAVITY_TOLERANCE):
        found = " ".join(f"{value:g}" for value in model.opt.gravity)
        raise ValueError(f"{robot.mjcf_path}: option gravity is {found}; oracles plan with 0 0 -{GRAVITY:g}.")
    for body in map(model.body, np.flatnonzero(model.body_gravcomp)[:1]):
        raise ValueError(f"{robot.mjcf_path}: body '{body.name}' has gravcomp; robots carry their own weight.")
