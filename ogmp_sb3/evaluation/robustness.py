"""Play a policy under disturbances, one at a time, to see how much it withstands."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.ranges import ModeRanges, Range
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import AnyPolicy
from ogmp_sb3.env.ground_contacts import foot_geoms
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.evaluation.analysis import Report, Request
from ogmp_sb3.evaluation.copies import copies_in_sets_text, distinct
from ogmp_sb3.evaluation.episodes import Progress, play_sets
from ogmp_sb3.evaluation.metrics import no_fall_fraction
from ogmp_sb3.evaluation.statistics import Estimate, estimate

SIZES = (0.0, 0.5, 1.0, 1.5, 2.0)  # 0: no disturbance, 1: the ends of the range
DELAY_SIZES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5)  # finer: a few milliseconds decide
LEAST = 0.05  # of factors and of friction
DEFAULT: ModeRanges = {
    "mass": {"scale": Range(0.9, 1.1)},
    "friction": {"coefficient": Range(0.5, 1.2)},
    "gains": {"scale": Range(0.9, 1.1)},
    "motor_strength": {"scale": Range(0.85, 1.15)},
    "action_delay": {"delay": Range(0.0, 0.02)},
    "sensor_noise": {"scale": Range(0.0, 0.1)},
    "push": {"speed": Range(0.0, 0.3)},
    "slope": {"pitch": Range(-0.05, 0.05)},
    "rough_ground": {"height": Range(0.0, 0.01)},
}
"""Ranges of what a task does not declare."""
LABELS = {
    "mass": "factor on mass",
    "friction": "friction coefficient",
    "gains": "factor on kp and kd",
    "motor_strength": "factor on motor strength",
    "action_delay": "delay of actions (s)",
    "sensor_delay": "age of observations (s)",
    "sensor_noise": "sensor noise (scales)",
    "push": "push (m/s)",
    "slope": "rise of the track (rad)",
    "rough_ground": "unseen height of boxes (m)",
    "wind": "wind (N)",
    "contact": "time constant of contacts (s)",
    "payload": "payload (kg)",
    "joint_offset": "offset of joints (rad)",
}


@dataclass(frozen=True)
class Sweep:
    """One disturbance and its sizes."""

    name: str
    """of the randomisation term"""
    ranges: dict[str, Range]
    """of its parameters: the task's, or the defaults"""
    none: dict[str, float]
    """their values where there is no disturbance"""
    declared: bool
    """whether the ranges are the task's"""
    physics_dt: float
    """physics step, to which delays are rounded, s"""

    @property
    def main(self) -> str:
        """The parameter that the sizes are told by: the first one that disturbs."""
        return next((key for key in self.ranges if self._reach(key) != (0.0, 0.0)), next(iter(self.ranges)))

    @property
    def label(self) -> str:
        """What it is, with its unit."""
        return LABELS.get(self.name, f"{self.name}: {self.main}")

    @property
    def points(self) -> dict[float, dict[str, float]]:
        """The parameters at every size, towards both ends of the ranges, by the value of the main one; ascending."""
        sizes = DELAY_SIZES if self.main == "delay" else SIZES
        points = {}
        for end in (0, 1):
            for size in sizes if self._reach(self.main)[end] else ():
                parameters = {key: self._value(key, size * self._reach(key)[end]) for key in self.ranges}
                points[parameters[self.main]] = parameters
        points.setdefault(self._value(self.main, 0.0), {key: self._value(key, 0.0) for key in self.ranges})
        return dict(sorted(points.items()))

    def _reach(self, key: str) -> tuple[float, float]:
        """How far the range of a parameter goes below and above its value without a disturbance."""
        range_, none = self.ranges[key], self.none[key]
        if key in registry.randomisations.not_sizes(self.name):
            return 0.0, 0.0
        return min(range_.low - none, 0.0), max(range_.high - none, 0.0)

    def _value(self, key: str, change: float) -> float:
        least, most = registry.randomisations.limits(self.name).get(key, (-math.inf, math.inf))
        none = self.none[key]
        value = min(max(none + change, least, LEAST if none > LEAST else -math.inf), most)
        if key == "delay":
            value = round(value / self.physics_dt) * self.physics_dt
        return float(round(value, 9 if key == "delay" else 4))


def task_disturbances(task: TaskConfig) -> list[Sweep]:
    """Every disturbance that the task declares or that is played of all tasks, in the order of the latter.

    :param task: as in training
    """
    measures = task.observations.get("proprioception") is not None
    names = [name for name in DEFAULT if name != "sensor_noise" or measures]
    return [
        Sweep(name, ranges, _none(task, name, ranges), name in task.randomised, task.physics_dt)
        for name in dict.fromkeys([*names, *task.randomised])
        if (ranges := task.randomised.get(name) or DEFAULT.get(name))
    ]


