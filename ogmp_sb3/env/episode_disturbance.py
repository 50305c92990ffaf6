"""What disturbs one episode of one environment: what terms see, what they give, and all that a task's terms give."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.answers import answer_text, call
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env import observations

if TYPE_CHECKING:  # which a machine that draws nothing can do without
    import mujoco

    from ogmp_sb3.env.servos import Servos

LONGEST_DELAY = 0.5  # s; more is a slip of the pen, or a number of control steps


@dataclass(frozen=True)
class Subject:
    """What a term is about: one environment whose next episode is drawn."""

    robot: RobotConfig
    """the robot"""
    model: mujoco.MjModel
    """its model as it is without any disturbance, with the terrain's boxes"""
    servos: Servos
    """its servos"""
    boxes: int
    """how many boxes the terrain has"""
    parts: Mapping[str, observations.Part]
    """what the policy observes, by name"""
    typical: Mapping[str, np.ndarray]
    """typical sizes of these, each of shape (size,)"""
    varied: Mapping[str, np.ndarray]
    """fields of the model as the terms before have left them, by name"""
    rng: np.random.Generator
    """for what is drawn beside the parameters"""

    def field(self, name: str) -> np.ndarray:
        """A copy of a field of the model (``"body_mass"``, ``"opt.gravity"``), as the terms before have left it."""
        value = self.varied.get(name)
        if value is None:
            value = self.model
            for part in name.split("."):
                value = getattr(value, part)
        return np.array(value, dtype=float)

    @property
    def bodies(self) -> np.ndarray:
        """The robot's bodies, int: all of the model but the world, which holds the terrain."""
        return np.arange(1, self.model.nbody)

    @property
    def joint_dofs(self) -> np.ndarray:
        """The degree of freedom of each of the robot's joints, in order, int."""
        return np.array([self.model.joint(name).dofadr[0] for name in self.robot.joints])


@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """What disturbs an episode. What several terms give adds up; of a field of the model the last one counts."""

    model: Mapping[str, np.ndarray] = field(default_factory=dict)
    """fields of the simulation's model, whole, by their names in MuJoCo; begin with :meth:`Subject.field`"""
    gains: float | np.ndarray = 1.0
    """factor on kp and kd of the servos, a number or shape (joints,)"""
    force: np.ndarray | float = 0.0
    """steady force on the base, world frame, shape (3,), N"""
    ground: np.ndarray | float = 0.0
    """how much higher each box of the terrain is than the policy sees it, shape (boxes,), m"""
    action_delay: float = 0.0
    """how long after its control step begins an action reaches the servos, s"""
    action_jitter: float = 0.0
    """greatest further delay, drawn for every action, s"""
    sensor_delay: float = 0.0
    """how old what is observed is, s"""
    sensor_jitter: float = 0.0
    """how much older at most, drawn for every observation, s"""
    step_jitter: float = 0.0
    """by how much at most a control step is longer or shorter, drawn for each, s"""
    target_offset: np.ndarray | float = 0.0
    """added to the joint positions that are commanded, shape (joints,), rad"""
    bias: Mapping[str, np.ndarray | float] = field(default_factory=dict)
    """added to what is observed, by the name of the part, in its unit"""
    noise: Mapping[str, np.ndarray | float] = field(default_factory=dict)
    """standard deviation of white noise on what is observed, by the name of the part, in its unit"""
    dropout: Mapping[str, float] = field(default_factory=dict)
    """probability that a value is the one of the control step before, by the name of the part"""
    age: Mapping[str, float] = field(default_factory=dict)
    """how much older a part is than what else is observed, by its name, s, rounded to control steps"""
    push_speed: float = 0.0
    """change of the base's velocity in a random horizontal direction, m/s"""
    push_every: float = 0.0
    """how often, s; the first comes at a random time within it; of several terms the longest"""


Value = Callable[[str, str, Range], float | str]
"""gives a parameter its value: of the term, the parameter and its range"""
ROUNDING = 1e-9  # s
SUMMED = ("force", "ground", "action_delay", "action_jitter", "sensor_delay", "sensor_jitter", "step_jitter",
          "target_offset", "push_speed")  # fmt: skip
OF_OBSERVATIONS = ("bias", "noise", "dropout", "age")


