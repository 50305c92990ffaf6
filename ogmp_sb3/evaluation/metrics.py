"""Metrics and true objectives: pure functions of one episode's record."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ogmp_sb3.config.registry import metrics, objectives
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.rewards import highest_reward
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.evaluation.speed import mean_over_steps, stretches
from ogmp_sb3.evaluation.statistics import Limits
from ogmp_sb3.guidance.rotations import quat_conjugate, quat_multiply, quat_rotate
from ogmp_sb3.guidance.srb import GRAVITY

FULL_TURN_TOLERANCE = 0.5  # rad
UPRIGHT_TOLERANCE = 0.5  # rad, between the base's up axis and the world's
UPRIGHT_TIME = 1.0  # s, at the end of a dive
SURVIVED = ("time_limit", "max_distance")  # what ends an episode without a fall
LOW = 0.6  # nominal heights of the base over the terrain, below which a robot has fallen (0.3 m for HECTOR)

Metric = TypeVar("Metric", bound=Callable[[EpisodeRecord], float])
Objective = TypeVar("Objective", bound=Callable[[EpisodeRecord], float])


def limited(least: float | None = None, most: float | None = None) -> Callable[[Metric], Metric]:
    """Decorator that says what a metric is never below or above, where the interval of its mean is cut off.

    :param least: None: nothing bounds it
    :param most: None: nothing bounds it
    """

    def declare(metric: Metric) -> Metric:
        metric.limits = (least, most)  # type: ignore[attr-defined]
        return metric

    return declare


def limits_of(metric: Callable[[EpisodeRecord], float]) -> Limits:
    """What a metric is never below and above, as :func:`limited` says."""
    limits: Limits = getattr(metric, "limits", (None, None))
    return limits


@metrics.register()
@limited(least=0.0)
def max_heading_acceleration_g(record: EpisodeRecord) -> float:
    """Largest norm of the base's linear acceleration at control steps, in g (paper: M.H.A.)."""
    return float(np.linalg.norm(record.base_linacc_w, axis=1).max() / GRAVITY)


@metrics.register()
def max_heading_speed_mps(record: EpisodeRecord) -> float:
    """Largest velocity along the track, m/s (paper: M.H.S.)."""
    return float(record.base_linvel_w[:, 0].max())


@metrics.register()
@limited(least=0.0)
def speed_error_mps(record: EpisodeRecord) -> float:
    """Distance of the speed along the track from the commanded one, m/s: the mean over the control steps, the speed
    averaged over stretches of at most a second before (:mod:`ogmp_sb3.evaluation.speed`).

    :raises ValueError: for timed modes, which command no speed
    """
    first = record.calls[0].segment()
    if first.timed:
        raise ValueError("metric 'speed_error_mps' is for modes along a track; these take a time.")
    parts = stretches(record)
    if not parts:  # the simulation failed in the first step: the robot has not moved
        return abs(first.spans[0].velocity[0])
    return mean_over_steps(parts, lambda part: part.error)


@metrics.register()
@limited(least=0.0)
def max_froude(record: EpisodeRecord) -> float:
    """Froude number ``v^2 / (g leg_length)`` of the largest heading speed (paper: M.F.)."""
    return max_heading_speed_mps(record) ** 2 / (GRAVITY * record.leg_length)


@metrics.register()
@limited(least=0.0, most=1.0)
def episode_length_fraction(record: EpisodeRecord) -> float:
    """Steps survived over the time limit (paper: E.L.)."""
    return record.steps / record.max_steps


@metrics.register()
def no_fall_fraction(record: EpisodeRecord) -> bool:
    """1 if the episode ended by its time limit, or at the distance asked for."""
    return record.termination in SURVIVED


@metrics.register()
def distance_m(record: EpisodeRecord) -> float:
    """Displacement along the track, m."""
    return float(record.base_pos_w[-1, 0] - record.base_pos_w[0, 0])


@metrics.register("return")
def undiscounted_return(record: EpisodeRecord) -> float:
    """Sum of the training reward."""
    return float(record.reward.sum())


@metrics.register()
@limited(least=0.0)
def surrogate_objective(record: EpisodeRecord) -> float:
    """``sum ||x - x_ref||`` over position and velocity (paper, sec. III-A); less is better."""
    return float(record.state_error[1:].sum())


@metrics.register()
def success_rate(record: EpisodeRecord) -> bool:
    """1 if the true objective of a dive is met: see :func:`flip_and_land`."""
    return flip_and_land(record)


def reaches(highest: Callable[[TaskConfig], float | None]) -> Callable[[Objective], Objective]:
    """Decorator that says what an objective can reach at most, for pictures (paper, fig:abl).

    :param highest: gives it for a task; None: nothing bounds it
    """

    def declare(objective: Objective) -> Objective:
        objective.highest = highest  # type: ignore[attr-defined]
        return objective

    return declare


def highest_objective(task: TaskConfig) -> float | None:
    """What the true objective of a task can reach at most, as :func:`reaches` says; None if it does not."""
    highest = getattr(objectives.get(task.objective), "highest", None)
    return None if highest is None else highest(task)


def highest_return(task: TaskConfig) -> float | None:
    """The highest return of an episode of the test protocol, None if it is not known."""
    reward = highest_reward(task.rewards)
    return None if reward is None else reward * task.evaluation.episode_steps


@objectives.register()
@reaches(lambda task: task.evaluation.track_length)
def track_displacement(record: EpisodeRecord) -> float:
    """Parkour: displacement along the track, up to its end, m."""
    displacement = distance_m(record)
    return displacement if record.track_length is None else min(displacement, record.track_length)


@objectives.register()
@reaches(lambda task: 1.0)
def flip_and_land(record: EpisodeRecord) -> bool:
    """Dive: 1 if the base turned once about the flip's axis, never came low, and stood upright at the end."""
    direction = next((str(m["r"]) for m in record.modes if "r" in m), "front")
    turned = abs(flip_angle(record.base_quat, direction) - 2 * np.pi) <= FULL_TURN_TOLERANCE
    up = quat_rotate(record.base_quat, np.array([0.0, 0.0, 1.0]))[:, 2]
    last = max(1, round(UPRIGHT_TIME / record.control_dt))  # control steps
    upright = bool((up[-last:] >= np.cos(UPRIGHT_TOLERANCE)).all())
    high = bool((record.height >= LOW * record.nominal_height).all())
    return bool(turned and upright and high and record.termination == "time_limit")


def flip_angle(quat: np.ndarray, direction: str) -> float:
    """How far the base turned about the flip's body axis, rad, positive in the flip's sense.

    :param quat: shape (steps + 1, 4)
    :param direction: front, back, left or right
    """
    delta = quat_multiply(quat_conjugate(quat[:-1]), quat[1:])
    delta *= np.where(delta[:, :1] < 0, -1.0, 1.0)  # the short way round
    axis, sign = {"front": (1, 1), "back": (1, -1), "right": (0, 1), "left": (0, -1)}[direction]
    norm = np.linalg.norm(delta[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(norm, delta[:, 0])
    return float(sign * (angle * delta[:, 1 + axis] / np.maximum(norm, 1e-12)).sum())
