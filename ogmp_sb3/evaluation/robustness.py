"""Play a policy under disturbances, one at a time, to see how much it withstands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.variation import MAX_LATENCY, PushConfig, RandomisationConfig
from ogmp_sb3.env.agent import AnyPolicy
from ogmp_sb3.env.ground_contacts import foot_geoms
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.evaluation.analysis import Report, Request
from ogmp_sb3.evaluation.copies import copies_in_sets_text, distinct
from ogmp_sb3.evaluation.episodes import Progress, play_sets
from ogmp_sb3.evaluation.metrics import no_fall_fraction
from ogmp_sb3.evaluation.statistics import Estimate, estimate

SIZES = (0.0, 0.5, 1.0, 1.5, 2.0)  # 0: no disturbance, 1: the ends of the range
LATENCY_SIZES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5)  # finer: a few milliseconds decide
LEAST = 0.05  # of factors and of friction
DEFAULT = RandomisationConfig(
    mass=Range(0.9, 1.1),
    friction=Range(0.5, 1.2),
    gains=Range(0.9, 1.1),
    latency=Range(0.0, 0.02),
    sensor_noise=Range(0.0, 0.1),
    push=PushConfig(speed=Range(0.0, 0.3)),
)
"""Ranges of what a task does not declare."""


@dataclass(frozen=True)
class Disturbance:
    """One disturbance and its sizes."""

    name: str
    """key of the task file"""
    label: str
    """what it is, with its unit"""
    none: float
    """where there is no disturbance"""
    range: Range
    """the task's, or the default"""
    declared: bool
    """whether the range is the task's"""
    push_every: float
    """time between pushes, s"""
    physics_dt: float
    """physics step, to which latency is rounded, s"""

    @property
    def values(self) -> np.ndarray:
        """Every size, towards both ends of the range; ascending."""
        reach = np.array([min(self.range.low - self.none, 0.0), max(self.range.high - self.none, 0.0)])
        if self.name == "latency":
            steps = np.rint(np.outer(LATENCY_SIZES, reach) / self.physics_dt)
            return np.unique(np.minimum(steps * self.physics_dt, MAX_LATENCY).round(9))
        values = self.none + np.outer(SIZES, reach).ravel()
        return np.unique(np.maximum(values, min(LEAST, self.none)).round(4))

    def randomisation(self, value: float) -> RandomisationConfig:
        """This disturbance at a size, and no other."""
        fixed: Any = Range(value, value)
        if self.name == "push":
            fixed = PushConfig(every=self.push_every, speed=fixed)
        return replace(RandomisationConfig(), **{self.name: fixed})


def task_disturbances(task: TaskConfig) -> list[Disturbance]:
    """Every disturbance; noise only where there is an observation that has it.

    :param task: as in training
    """
    declared = task.randomisation or RandomisationConfig()
    every = (declared.push or DEFAULT.push).every  # type: ignore[union-attr]
    disturbances = []
    for name, label, none in (
        ("mass", "factor on mass", 1.0),
        ("friction", "friction coefficient", _friction(task)),
        ("gains", "factor on kp and kd", 1.0),
        ("latency", "latency (s)", 0.0),
        ("sensor_noise", "sensor noise (scales)", 0.0),
        ("push", f"push (m/s, every {every:g} s)", 0.0),
    ):
        if name == "sensor_noise" and task.observations.get("proprioception") is None:
            continue
        own = getattr(declared, name)
        values = own or getattr(DEFAULT, name)
        range_ = values.speed if isinstance(values, PushConfig) else values
        disturbances.append(Disturbance(name, label, none, range_, own is not None, every, task.physics_dt))
    return disturbances


def _friction(task: TaskConfig) -> float:
    """The sliding friction coefficient between feet and ground: the greater of the two, or that of higher priority."""
    model = build_model(task.robot_config, task.physics_dt, 1)
    ground, feet = model.geom("terrain_0"), foot_geoms(model, task.robot_config)
    friction, priority = model.geom_friction[feet, 0], model.geom_priority[feet] - ground.priority
    both = np.where(priority == 0, np.maximum(friction, ground.friction[0]), friction)
    return float(np.where(priority < 0, ground.friction[0], both).max())


def episode_sets(disturbances: list[Disturbance]) -> int:
    """How many sets of episodes disturbances take; that without one is played once."""
    return 1 + sum(len(disturbance.values) - 1 for disturbance in disturbances)


def play_disturbed(
    disturbances: list[Disturbance],
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

    sizes = [(each, value) for each in disturbances for value in each.values.tolist() if value != each.none]
    tasks = [replace(task, randomisation=each.randomisation(value)) for each, value in sizes]
    played = play_sets(policy, [replace(task, randomisation=None), *tasks], episodes, seed, max_distance, progress)
    undisturbed, *fractions = (
        estimate(no_fall_fraction(record) for record in distinct(records)).as_data() for records in played
    )
    found = {(each.name, value): fraction for (each, value), fraction in zip(sizes, fractions, strict=True)}
    results = []
    for each in disturbances:
        points = [
            {"value": value, "no_fall_fraction": found.get((each.name, value), undisturbed)}
            for value in each.values.tolist()
        ]
        declared = [each.range.low, each.range.high] if each.declared else None
        results.append({"disturbance": each.name, "label": each.label, "declared": declared, "points": points})
    return results


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