def drawn(task: TaskConfig, subject: Subject, value: Value, checked: bool) -> Disturbance:
    """All that the terms of a task give for one episode.

    :param checked: whether it is known to fit: a task's terms are checked once, at both ends of their ranges
    :raises FunctionFailed: if a term's function raises an exception
    :raises TypeError: if a term answers with something of the wrong type
    :raises ValueError: if what it gives does not fit the robot, what is observed, or the task
    """
    total = Disturbance()
    for name, ranges in task.randomised.items():
        parameters = {key: value(name, key, full) for key, full in ranges.items()}
        what = f"randomisation '{name}'"
        given = call(what, registry.randomisations.get(name), replace(subject, varied=total.model), **parameters)
        if not checked:
            if not isinstance(given, Disturbance):
                raise TypeError(f"what {what} returns must be a Disturbance; it is {answer_text(given)}.")
            _check(f"{task.file}: what {what} gives", given, subject)
        total = _added(total, given)
    if not checked:
        _check_times(total, task)
    return total


def _added(total: Disturbance, more: Disturbance) -> Disturbance:
    """Two disturbances at once."""
    sums = {name: getattr(total, name) + getattr(more, name) for name in SUMMED}
    bias, noise, dropout, age = (dict(getattr(total, kind)) for kind in OF_OBSERVATIONS)
    for part, size in more.bias.items():
        bias[part] = bias.get(part, 0.0) + size
    for part, size in more.noise.items():
        noise[part] = np.hypot(noise.get(part, 0.0), size)
    for part, share in more.dropout.items():
        dropout[part] = 1.0 - (1.0 - dropout.get(part, 0.0)) * (1.0 - share)
    for part, seconds in more.age.items():
        age[part] = age.get(part, 0.0) + seconds
    return Disturbance(
        model={**total.model, **more.model},
        gains=total.gains * more.gains,
        push_every=max(total.push_every, more.push_every),
        bias=bias,
        noise=noise,
        dropout=dropout,
        age=age,
        **sums,
    )


def _check(what: str, given: Disturbance, subject: Subject) -> None:
    """:raises ValueError: if something does not fit the robot or what is observed"""
    observed = dict.fromkeys(part for kind in OF_OBSERVATIONS for part in getattr(given, kind))
    if observed and not any(part in subject.parts for part in observed):
        named = "', '".join(observed)
        raise ValueError(f"{what} disturbs '{named}', which is not observed.")
    joints = (len(subject.robot.joints),)
    shapes: list[tuple[str, Any, tuple[int, ...]]] = [
        ("force", given.force, (3,)),
        ("ground", given.ground, (subject.boxes,)),
    ]
    shapes += [("gains", given.gains, joints), ("target_offset", given.target_offset, joints)]
    for kind in OF_OBSERVATIONS:
        for part, size in getattr(given, kind).items():
            if part in subject.parts:
                shapes.append((f"{kind} of '{part}'", size, (subject.parts[part].size,)))
    for name, field_values in given.model.items():
        try:
            shapes.append((f"'{name}' of the model", field_values, subject.field(name).shape))
        except AttributeError:
            raise ValueError(f"{what} varies '{name}', which is no field of MuJoCo's model.") from None
    for name, values, shape in shapes:
        if np.shape(values) not in ((), shape):
            raise ValueError(f"{what} has {name} of the shape {np.shape(values)}; it must be {shape}.")
        if not np.isfinite(np.asarray(values, dtype=float)).all():
            raise ValueError(f"{what} has {name} that is not finite.")


def _check_times(total: Disturbance, task: TaskConfig) -> None:
    """:raises ValueError: if a delay is longer than can be"""
    step, sensors = task.control_dt, total.sensor_delay + total.sensor_jitter
    oldest = {"observations are": sensors} | {f"'{part}' is": sensors + more for part, more in total.age.items()}
    for what, found, most in (
        ("actions are late by up to", total.action_delay + total.action_jitter, LONGEST_DELAY),
        ("the delay of actions differs by up to", total.action_jitter, step),
        *((f"{what} old by up to", seconds, LONGEST_DELAY) for what, seconds in oldest.items()),
        ("the age of observations differs by up to", total.sensor_jitter, step),
        ("control steps differ by up to", total.step_jitter, 0.5 * step),
    ):
        if found > most + ROUNDING:
            raise ValueError(f"{task.file}: by its 'randomisation' {what} {found:g} s; at most {most:g} s can be.")
