"""Play a policy for whole episodes, many of them together, and keep a record of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import Actor, AnyPolicy
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.endings import UNSTABLE
from ogmp_sb3.env.streams import Stream
from ogmp_sb3.env.view import EnvView
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.guidance.reference_data import Query
from ogmp_sb3.guidance.srb import POS, VEL
from ogmp_sb3.sb3.threads import torch_threads

MAX_DISTANCE = "max_distance"
BATCH = 256  # episodes played together; twice as many are hardly faster, and an interrupt would lose more

Progress = Callable[[int], None]
"""Called with control steps that are done with: played, or not needed since their episode has ended before its time."""

Watch = Callable[[EnvView, np.ndarray, np.ndarray], None]
"""Called at the start and after every control step with the view, the rewards, and the rows that have a new record."""

Steps = dict[str, np.ndarray]  # entries of records by name


def play_episodes(
    policy: AnyPolicy,
    task: TaskConfig,
    episodes: int,
    seed: int,
    max_distance: float | None = None,
    progress: Progress | None = None,
    stream: Stream = "test",
) -> list[EpisodeRecord]:
    """Play whole episodes, deterministically; every environment plays one, so none is over-represented.

    :param policy: a model, a policy or a loaded policy (:data:`~ogmp_sb3.env.agent.AnyPolicy`)
    :param task: the task, under the protocol wanted
    :param episodes: how many
    :param seed: episode ``i`` is seeded with ``seed + i``
    :param max_distance: an episode also ends this far along the track, m
    :param progress: called with control steps that are done with, of ``episodes`` times the time limit in all
    :param stream: what the episodes are for; those of a test have other tracks than the training of the same seed
    :raises ValueError: if the policy does not fit the task
    """
    return next(play_sets(policy, [task], episodes, seed, max_distance, progress, stream), [])


def play_sets(
    policy: AnyPolicy,
    tasks: Sequence[TaskConfig],
    episodes: int,
    seed: int,
    max_distance: float | None = None,
    progress: Progress | None = None,
    stream: Stream = "test",
) -> Iterator[list[EpisodeRecord]]:
    """Play a set of episodes of every task, :data:`BATCH` episodes together, whichever their sets.

    The parameters are those of :func:`play_episodes`, and so are the episodes.

    :param tasks: such as differ in what is drawn alone (:func:`~ogmp_sb3.env.row_tasks.common_task`)
    :param episodes: of each task
    :return: the records of each task in order, as soon as all are there
    """
    queue = [(task, seed + i) for task in tasks for i in range(episodes)]
    records: list[EpisodeRecord] = []
    for first in range(0, len(queue), BATCH):
        row_tasks, seeds = zip(*queue[first : first + BATCH], strict=True)
        env = BatchEnv(row_tasks[0], len(seeds), stream=stream, row_tasks=row_tasks)
        for row, row_seed in enumerate(seeds):
            env.seed_row(row, row_seed)
        records += play_batch(policy, env, max_distance, progress or (lambda _: None))
        while len(records) >= episodes:
            yield records[:episodes]
            del records[:episodes]


def play_batch(
    policy: AnyPolicy, env: BatchEnv, max_distance: float | None, progress: Progress, watch: Watch | None = None
) -> list[EpisodeRecord]:
    """Play one episode in each environment; the parameters are those of :func:`play_episodes`.

    :param watch: sees every step of the episodes; None: nobody looks
    """
    observation = env.reset()
    every, limit = np.arange(env.num_envs), env.task.episode_steps
    start_x = env.sim.qpos[:, env.sim.base_qpos].copy()
    rows, steps = [every], [_entries(env, env.view(), np.zeros(env.num_envs), every)]
    if watch is not None:
        watch(env.view(), np.zeros(env.num_envs), every)
    ended = np.full(env.num_envs, "", dtype=object)
    done_with = np.zeros(env.num_envs, dtype=int)  # control steps
    actor = Actor(policy, env.num_envs, env.observation_size)
    queries: list[list[Query]] = [[] for _ in every]
    while len(alive := np.flatnonzero(ended == "")):
        _note_queries(env, alive, queries)
        with torch_threads(1):  # the network is too small for more, which wait for each other where others work too
            action = actor.act(observation)
        result = env.step(action, alive)
        observation = result.observation
        rows.append(alive[result.termination[alive] != UNSTABLE])
        steps.append(_entries(env, result.view, result.reward, rows[-1]))
        if watch is not None:
            watch(result.view, result.reward, rows[-1])
        reason, share = result.termination.astype(object), env.step_count / limit
        if max_distance is not None:
            way = (env.sim.qpos[:, env.sim.base_qpos] - start_x) / max_distance
            reason[(way >= 1.0) & (reason == "")] = MAX_DISTANCE
            share = np.fmax(share, way)  # else most would seem left to do until the robots arrive
        ended[alive] = reason[alive]
        now = np.where(ended[alive] == "", limit * share[alive], limit).astype(int)
        progress(int(np.maximum(now - done_with[alive], 0).sum()))
        done_with[alive] = np.maximum(now, done_with[alive])
    return [
        EpisodeRecord(
            **series,
            termination=str(ended[row]),
            control_dt=env.task.control_dt,
            max_steps=limit,
            leg_length=env.task.robot_config.leg_length,
            nominal_height=env.task.robot_config.nominal_height,
            track_length=env.task.track.length,
            modes=tuple({"mode": call.name, **call.parameters} for call in env.modes[row]),
            queries=tuple(queries[row]),
        )
        for row, series in enumerate(_by_row(rows, steps, env.num_envs))
    ]


def _note_queries(env: BatchEnv, rows: np.ndarray, queries: list[list[Query]]) -> None:
    """Keep what the oracle has just been asked for in some environments."""
    if env.task.uses_latent:
        for row in rows[env.guide.plans.phase[rows] == 0]:
            x = float(env.sim.qpos[row, env.sim.base_qpos])
            queries[row].append((env.plan(row), env.guide.mode_at(row, x)))


def _entries(env: BatchEnv, view: EnvView, reward: np.ndarray, rows: np.ndarray) -> Steps:
    """The entries of one step in the records of some episodes, as copies: views would keep whole arrays in memory.

    :param rows: the environments, shape (n,), int
    """
    v = env.sim.base_qvel
    error = (view.state - view.reference)[:, np.r_[POS, VEL]]
    entries = {
        "base_pos_w": view.base_pos_w,
        "base_quat": view.base_quat,
        "base_linvel_w": view.base_linvel_w,
        "base_linacc_w": env.sim.qacc[:, v : v + 3],
        "height": view.base_pos_w[:, 2] - np.maximum(view.ground_height, 0.0),
        "state_error": np.linalg.norm(error, axis=1),
        "reward": reward,
        "reference_pos_w": view.reference[:, POS],
        "phase": view.phase,
        "deviation": view.deviation,
    }
    return {name: values[rows] for name, values in entries.items()}


def _by_row(rows: list[np.ndarray], steps: list[Steps], num_envs: int) -> Iterator[Steps]:
    """The entries of successive steps, sorted by environment.

    :param rows: the environments of each step
    :param steps: their entries, which are taken out as they are sorted, so that little is in memory twice
    :return: of each environment, one array for each name
    """
    order = np.argsort(np.concatenate(rows), kind="stable")
    ends = np.cumsum(np.bincount(np.concatenate(rows), minlength=num_envs))
    series = {name: np.concatenate([step.pop(name) for step in steps])[order] for name in list(steps[0])}
    for begin, end in zip([0, *ends[:-1]], ends, strict=True):
        yield {name: values[begin:end] for name, values in series.items()}
