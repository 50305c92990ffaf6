"""Which rule ends an episode: a failed simulation, the bound, terms of the task, the reward floor, the time limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.view import EnvView

RUNNING, UNSTABLE, BOUND, LOW_REWARD, TIME_LIMIT = "", "unstable", "bound", "low_reward", "time_limit"


def ending(
    task: TaskConfig,
    terms: Mapping[str, Callable[[EnvView], np.ndarray]],
    view: EnvView,
    reward: np.ndarray,
    unstable: np.ndarray,
    step_count: np.ndarray,
    restarted: np.ndarray,
) -> np.ndarray:
    """The rule that ends each episode at this control step; of several the first, ``RUNNING`` where none holds.

    :param task: says the bound, the reward floor and the time limits
    :param terms: its termination terms, by name
    :param view: the step
    :param reward: of the step, shape (num_envs,)
    :param unstable: simulations that have failed, shape (num_envs,), bool
    :param step_count: control steps of the episodes, this one included, shape (num_envs,), int
    :param restarted: episodes that began before an earlier fall, which have a time limit of their own, shape
        (num_envs,), bool
    :return: names of rules, shape (num_envs,)
    """
    rules = [(UNSTABLE, unstable)]
    if task.rho is not None:
        rules.append((BOUND, view.deviation > task.rho))
    rules += [(name, term(view)) for name, term in terms.items()]
    if task.min_step_reward is not None:
        rules.append((LOW_REWARD, reward < task.min_step_reward))
    limit = np.full(len(step_count), task.episode_steps)
    if task.restarts is not None:
        limit[restarted] = task.restarts.episode_steps
    rules.append((TIME_LIMIT, step_count >= limit))
    first = np.full(len(step_count), len(rules))
    for i, (_, holds) in reversed(list(enumerate(rules))):
        first[holds] = i
    names: np.ndarray = np.array([*(name for name, _ in rules), RUNNING])[first]
    return names
