"""Choose test episodes by their return, and record what is drawn of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import AnyPolicy
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.view import EnvView
from ogmp_sb3.evaluation.copies import first_of_each
from ogmp_sb3.evaluation.episodes import Progress, play_batch, play_episodes
from ogmp_sb3.evaluation.metrics import no_fall_fraction, undiscounted_return
from ogmp_sb3.rendering.frame import Frame, frame_of
from ogmp_sb3.rendering.replay import RecordedEpisode
from ogmp_sb3.rendering.video import begins

RECORDED = 4  # episodes at most: best, median, worst and a fall


def choose(returns: Sequence[float], fell: Sequence[bool]) -> dict[int, str]:
    """The episodes that say most about a policy: best, median and worst by return, and the best one that fell.

    :param returns: of each episode
    :param fell: whether it ended in a fall
    :return: what is special about them, by their number
    """
    order = np.argsort(-np.asarray(returns), kind="stable").tolist()
    chosen: dict[int, list[str]] = {}
    for name, number in (("best", order[0]), ("median", order[len(order) // 2]), ("worst", order[-1])):
        chosen.setdefault(number, []).append(name)
    fallen = [number for number in order if fell[number]]
    if fallen:
        other = [number for number in fallen if number not in chosen]
        chosen.setdefault((other or fallen)[0], []).append("a fall")
    return {number: ", ".join(names) for number, names in chosen.items()}


def record_chosen(
    policy: AnyPolicy, task: TaskConfig, episodes: int, seed: int, progress: Progress | None = None
) -> list[RecordedEpisode]:
    """Play test episodes, and record those that :func:`choose` names, from the best to the worst.

    :param policy: a model, a policy or a loaded policy (:data:`~ogmp_sb3.env.agent.AnyPolicy`)
    :param task: the task, under the protocol wanted
    :param episodes: how many there are to choose from
    :param seed: episode ``i`` is seeded with ``seed + i``
    :param progress: called with control steps that are done with, of ``episodes + RECORDED`` times the time limit
        at most
    :raises ValueError: if the policy does not fit the task
    """
    played = play_episodes(policy, task, episodes, seed, progress=progress)
    different = first_of_each(played)
    returns = [undiscounted_return(played[i]) for i in different]
    chosen = choose(returns, [not no_fall_fraction(played[i]) for i in different])
    best_first = sorted(chosen, key=lambda number: -returns[number])
    seeds = [seed + different[number] for number in best_first]
    frames = record_frames(policy, task, seeds, progress)
    return [
        RecordedEpisode(
            name=chosen[number] if len(different) > 1 else "the episode",
            detail=f"seed {own_seed}, return {returns[number]:.1f}, {_ended(taken, task)}",
            frames=taken,
        )
        for number, own_seed, taken in zip(best_first, seeds, frames, strict=True)
    ]


def record_frames(
    policy: AnyPolicy, task: TaskConfig, seeds: Sequence[int], progress: Progress | None = None
) -> list[list[Frame]]:
    """Play one test episode for each seed, and keep every control step as a frame.

    The episodes are those that :func:`~ogmp_sb3.evaluation.episodes.play_episodes` plays with the same seeds.

    :param policy: a model, a policy or a loaded policy
    :param task: the task, under the protocol wanted
    :param progress: called with control steps that are done with, of the time limit for each seed
    :raises ValueError: if the policy does not fit the task
    """
    env = BatchEnv(task, len(seeds), stream="test")
    for row, seed in enumerate(seeds):
        env.seed_row(row, seed)
    frames: list[list[Frame]] = [[] for _ in seeds]

    def watch(view: EnvView, reward: np.ndarray, rows: np.ndarray) -> None:
        for row in rows.tolist():
            before = frames[row][-1] if frames[row] else None
            frames[row].append(frame_of(env, row, view, before, float(reward[row]), ""))

    records = play_batch(policy, env, None, progress or (lambda _: None), watch)
    for taken, record in zip(frames, records, strict=True):
        taken[-1] = replace(taken[-1], ended=record.termination)
    return frames


def oracle_episodes(frames: list[Frame], seed: int) -> list[RecordedEpisode]:
    """What a player without a policy showed, as episodes.

    :param frames: of one episode after another
    :param seed: of the first
    """
    starts = [*np.flatnonzero(begins(frames)).tolist(), len(frames)]
    parts = [frames[first:end] for first, end in itertools.pairwise(starts)]
    return [
        RecordedEpisode(name=f"episode {i}" if len(parts) > 1 else "the episode", detail=f"seed {seed}", frames=part)
        for i, part in enumerate(parts, 1)
        if len(part) > 1
    ]


def _ended(frames: list[Frame], task: TaskConfig) -> str:
    """How an episode ended, when, and where if there is a track."""
    first, last = frames[0], frames[-1]
    way = "" if task.horizon is None else f" and {round(last.base[0] - first.base[0], 1) + 0.0} m"
    return f"{last.ended.replace('_', ' ')} after {last.time:.1f} s{way}"
