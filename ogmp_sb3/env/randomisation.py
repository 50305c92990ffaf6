"""Randomisation terms: one function each, from parameters to what disturbs one episode of one environment.

A task gives each parameter a number or a range, from which it is drawn for every episode. A parameter's default is the
value at which nothing is disturbed; where it is None, that is what the robot's model has.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ogmp_sb3.config.registry import not_a_size, parameter_limits, parameter_units, randomisations
from ogmp_sb3.env.episode_disturbance import LONGEST_DELAY, Disturbance, Subject


@randomisations.register()
@parameter_limits(scale=(0.05, 20.0), each=(0.0, 0.9))
def mass(subject: Subject, scale: float = 1.0, each: float = 0.0) -> Disturbance:
    """Mass and inertia.

    :param scale: factor on all bodies together
    :param each: each body's own factor lies within 1 - ``each`` and 1 + ``each``
    """
    factor = scale * _each(subject, each, subject.model.nbody)
    inertia = subject.field("body_inertia") * factor[:, None]
    return Disturbance(model={"body_mass": subject.field("body_mass") * factor, "body_inertia": inertia})


@randomisations.register()
@parameter_limits(spread=(0.0, 0.5))
@parameter_units(spread="m")
def centre_of_mass(subject: Subject, spread: float = 0.0) -> Disturbance:
    """Where the mass of each body is.

    :param spread: farthest from the model's along each axis of the body, m
    """
    places, bodies = subject.field("body_ipos"), subject.bodies
    places[bodies] += spread * subject.rng.uniform(-1.0, 1.0, (len(bodies), 3))
    # MuJoCo does not look up places of frames that coincided when the model was compiled.
    apart = {name: np.zeros_like(subject.field(name)) for name in ("body_sameframe", "geom_sameframe")}
    return Disturbance(model={"body_ipos": places, **apart})


@randomisations.register()
@parameter_limits(mass=(0.0, 1000.0))
@parameter_units(mass="kg")
def payload(subject: Subject, mass: float = 0.0) -> Disturbance:
    """Something that the base carries at its centre of mass.

    :param mass: kg
    """
    masses = subject.field("body_mass")
    masses[subject.model.body(subject.robot.base).id] += mass
    return Disturbance(model={"body_mass": masses})


@randomisations.register()
@parameter_limits(coefficient=(0.01, 10.0))
def friction(subject: Subject, coefficient: float | None = None) -> Disturbance:
    """Sliding friction between whatever touches, in place of the model's.

    :param coefficient: Coulomb's
    """
    values = subject.field("geom_friction")
    if coefficient is not None:
        values[:, 0] = coefficient
    return Disturbance(model={"geom_friction": values})


@randomisations.register()
@parameter_limits(time_constant=(0.0005, 0.2))
def contact(subject: Subject, time_constant: float | None = None) -> Disturbance:
    """How hard contacts are: sinking in dies away like the response of a damped spring (``solref`` of MuJoCo).

    MuJoCo makes no contact harder than two physics steps: with steps of 2 ms the least is 4 ms.

    :param time_constant: s; MuJoCo's default is 0.02
    """
    values = subject.field("geom_solref")
    if time_constant is not None:
        values[:, 0] = time_constant
    return Disturbance(model={"geom_solref": values})


@randomisations.register()
@parameter_limits(scale=(0.05, 20.0), each=(0.0, 0.9))
def gains(subject: Subject, scale: float = 1.0, each: float = 0.0) -> Disturbance:
    """Gains kp and kd of the servos; torque limits stay.

    :param scale: factor on all servos together
    :param each: each servo's own factor lies within 1 - ``each`` and 1 + ``each``
    """
    return Disturbance(gains=scale * _each(subject, each, len(subject.robot.joints)))


@randomisations.register()
@parameter_limits(scale=(0.05, 20.0), each=(0.0, 0.9))
def motor_strength(subject: Subject, scale: float = 1.0, each: float = 0.0) -> Disturbance:
    """What the motors give of the torque that they are told: gains and torque limits.

    :param scale: factor on all motors together
    :param each: each motor's own factor lies within 1 - ``each`` and 1 + ``each``
    """
    model, ids, factor = subject.model, subject.servos.ids, scale * _each(subject, each, len(subject.robot.joints))
    forces, joints = subject.field("actuator_forcerange"), subject.field("jnt_actfrcrange")
    forces[ids] *= factor[:, None]
    joints[model.dof_jntid[subject.joint_dofs]] *= factor[:, None]
    return Disturbance(gains=factor, model={"actuator_forcerange": forces, "jnt_actfrcrange": joints})


@randomisations.register()
@parameter_limits(torque=(0.0, 100.0))
@parameter_units(torque="N m")
def joint_friction(subject: Subject, torque: float = 0.0) -> Disturbance:
    """Dry friction of every joint, beside the model's.

    :param torque: N m
    """
    return _on_joints(subject, "dof_frictionloss", lambda before: before + torque)


@randomisations.register()
@parameter_limits(coefficient=(0.0, 100.0))
@parameter_units(coefficient="N m s")
def joint_damping(subject: Subject, coefficient: float = 0.0) -> Disturbance:
    """Viscous friction of every joint, beside the model's.

    :param coefficient: N m s/rad
    """
    return _on_joints(subject, "dof_damping", lambda before: before + coefficient)


@randomisations.register()
@parameter_limits(scale=(0.05, 20.0))
def armature(subject: Subject, scale: float = 1.0) -> Disturbance:
    """Inertia of the motors' rotors.

    :param scale: factor
    """
    return _on_joints(subject, "dof_armature", lambda before: before * scale)


@randomisations.register()
@parameter_limits(spread=(0.0, 0.5))
def joint_offset(subject: Subject, spread: float = 0.0) -> Disturbance:
    """Encoders whose zero is not the joint's: what is measured and what is commanded are both off.

    :param spread: greatest error of a joint, drawn for each, rad
    """
    offset = spread * subject.rng.uniform(-1.0, 1.0, len(subject.robot.joints))
    return Disturbance(target_offset=-offset, bias={"joint_pos": offset})


@randomisations.register()
@parameter_limits(delay=(0.0, LONGEST_DELAY), jitter=(0.0, LONGEST_DELAY))
def action_delay(subject: Subject, delay: float = 0.0, jitter: float = 0.0) -> Disturbance:
    """Time from the start of a control step, when the action is computed, until it reaches the servos.

    :param delay: s, rounded to physics steps
    :param jitter: greatest further delay, drawn for every action, s
    """
    return Disturbance(action_delay=delay, action_jitter=jitter)


@randomisations.register()
@parameter_limits(delay=(0.0, LONGEST_DELAY), jitter=(0.0, LONGEST_DELAY))
def sensor_delay(subject: Subject, delay: float = 0.0, jitter: float = 0.0) -> Disturbance:
    """How old what is observed is.

    :param delay: s, rounded to physics steps
    :param jitter: how much older at most, drawn for every observation, s; none is read in a control step before the
        one in which it would have been read without
    """
    return Disturbance(sensor_delay=delay, sensor_jitter=jitter)


@randomisations.register()
@parameter_limits(jitter=(0.0, LONGEST_DELAY))
def control_jitter(subject: Subject, jitter: float = 0.0) -> Disturbance:
    """A control loop that does not keep its time.

    :param jitter: by how much at most a control step is longer or shorter, drawn for each, s, rounded to physics steps
    """
    return Disturbance(step_jitter=jitter)


@randomisations.register()
@parameter_limits(scale=(0.0, 10.0))
def sensor_noise(subject: Subject, scale: float = 0.0) -> Disturbance:
    """White noise on everything that a robot measures of itself.

    :param scale: standard deviation, in typical sizes of each value
    """
    measured = [name for name, part in subject.parts.items() if part.measured] or ["proprioception"]
    return Disturbance(noise={name: scale * subject.typical.get(name, np.ones(1)) for name in measured})


@randomisations.register()
@parameter_limits(
    rate=(0.0, 10.0), tilt=(0.0, 1.0), rate_bias=(0.0, 10.0), tilt_bias=(0.0, 1.0), heading_bias=(0.0, 1.0)
)
@parameter_units(rate="rad/s")
def imu(
    subject: Subject,
    rate: float = 0.0,
    tilt: float = 0.0,
    rate_bias: float = 0.0,
    tilt_bias: float = 0.0,
    heading_bias: float = 0.0,
) -> Disturbance:
    """Errors of angular velocity and orientation.

    :param rate: standard deviation of white noise on the angular velocity, rad/s
    :param tilt: of white noise on the direction of gravity or the orientation, rad
    :param rate_bias: greatest constant error of the angular velocity along each axis, rad/s
    :param tilt_bias: greatest constant error of the direction of gravity along each axis, rad
    :param heading_bias: greatest constant error of the heading, rad
    """
    noise: dict[str, np.ndarray | float] = {"base_angvel_b": rate, "gravity_b": tilt, "base_quat": 0.5 * tilt}
    towards = subject.rng.uniform(-1.0, 1.0, 7)
    bias: dict[str, np.ndarray | float] = {
        "base_angvel_b": rate_bias * towards[:3],
        "gravity_b": tilt_bias * towards[3:6],
        "heading": heading_bias * towards[6],
    }
    return Disturbance(noise=noise, bias=bias)


@randomisations.register()
@parameter_limits(height=(0.0, 0.5), offset=(0.0, 0.5), dropout=(0.0, 0.99), delay=(0.0, LONGEST_DELAY))
@parameter_units(height="m", offset="m")
def scan(
    subject: Subject, height: float = 0.0, offset: float = 0.0, dropout: float = 0.0, delay: float = 0.0
) -> Disturbance:
    """Errors of the terrain scan.

    :param height: standard deviation of white noise on every height, m
    :param offset: greatest constant error of all heights together, m
    :param dropout: probability that a point keeps its height of the control step before
    :param delay: how much older it is than what else is observed, s, rounded to control steps
    """
    name = "height_scan"
    bias = offset * subject.rng.uniform(-1.0, 1.0)
    return Disturbance(noise={name: height}, bias={name: bias}, dropout={name: dropout}, age={name: delay})


@randomisations.register()
@parameter_limits(speed=(0.0, 100.0), every=(0.001, 1000.0))
@not_a_size("every")
@parameter_units(speed="m/s")
def push(subject: Subject, speed: float = 0.0, every: float = 2.0) -> Disturbance:
    """Kicks: the base's velocity changes at once, in a random horizontal direction.

    :param speed: change of velocity, m/s
    :param every: time between kicks, s, rounded to physics steps; the first comes at a random time within it
    """
    return Disturbance(push_speed=speed, push_every=every)


@randomisations.register()
@parameter_limits(force=(0.0, 10_000.0))
@parameter_units(force="N")
def wind(subject: Subject, force: float = 0.0) -> Disturbance:
    """A steady horizontal force on the base, from a direction drawn for every episode.

    :param force: N
    """
    angle = subject.rng.uniform(0.0, 2.0 * np.pi)
    return Disturbance(force=force * np.array([np.cos(angle), np.sin(angle), 0.0]))


@randomisations.register()
@parameter_limits(pitch=(-0.5, 0.5), roll=(-0.5, 0.5))
def slope(subject: Subject, pitch: float = 0.0, roll: float = 0.0) -> Disturbance:
    """Ground that is not level: gravity leans instead, so that everything else is as it was, the IMU too.

    :param pitch: how much the track rises along its heading, rad
    :param roll: how much it rises to the left, rad
    """
    gravity = subject.field("opt.gravity")
    strength = np.linalg.norm(gravity)
    down = np.array([-np.tan(pitch), -np.tan(roll), -1.0])
    return Disturbance(model={"opt.gravity": strength * down / np.linalg.norm(down)})


@randomisations.register()
@parameter_limits(height=(0.0, 0.2))
@parameter_units(height="m")
def rough_ground(subject: Subject, height: float = 0.0) -> Disturbance:
    """Every box of the terrain a little higher or lower than the scan shows it.

    :param height: greatest error, m
    """
    return Disturbance(ground=height * subject.rng.uniform(-1.0, 1.0, subject.boxes))


def _each(subject: Subject, spread: float, count: int) -> np.ndarray:
    """A factor of its own for each of some things, within 1 - spread and 1 + spread, shape (count,)."""
    factors: np.ndarray = 1.0 + spread * subject.rng.uniform(-1.0, 1.0, count)
    return factors


def _on_joints(subject: Subject, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Disturbance:
    """A field with a value for each degree of freedom, changed for those of the robot's joints."""
    values, dofs = subject.field(name), subject.joint_dofs
    values[dofs] = change(values[dofs])
    return Disturbance(model={name: values})
