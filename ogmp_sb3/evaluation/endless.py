"""Tests on tracks without end, until the robot falls or is far along."""

from __future__ import annotations

import math
from dataclasses import replace

from ogmp_sb3.config.task import TaskConfig

SLOWEST = 0.1  # m/s: an endless episode slower than this is over
MAX_DISTANCE = 200.0  # m
NO_LIMIT = ("episode_length_fraction",)  # metrics that mean nothing where an episode has no end


def endless(task: TaskConfig, max_distance: float) -> TaskConfig:
    """A task on tracks without end.

    :param task: of modes along a track, under its test protocol
    :param max_distance: how far episodes may go, m; their time limit is that of a robot at :data:`SLOWEST`
    """
    steps = math.ceil(max_distance / SLOWEST / task.control_dt)
    metrics = tuple(name for name in task.evaluation.metrics if name not in NO_LIMIT)
    evaluation = replace(task.evaluation, metrics=metrics, track_length=None)
    return replace(task, track=replace(task.track, length=None), episode_steps=steps, evaluation=evaluation)
