"""Epsilon: how far the states of a policy stray from the references of each oracle, mode by mode.

The paper's oracle is one whose reference stays within epsilon of the optimal states, and its bound must hold
rho >= epsilon. The states of a good policy stand in for the optimal ones here, so this is an estimate, and a biased
one: a policy that was trained within a rho of one oracle has learned to stay near that one. Episodes that end before
their time say nothing about optimal states and are left out.

A bound must hold at every step of an episode, so what counts of an episode is its greatest deviation: a rho that holds
95 % of the steps may end most episodes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import AnyPolicy
from ogmp_sb3.env.batch_env import BatchEnv, StepResult
from ogmp_sb3.env.endings import TIME_LIMIT
from ogmp_sb3.env.view import EnvView
from ogmp_sb3.evaluation.analysis import Report, Request
from ogmp_sb3.evaluation.copies import copies_text, first_of_each
from ogmp_sb3.evaluation.episodes import BATCH, Progress, play_batch
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.evaluation.statistics import Estimate, as_text, estimate
from ogmp_sb3.guidance.plans import Plans, make_oracle
from ogmp_sb3.guidance.set_points import Reference, SetPoints
from ogmp_sb3.guidance.srb import deviation

ESTIMATE = "an estimate, biased by the oracle and the rho of the training"  # what epsilon is
PERCENTILES = (50.0, 95.0, 100.0)
BOUNDS = tuple(k / 10 for k in range(1, 11))  # rho, in the unit of the deviation
ALL_MODES = "all"

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
    policy: AnyPolicy,
    task: TaskConfig,
    episodes: int,
    seed: int,
    progress: Progress,
    bounds: Iterable[float] = BOUNDS,
) -> dict[str, Any]:
    """How far whole episodes stray from each oracle.

    :param policy: a good one
    :param task: under the protocol wanted; its bound is taken off
    :param episodes: how many
    :param seed: episode ``i`` is seeded with ``seed + i``
    :param progress: called with control steps that are done with, of ``episodes`` times the time limit in all
    :param bounds: values of rho
    :return: plain data: the ``unit`` of deviations; ``episodes`` that are counted; ``left_out``, those that ended
        before their time; ``copies`` of either. ``maxima``, by oracle and mode (and ``all``), is about the greatest
        deviation of each episode: ``median``, ``p95``, ``max``, ``n``, and ``within``, the share of episodes that stay
        within each ``rho``. ``oracles``, by oracle and mode, is about the deviation at each control step: ``median``,
        ``p95``, ``max`` and ``steps``.
    """
    task = replace(task, rho=None)
    records: list[EpisodeRecord] = []
    deviations: list[Deviations] = []
    for first in range(0, episodes, BATCH):
        env = ShadowedEnv(task, min(BATCH, episodes - first), seed + first)
        records += play_batch(policy, env, None, progress)
        deviations += env.deviations
    different = first_of_each(records)
    whole = [deviations[i] for i in different if records[i].termination == TIME_LIMIT]
    weights = ", ".join(f"{name} {weight:g}" for name, weight in task.bound.items() if weight)
    names = list(task.oracle_params) if whole else []
    return {
        "unit": f"norm of W (x - x_ref), W: {weights}",
        "episodes": len(whole),
        "left_out": len(different) - len(whole),
        "copies": len(records) - len(different),
        "maxima": {name: _by_mode([each[name] for each in whole], bounds) for name in names},
        "oracles": {
            name: {mode: _of_steps([each[name].get(mode, []) for each in whole]) for mode in _modes(whole, name)}
            for name in names
        },
    }


def _modes(episodes: list[Deviations], oracle: str) -> list[str]:
    return sorted({mode for deviations in episodes for mode in deviations[oracle]})


def _by_mode(episodes: list[dict[str, list[float]]], bounds: Iterable[float]) -> dict[str, Any]:
    """What the greatest deviations of episodes come to, in all modes together and in each."""
    maxima: dict[str, list[float]] = {ALL_MODES: []}
    for modes in episodes:
        greatest = {mode: max(values) for mode, values in sorted(modes.items())}
        for mode, value in {ALL_MODES: max(greatest.values()), **greatest}.items():
            maxima.setdefault(mode, []).append(value)
    return {mode: _of_episodes(values, bounds) for mode, values in maxima.items()}


def _of_episodes(maxima: list[float], bounds: Iterable[float]) -> dict[str, Any]:
    within = [{"rho": rho, **estimate(bool(value <= rho) for value in maxima).as_data()} for rho in bounds]
    return {**_percentiles(maxima), "n": len(maxima), "within": within}


def _of_steps(episodes: list[list[float]]) -> dict[str, Any]:
    values = [value for values in episodes for value in values]
    return {**_percentiles(values), "steps": len(values)}


def _percentiles(values: list[float]) -> dict[str, float]:
    return {
        name: float(x) for name, x in zip(("median", "p95", "max"), np.percentile(values, PERCENTILES), strict=True)
    }


def measure_epsilon(request: Request, progress: Progress) -> Report:
    """The deviations of :func:`estimate_epsilon` with what biases them: ``epsilon``."""
    oracle, rho = request.trained_task.oracle, request.trained_task.rho
    bounds = sorted({*BOUNDS, *([] if rho is None else [rho])})
    found = estimate_epsilon(request.policy, request.task, request.episodes, request.seed, progress, bounds)
    return {"epsilon": {"what": ESTIMATE, "trained_with": {"oracle": oracle, "rho": rho}, **found}}


def epsilon_rows(report: Report) -> list[dict[str, Any]]:
    """The shares of whole episodes within a bound: one row for each oracle, mode and rho.

    :param report: of :func:`measure_epsilon`
    """
    return [
        {
            "oracle": oracle, "mode": mode, "rho": share["rho"], "episodes": share["n"], "within": share["mean"],
            "ci95_low": share["ci95"][0], "ci95_high": share["ci95"][1],
        }
        for oracle, modes in report["epsilon"]["maxima"].items()
        for mode, maxima in modes.items()
        for share in maxima["within"]
    ]  # fmt: skip


def epsilon_tables(epsilon: dict[str, Any]) -> Group:
    """What :func:`measure_epsilon` found, as Rich prints it: whole episodes, then modes, then what was counted."""
    rho = epsilon["trained_with"]["rho"]
    bias = f"an estimate biased by the training with {epsilon['trained_with']['oracle']}, rho {_rho_text(rho)}"
    counted = (
        f"Unit: {epsilon['unit']}. {epsilon['episodes']} episodes; {epsilon['left_out']} others ended before their "
        "time and are left out."
    )
    copies = copies_text(epsilon["copies"], sum(epsilon[key] for key in ("episodes", "left_out", "copies")))
    tables = [_bounds_table(f"epsilon, {bias}", epsilon["maxima"]), _modes_table(epsilon)] if epsilon["maxima"] else []
    return Group(*tables, Text(f"{counted} {copies}".rstrip()))


def _bounds_table(title: str, maxima: dict[str, Any]) -> Table:
    """The share of whole episodes within each bound, up to the first that holds all of them."""
    table = Table("within rho", *maxima, title=f"{title}\nshare of whole episodes", title_justify="left")
    shares = [[Estimate.from_data(share) for share in modes[ALL_MODES]["within"]] for modes in maxima.values()]
    bounds = [share["rho"] for share in next(iter(maxima.values()))[ALL_MODES]["within"]]
    for bound, row in zip(bounds, zip(*shares, strict=True), strict=True):
        table.add_row(f"{bound:g}", *(f"{x.mean:.2f} ({as_text([x.low, x.high], 2, '..')})" for x in row))
        if all(each.mean == 1.0 for each in row):
            break
    table.add_section()
    for name, label in (("median", "greatest: median"), ("p95", "greatest: 95 %"), ("max", "greatest: max")):
        table.add_row(label, *(f"{modes[ALL_MODES][name]:.3f}" for modes in maxima.values()))
    return table


def _modes_table(epsilon: dict[str, Any]) -> Table:
    """Deviations in each mode: the greatest of an episode, and those of all steps."""
    table = Table(title="by mode: greatest of an episode (n), and at each step", title_justify="left")
    for column in ("oracle", "mode", "median", "95 %", "max", "n", "step 50 %", "step 95 %", "steps"):
        table.add_column(column, justify="left" if column in ("oracle", "mode") else "right")
    for oracle, modes in epsilon["oracles"].items():
        for mode, steps in modes.items():
            of_episodes = epsilon["maxima"][oracle][mode]
            numbers = [f"{of_episodes[name]:.3f}" for name in ("median", "p95", "max")]
            of_steps = [f"{steps[name]:.3f}" for name in ("median", "p95")]
            table.add_row(oracle, mode, *numbers, str(of_episodes["n"]), *of_steps, f"{steps['steps']:,}")
    return table


def _rho_text(rho: float | None) -> str:
    return "null" if rho is None else f"{rho:g}"
