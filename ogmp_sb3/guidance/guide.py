"""The guide of a batch of robots: what the modes ask of each, and the reference of the oracle that it follows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.load import check_ranges
from ogmp_sb3.config.messages import Where, did_you_mean
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.course import Course
from ogmp_sb3.guidance.plans import Plans
from ogmp_sb3.guidance.sampling import ModeCall, draw_parameters, mode_calls, plain_modes


class Knots(NamedTuple):
    """Where some environments are on their references, by the names that views have for it."""

    reference: np.ndarray
    """the present knots, shape (n, 12)"""
    reference_quat: np.ndarray
    """their orientations, shape (n, 4)"""
    latent: np.ndarray
    """mode latents of the references, shape (n, latent size)"""
    phase: np.ndarray
    """control steps since the oracle was asked, shape (n,), int"""
    period: np.ndarray
    """control steps between queries, shape (n,), int"""
    commanded_speed: np.ndarray
    """what the modes ask for along x where the robots are, shape (n,), m/s"""


class Guide:
    """Course and plans together: lays modes ahead of each robot, and asks the oracle when a reference is at its end.

    :param task: the task
    :param num_envs: number of environments
    :param row_tasks: a task for each environment, by which its modes are drawn; empty: ``task`` for all
    :raises ValueError: if the modes do not go together, or the task's encoder cannot be used
    """

    def __init__(self, task: TaskConfig, num_envs: int, row_tasks: Sequence[TaskConfig] = ()) -> None:
        self._row_tasks = row_tasks or [task] * num_envs
        self.course = Course(task, num_envs, row_tasks)
        self.plans = Plans(task, num_envs, self.course.most_steps)

    @property
    def timed(self) -> bool:
        """Whether modes take a time, rather than a length of the track."""
        return self.course.timed

    @property
    def terrain(self) -> np.ndarray:
        """Terrain boxes, shape (num_envs, boxes, 5)."""
        return self.course.terrain

    @property
    def modes(self) -> list[list[ModeCall]]:
        """The modes of each environment's variant so far."""
        return self.course.modes

    def command(self, row: int, mode: str, parameters: Mapping[str, float | str], rng: np.random.Generator) -> None:
        """Have an environment go on with a mode behind the track that is laid already, before drawn ones.

        :param row: the environment
        :param mode: name of one of the task's modes
        :param parameters: its parameters; those left out are drawn from the task's ranges
        :param rng: the environment's generator
        :raises KeyError: for an unknown mode, parameter or word
        :raises TypeError: for a value of the wrong type
        :raises ValueError: for a value below 0, or a timed mode that lasts too long
        """
        ranges, where = self._row_tasks[row].mode_ranges, Where("command", mode)
        if mode not in ranges:
            raise KeyError(f"the task has no mode '{mode}'{did_you_mean(mode, ranges)}")
        registry.modes.check(mode, {**ranges[mode], **parameters})
        fixed = {key: Range.from_data(value, where / key) for key, value in parameters.items()}
        check_ranges({mode: fixed}, Where("command"), complete=False)
        drawn = draw_parameters(ranges[mode], rng)
        self.course.command(row, ModeCall(mode, {**drawn, **parameters}))

    def forget_commands(self, row: int) -> None:
        """Drop the commands of an environment that no mode has come from yet."""
        self.course.commands[row].clear()

    def mode_at(self, row: int, x: float) -> ModeCall:
        """The mode that a place on the track belongs to; in a timed task the present one.

        :param row: the environment
        :param x: m along the track
        """
        return self.course.mode_at(row, x)

    def begin(self, row: int, rng: np.random.Generator, level: float, x: float = 0.0) -> float:
        """Lay a new variant of the task; returns the height of the ground at its start, m.

        :param row: the environment
        :param rng: its generator
        :param level: its curriculum level
        :param x: where its robot is put down along the track, m
        """
        return self.course.begin(row, rng, level, x)

    def query(self, rows: np.ndarray, states: np.ndarray) -> None:
        """Ask the oracle for new references.

        :param rows: environments, shape (n,), int
        :param states: their robots' states, shape (n, 12)
        """
        self.plans.query(rows, states, self.course)

    def advance(self) -> None:
        """Go on to the next knot of each reference, though never beyond the last."""
        self.plans.advance()

    def to_end(self, rows: np.ndarray) -> None:
        """Go on to the last knot of the references of some environments, where the next query is due."""
        self.plans.phase[rows] = self.plans.period[rows]

    def follow(
        self,
        rows: np.ndarray,
        x: np.ndarray,
        states: Callable[[np.ndarray], np.ndarray],
        generators: Sequence[np.random.Generator],
        level: np.ndarray,
    ) -> np.ndarray:
        """Lay the track ahead of robots that have moved on, and ask the oracle where a reference is at its end.

        :param rows: environments whose episodes go on, shape (n,), int
        :param x: where all robots are along the track, shape (num_envs,), m
        :param states: gives the states of some of the robots, shape (n, 12)
        :param generators: one for each environment
        :param level: curriculum levels, shape (num_envs,)
        :return: environments whose terrain has changed, shape (m,), int
        """
        short = self.course.short_of_track(rows, x[rows])
        for row in short:
            self.course.extend(row, float(x[row]), generators[row], float(level[row]))
        due = self.plans.due(rows)
        if self.timed:
            for row in due:
                self.course.extend(row, 0.0, generators[row], float(level[row]))
        if len(due):
            self.query(due, states(due))
        return short

    def knots(self, rows: np.ndarray, x: np.ndarray) -> Knots:
        """Where some environments are on their references.

        :param rows: environments, shape (n,), int
        :param x: where their robots are along the track, shape (n,), m
        """
        plans, phase = self.plans, self.plans.phase[rows]
        return Knots(
            reference=plans.reference[rows, phase],
            reference_quat=plans.quat[rows, phase],
            latent=plans.latent[rows],
            phase=phase,
            period=plans.period[rows],
            commanded_speed=self.course.commanded_speed(rows, x, phase),
        )

    def plan(self, row: int) -> np.ndarray:
        """The present reference of an environment, from the query on, shape (knots + 1, 12)."""
        return self.plans.reference[row, : self.plans.period[row] + 1].copy()

    def arrays(self) -> dict[str, np.ndarray]:
        """The state but for the modes, one row for each environment; what is written into the arrays is in force."""
        parts = (("plans", self.plans.arrays()), ("course", self.course.arrays()))
        return {f"{part}.{name}": values for part, arrays in parts for name, values in arrays.items()}

    def plain(self) -> dict[str, Any]:
        """The modes laid so far, as plain data. Commands are not part of it."""
        return {"modes": [plain_modes(calls) for calls in self.modes]}

    def set_plain(self, plain: Mapping[str, Any]) -> None:
        """Put back what :meth:`plain` gave."""
        self.course.modes = [mode_calls(calls) for calls in plain["modes"]]
