"""Epsilon: how far the states of a policy stray from the references of each oracle, mode by mode.

The paper's oracle is one whose reference stays within epsilon of the optimal states, and its bound must hold
rho >= epsilon. The states of a good policy stand in for the optimal ones here, so this is an estimate, and a biased
one: a policy that was trained within a rho of one oracle has learned to stay near that one. Episodes that end before
their time say nothing about optimal states and are left out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import AnyPolicy
from ogmp_sb3.env.batch_env import BatchEnv, StepResult
from ogmp_sb3.env.endings import TIME_LIMIT
from ogmp_sb3.env.view import EnvView, deviation
from ogmp_sb3.evaluation.analysis import Report, Request
from ogmp_sb3.evaluation.episodes import BATCH, Progress, play_batch
from ogmp_sb3.guidance.plans import Plans, make_oracle
from ogmp_sb3.guidance.set_points import Reference, SetPoints

ESTIMATE = "an estimate, biased by the oracle and the rho of the training"  # what epsilon is
PERCENTILES = (50.0, 95.0, 100.0)

Deviations = dict[str, dict[str, list[float]]]  # by oracle and mode


class ShadowedPlans(Plans):
    """Plans that also hold what every other oracle of the task has answered to the same queries."""

    def __init__(self, task: TaskConfig, num_envs: int, most_steps: int) -> None:
        super().__init__(task, num_envs, most_steps)
        self._oracles = {name: make_oracle(replace(task, oracle=name)) for name in task.oracle_params}
        self.shadows = {name: np.zeros_like(self.reference) for name in self._oracles}
        """by oracle: states, shape (num_envs, most_steps + 1, 12)"""

    def ask(self, rows: np.ndarray, points: SetPoints, x0: np.ndarray) -> Reference:
        """The own oracle's answer; those of the others are kept."""
        for name, oracle in self._oracles.items():
            states = oracle(points, x0).state
            self.shadows[name][rows, : states.shape[1]] = states
        return super().ask(rows, points, x0)


class ShadowedEnv(BatchEnv):
    """Environments in which every oracle of the task is asked what the task's own is asked.

    Robot and policy know only their own oracle. ``deviations`` collects ``||W (x - x_ref)||`` to each of them.
    """

    def __init__(self, task: TaskConfig, num_envs: int, seed: int) -> None:
        self._now: dict[str, np.ndarray] = {}
        self.deviations: list[Deviations] = [{name: {} for name in task.oracle_params} for _ in range(num_envs)]
        """of each environment, one for each control step"""
        super().__init__(task, num_envs, seed, stream="test")
        self.guide.plans = ShadowedPlans(task, num_envs, self.guide.course.most_steps)

    def view(self, rows: np.ndarray | None = None) -> EnvView:
        view = super().view(rows)
        if rows is None and isinstance(self.guide.plans, ShadowedPlans):
            every = np.arange(self.num_envs)
            self._now = {
                name: deviation(view.state, states[every, view.phase], self._weights)
                for name, states in self.guide.plans.shadows.items()
            }
        return view

    def step(self, actions: np.ndarray, rows: np.ndarray | None = None) -> StepResult:
        """As in :class:`~ogmp_sb3.env.batch_env.BatchEnv`; deviations of what is stepped are collected."""
        x = self.sim.qpos[:, self.sim.base_qpos]
        every = range(self.num_envs) if rows is None else rows
        modes = {row: self.guide.mode_at(row, float(x[row])).name for row in every}
        result = super().step(actions, rows)
        for name, values in self._now.items():
            for row, mode in modes.items():
                self.deviations[row][name].setdefault(mode, []).append(float(values[row]))
        return result


def estimate_epsilon(
    policy: AnyPolicy, task: TaskConfig, episodes: int, seed: int, progress: Progress
) -> dict[str, Any]:
    """Median, 95th percentile and greatest deviation from each oracle in each mode, over whole episodes.

    :param policy: a good one
    :param task: under the protocol wanted; its bound is taken off
    :param episodes: how many
    :param seed: episode ``i`` is seeded with ``seed + i``
    :param progress: called with the number of episodes that have just ended
    :return: plain data: ``oracles``, by oracle and mode ``median``, ``p95``, ``max`` and ``steps``; their ``unit``;
        ``episodes`` that are counted, and ``left_out``, those that ended before their time
    """
    task = replace(task, rho=None)
    deviations: Deviations = {}
    whole = 0
    for first in range(0, episodes, BATCH):
        env = ShadowedEnv(task, min(BATCH, episodes - first), seed + first)
        records = play_batch(policy, env, None, progress)
        kept = [row for row, record in enumerate(records) if record.termination == TIME_LIMIT]
        whole += len(kept)
        for row in kept:
            for oracle, modes in env.deviations[row].items():
                for mode, values in modes.items():
                    deviations.setdefault(oracle, {}).setdefault(mode, []).extend(values)
    weights = ", ".join(f"{name} {weight:g}" for name, weight in task.bound.items() if weight)
    return {
        "unit": f"norm of W (x - x_ref), W: {weights}",
        "episodes": whole,
        "left_out": episodes - whole,
        "oracles": {
            oracle: {mode: _percentiles(values) for mode, values in sorted(modes.items())}
            for oracle, modes in deviations.items()
        },
    }


def _percentiles(values: list[float]) -> dict[str, float]:
    median, p95, greatest = (float(x) for x in np.percentile(values, PERCENTILES))
    return {"median": median, "p95": p95, "max": greatest, "steps": len(values)}


def measure_epsilon(request: Request, progress: Progress) -> Report:
    """The deviations of :func:`estimate_epsilon` with what biases them: ``epsilon``."""
    trained_with = {"oracle": request.trained_task.oracle, "rho": request.trained_task.rho}
    deviations = estimate_epsilon(request.policy, request.task, request.episodes, request.seed, progress)
    return {"epsilon": {"what": ESTIMATE, "trained_with": trained_with, **deviations}}