def _none(task: TaskConfig, name: str, ranges: dict[str, Range]) -> dict[str, float]:
    """The values of parameters where nothing is disturbed: their defaults, and the robot's own friction.

    Those that do not say how much are in the middle of their range.
    """
    parameters = registry.randomisations.parameters(name)
    when = registry.randomisations.not_sizes(name)
    middle = {key: 0.5 * (range_.low + range_.high) for key, range_ in ranges.items()}
    none = {key: middle[key] if key in when else parameters[key].default for key in ranges}
    robots = {"friction": _friction, "contact": _time_constant} if None in none.values() else {}
    return {
        key: float(value) if isinstance(value, int | float) else robots.get(name, lambda _, r=ranges[key]: r.low)(task)
        for key, value in none.items()
    }


def _friction(task: TaskConfig) -> float:
    """The sliding friction coefficient between feet and ground: the greater of the two, or that of higher priority."""
    model = build_model(task.robot_config, task.physics_dt, 1)
    ground, feet = model.geom("terrain_0"), foot_geoms(model, task.robot_config)
    friction, priority = model.geom_friction[feet, 0], model.geom_priority[feet] - ground.priority
    both = np.where(priority == 0, np.maximum(friction, ground.friction[0]), friction)
    return float(np.where(priority < 0, ground.friction[0], both).max())


def _time_constant(task: TaskConfig) -> float:
    """The time constant of contacts between feet and ground, s."""
    model = build_model(task.robot_config, task.physics_dt, 1)
    return float(model.geom_solref[foot_geoms(model, task.robot_config), 0].max())


def episode_sets(disturbances: list[Sweep]) -> int:
    """How many sets of episodes disturbances take; that without one is played once."""
    return 1 + sum(len(disturbance.points) - 1 for disturbance in disturbances)


def play_disturbed(
    disturbances: list[Sweep],
    policy: AnyPolicy,
    task: TaskConfig,
    episodes: int,
    seed: int,
    max_distance: float | None,
    progress: Progress,
) -> list[dict[str, Any]]:
    """The fraction of episodes without a fall under each disturbance alone, at each of its sizes.

    :param disturbances: of :func:`task_disturbances`
    :param task: under the protocol wanted
    :param episodes: at each size, on the same tracks; the rest as for
        :func:`~ogmp_sb3.evaluation.episodes.play_episodes`
    """
    sizes = [
        (each.name, value, parameters)
        for each in disturbances
        for value, parameters in each.points.items()
        if parameters != {key: each.none[key] for key in parameters}
    ]
    tasks = [replace(task, randomisation={name: fixed(parameters)}) for name, _, parameters in sizes]
    played = play_sets(policy, [replace(task, randomisation=None), *tasks], episodes, seed, max_distance, progress)
    undisturbed, *fractions = (
        estimate(no_fall_fraction(record) for record in distinct(records)).as_data() for records in played
    )
    found = {(name, value): fraction for (name, value, _), fraction in zip(sizes, fractions, strict=True)}
    results = []
    for each in disturbances:
        points = [
            {"value": value, "no_fall_fraction": found.get((each.name, value), undisturbed)} for value in each.points
        ]
        range_ = each.ranges[each.main]
        declared = [range_.low, range_.high] if each.declared else None
        results.append({"disturbance": each.name, "label": each.label, "declared": declared, "points": points})
    return results


def fixed(parameters: dict[str, float]) -> dict[str, Range]:
    """Parameters of a term that are not drawn."""
    return {key: Range(value, value) for key, value in parameters.items()}


def count_sets(request: Request) -> int:
    """How many sets of episodes the task's disturbances take."""
    return episode_sets(task_disturbances(request.training_task))


def measure_robustness(request: Request, progress: Progress) -> Report:
    """The fraction of episodes without a fall: ``robustness``, as :func:`play_disturbed` gives it."""
    disturbances = task_disturbances(request.training_task)
    policy, task, episodes, seed = request.policy, request.task, request.episodes, request.seed
    results = play_disturbed(disturbances, policy, task, episodes, seed, request.max_distance, progress)
    return {"robustness": results}


def robustness_rows(report: Report) -> list[dict[str, Any]]:
    """One row for each disturbance and size.

    :param report: of :func:`measure_robustness`
    """
    rows = []
    for result in report["robustness"]:
        for point in result["points"]:
            fraction = Estimate.from_data(point["no_fall_fraction"])
            rows.append({
                "disturbance": result["disturbance"], "value": point["value"], "episodes": fraction.n,
                "no_fall_fraction": fraction.mean, "ci95_low": fraction.low, "ci95_high": fraction.high,
            })  # fmt: skip
    return rows


def robustness_copies_text(report: Report) -> str:
    """A sentence on episodes that are copies of others; empty if there are none.

    :param report: of :func:`measure_robustness`, with the number of ``episodes`` of a set
    """
    points = [point for result in report["robustness"] for point in result["points"]]
    counted = (point["no_fall_fraction"]["n"] for point in points)
    return copies_in_sets_text(counted, report["episodes"], "sizes of disturbances")
