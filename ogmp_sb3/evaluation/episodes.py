"""Play a policy for whole episodes, and keep a record of each."""

from __future__ import annotations

from collections.abc import Callable

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

MAX_DISTANCE = "max_distance"
BATCH = 128  # episodes played together

Progress = Callable[[int], None]  # called with the number of episodes that have just ended


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
    :param progress: called with the number of episodes that have just ended
    :param stream: what the episodes are for; those of a test have other tracks than the training of the same seed
    :raises ValueError: if the policy does not fit the task
    """
    records: list[EpisodeRecord] = []
    for first in range(0, episodes, BATCH):
        env = BatchEnv(task, min(BATCH, episodes - first), seed + first, stream=stream)
        records += play_batch(policy, env, max_distance, progress or (lambda _: None))
    return records


def play_batch(policy: AnyPolicy, env: BatchEnv, max_distance: float | None, progress: Progress) -> list[EpisodeRecord]:
    """Play one episode in each environment; the parameters are those of :func:`play_episodes`."""
    observation = env.reset()
    start_x = env.sim.qpos[:, env.sim.base_qpos].copy()
    steps: list[dict[str, np.ndarray]] = [_snapshot(env, env.view(), np.zeros(env.num_envs))]
    ended = np.full(env.num_envs, "", dtype=object)
    length = np.zeros(env.num_envs, dtype=int)
    actor = Actor(policy, env.num_envs, env.observation_size)
    queries: list[list[Query]] = [[] for _ in range(env.num_envs)]
    while True:
        alive = np.flatnonzero(ended == "")
        if not len(alive):
            break
        _note_queries(env, alive, queries)
        result = env.step(actor.act(observation), alive)
        observation = result.observation
        steps.append(_snapshot(env, result.view, result.reward))
        length[alive] += result.termination[alive] != UNSTABLE
        reason = result.termination.astype(object)
        if max_distance is not None:
            far = env.sim.qpos[:, env.sim.base_qpos] - start_x >= max_distance
            reason[far & (reason == "")] = MAX_DISTANCE
        ended[alive] = reason[alive]
        finished = int((ended[alive] != "").sum())
        if finished:
            progress(finished)
    series = {name: np.stack([step[name] for step in steps], axis=1) for name in steps[0]}
    return [
        EpisodeRecord(
            **{name: values[row, : length[row] + 1] for name, values in series.items()},
            termination=str(ended[row]),
            control_dt=env.task.control_dt,
            max_steps=env.task.episode_steps,
            leg_length=env.task.robot_config.leg_length,
            track_length=env.task.track.length,
            modes=tuple({"mode": call.name, **call.parameters} for call in env.modes[row]),
            queries=tuple(queries[row]),
        )
        for row in range(env.num_envs)
    ]


def _note_queries(env: BatchEnv, rows: np.ndarray, queries: list[list[Query]]) -> None:
    """Keep what the oracle has just been asked for in some environments."""
    if env.task.uses_latent:
        for row in rows[env.guide.plans.phase[rows] == 0]:
            x = float(env.sim.qpos[row, env.sim.base_qpos])
            queries[row].append((env.plan(row), env.guide.mode_at(row, x)))


def _snapshot(env: BatchEnv, view: EnvView, reward: np.ndarray) -> dict[str, np.ndarray]:
    """The entries of one step in the records of all episodes, as copies: views would keep whole arrays in memory."""
    v = env.sim.base_qvel
    error = (view.state - view.reference)[:, np.r_[POS, VEL]]
    series = {
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
    return {name: values.copy() for name, values in series.items()}
