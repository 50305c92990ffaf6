"""References as policies ask for them: along whole random courses, of robots that stray. Nothing is simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.guide import Guide
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.srb import POS, STATE_SIZE, VEL

# How far robots are from the end of a reference when they ask for the next one, standard deviations. In 48 test
# episodes each of the shipped policies the root mean square was 0.12, 0.04, 0.06 m and 0.23, 0.08, 0.69 m/s in
# parkour, and 0.08, 0.10, 0.11 m and 0.76, 0.89, 0.60 m/s after the flips of dive.
SPREAD = np.zeros(STATE_SIZE)
SPREAD[POS] = 0.15, 0.1, 0.1  # m
SPREAD[VEL] = 0.5, 0.5, 0.7  # m/s

Query = tuple[np.ndarray, ModeCall]
"""the reference that answers a query, shape (knots + 1, 12), and the mode under the base"""


@dataclass(frozen=True)
class ReferenceData:
    """References with the modes that robots were in when they asked for them."""

    state: np.ndarray
    """shape (n, knots + 1, 12), padded behind each row's steps"""
    steps: np.ndarray
    """shape (n,), int"""
    calls: list[ModeCall]
    """mode and parameters under the base of each"""

    @property
    def mask(self) -> np.ndarray:
        """Which knots are meant, shape (n, knots + 1), bool."""
        return np.arange(self.state.shape[1]) <= self.steps[:, None]

    @property
    def modes(self) -> np.ndarray:
        """The names of the modes, shape (n,), text."""
        return np.array([call.name for call in self.calls])


def collect(queries: list[Query]) -> ReferenceData:
    """Queries, at least one, as arrays."""
    steps = np.array([len(state) - 1 for state, _ in queries])
    longest = steps.max()
    padded = [np.pad(state, ((0, longest + 1 - len(state)), (0, 0)), mode="edge") for state, _ in queries]
    return ReferenceData(np.stack(padded), steps, [call for _, call in queries])


def reference_data(task: TaskConfig, references: int, seeds: np.random.SeedSequence) -> ReferenceData:
    """Draw courses of a task as a training does, and ask its oracle along each for as long as an episode lasts.

    A robot begins at rest at the start. It asks again at the end of each reference, where it is about as far from
    that end as robots are (``SPREAD``); so it does from anywhere on the course.

    :param references: how many, at least 1
    :param seeds: every course has a generator from here
    """
    unseen = replace(task, observations={**task.observations, "mode_latent": None}, critic_observations={})
    guide, queries = Guide(unseen, 1), list[Query]()  # without its encoder, which need not be there yet
    while len(queries) < references:
        queries += _course(task, guide, np.random.default_rng(seeds.spawn(1)[0]))
    return collect(queries[:references])


def _course(task: TaskConfig, guide: Guide, rng: np.random.Generator) -> list[Query]:
    """The queries of one episode."""
    row, level = np.zeros(1, dtype=int), np.array([1.0 if task.curriculum is None else rng.random()])
    state = np.zeros((1, STATE_SIZE))
    state[0, POS.start + 2] = guide.begin(0, rng, level[0]) + task.robot_config.nominal_height
    guide.query(row, state)
    queries: list[Query] = []
    left = task.episode_steps
    while left > 0:
        plan = guide.plan(0)
        queries.append((plan, guide.mode_at(0, float(state[0, POS.start]))))
        left -= len(plan) - 1
        state = plan[-1:] + SPREAD * rng.standard_normal(STATE_SIZE)
        guide.to_end(row)
        guide.follow(row, state[:, POS.start], state.__getitem__, [rng], level)
    return queries
