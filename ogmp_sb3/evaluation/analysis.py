"""What ``ogmp-eval`` can be asked for: an analysis plays sets of episodes and gives entries of a report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import AnyPolicy
from ogmp_sb3.evaluation.episodes import Progress

Report = dict[str, Any]  # plain data, as in a JSON file


@dataclass(frozen=True, kw_only=True)
class Request:
    """What an analysis is to measure."""

    policy: AnyPolicy
    """the policy"""
    task: TaskConfig
    """under the protocol wanted, with the user's overrides"""
    training_task: TaskConfig
    """not under a protocol, with the user's overrides"""
    trained_task: TaskConfig
    """as it was in training"""
    value: Any
    """of the analysis' key on the command line"""
    episodes: int
    """of each set"""
    seed: int
    """episode ``i`` of a set is seeded with ``seed + i``"""
    max_distance: float | None
    """an episode also ends this far along the track, m"""


def one_set(request: Request) -> int:
    """An analysis of one set of episodes."""
    return 1


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """A kind of evaluation: how it is measured, and what is made of its report."""

    name: str
    """of its files, and of the key of the command line that asks for it"""
    measure: Callable[[Request, Progress], Report]
    """plays the episodes, and gives its entries of the report"""
    sets: Callable[[Request], int] = one_set
    """how many sets of episodes it plays"""
    episodes: int = 100
    """of a set, if the user does not say"""
    endless: bool = False
    """whether it can be played on tracks without end"""
    training_keys: tuple[str, ...] = ()
    """keys of the task that else only a training uses"""
    refused_keys: dict[str, str] = field(default_factory=dict)
    """keys of the task that it decides on itself, with a sentence's end on why"""
    rows: Callable[[Report], list[dict[str, Any]]] | None = None
    """the report as a table for a file"""
    plot: Callable[[Report, Path], None] | None = None
    """draws the report to a path"""
    show: Callable[[Report, Console], None] | None = None
    """prints the report"""
