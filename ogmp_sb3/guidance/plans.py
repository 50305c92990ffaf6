"""What the oracle has answered: each environment's reference, how far into it it is, and its mode latent."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.answers import answer_text, call, check_array, check_finite
from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.course import Course
from ogmp_sb3.guidance.latent import LATENT_SIZE, task_encoder
from ogmp_sb3.guidance.modes import Segment
from ogmp_sb3.guidance.oracles import Oracle, Plant
from ogmp_sb3.guidance.rotations import rpy_to_quat, smallest_rpy
from ogmp_sb3.guidance.set_points import Reference, SetPoints, set_points, span_array, span_row
from ogmp_sb3.guidance.srb import POS, RPY, STATE_MIRROR, STATE_SIZE


class CheckedOracle:
    """An oracle whose first answer is checked: a wrong one would spoil a training unseen, or end it far from here.

    :param name: its name in the task file
    :param function: its function with the parameters bound
    """

    def __init__(self, name: str, function: Oracle) -> None:
        self._title, self._function = f"oracle '{name}'", function
        self._checked = False

    def __call__(self, points: SetPoints, x0: np.ndarray) -> Reference:
        """What the oracle answers.

        :raises FunctionFailed: if its function raises an exception
        :raises TypeError: if its first answer is of the wrong type
        :raises ValueError: if that has the wrong shape, or is not finite although the states are
        """
        answer = call(self._title, self._function, points, x0)
        if not self._checked:
            self._check(answer, points, x0)
            self._checked = True
        return answer

    def _check(self, answer: Any, points: SetPoints, x0: np.ndarray) -> None:
        if not isinstance(answer, Reference):
            raise TypeError(
                f"what {self._title} returns must be a Reference, states and steps; it is {answer_text(answer)}."
            )
        shape, rows = points.state.shape, len(x0)
        what = f"the state of the Reference of {self._title}"
        expected = f"a state for each row and knot, an array of shape {shape}"
        check_array(what, answer.state, "f", shape, expected)
        check_finite(what, answer.state, np.isfinite(x0).all(axis=1))
        what = f"the steps of the Reference of {self._title}"
        check_array(what, answer.steps, "iu", (rows,), f"a whole number for each row, an array of shape ({rows},)")


def make_oracle(task: TaskConfig) -> Oracle:
    """The task's oracle with its parameters bound; its first answer is checked."""
    parameters = task.oracle_params.get(task.oracle, {})
    robot = task.robot_config
    plant = Plant(robot.srb, task.control_dt, feet=len(robot.feet))
    return CheckedOracle(task.oracle, partial(registry.oracles.get(task.oracle), plant=plant, **parameters))


def start_state(task: TaskConfig, segment: Segment) -> np.ndarray:
    """The state of a robot that stands at the start of a mode, shape (1, 12)."""
    state = np.zeros((1, STATE_SIZE))
    state[0, POS.start + 2] = task.robot_config.nominal_height + segment.start_height
    return state


def segment_set_points(task: TaskConfig, segments: Iterable[Segment], x0: np.ndarray, steps: int) -> SetPoints:
    """What a task's modes ask of the oracle from the start of the first of them on.

    :param segments: of the modes, one behind the other along the track; or one of a timed mode
    :param x0: state at the query, shape (1, 12)
    :param steps: how far to look, control steps
    """
    offset, timed, rows = 0.0, False, []
    for segment in segments:
        rows += [span_row(span, offset) for span in segment.spans]
        offset, timed = offset + segment.length, segment.timed
    return set_points(span_array(rows)[None], np.array([timed]), x0, np.array([steps]), task.control_dt, task.gait)


class Plans:
    """The present references of a batch of environments, each followed knot by knot until the next query.

    :param task: the task
    :param num_envs: number of environments
    :param most_steps: control steps of the longest reference
    :raises ValueError: if the task's encoder cannot be used
    """

    def __init__(self, task: TaskConfig, num_envs: int, most_steps: int) -> None:
        self._task = task
        self._oracle = make_oracle(task)
        self._encoder = task_encoder(task)
        self._feedback = np.array([name in task.feedback for name in STATE_NAMES])
        self.reference = np.zeros((num_envs, most_steps + 1, STATE_SIZE))
        self.quat = np.zeros((num_envs, most_steps + 1, 4))
        self._sides = [1.0, STATE_MIRROR] if task.latent_of_both_sides else [1.0]
        size = self._encoder.size if self._encoder else LATENT_SIZE
        self.latent = np.zeros((num_envs, len(self._sides) * size))
        self.period = np.ones(num_envs, dtype=int)  # control steps from a query to the next
        self.phase = np.zeros(num_envs, dtype=int)  # control steps since the last query

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything, one row for each environment; what is written into them is followed."""
        return {name: getattr(self, name) for name in ("reference", "quat", "latent", "period", "phase")}

    def advance(self) -> None:
        """Go on to the next knot, though never beyond the last."""
        self.phase[:] = np.minimum(self.phase + 1, self.period)

    def due(self, rows: np.ndarray) -> np.ndarray:
        """Those of the rows whose reference is at its end, shape (n,), int."""
        due: np.ndarray = rows[self.phase[rows] >= self.period[rows]]
        return due

    def query(self, rows: np.ndarray, states: np.ndarray, course: Course) -> None:
        """Ask the oracle.

        :param rows: environments, shape (n,), int
        :param states: their robots' states, shape (n, 12)
        :param course: what the modes ask of them
        """
        task = self._task
        if self._feedback[RPY].any():  # oracles subtract angles from those of set-points, which begin upright
            states = states.copy()
            states[:, RPY] = smallest_rpy(states[:, RPY])
        x0 = np.where(self._feedback, states, 0.0)
        steps = course.query_steps(rows)
        timed = np.full(len(rows), course.timed)
        points = set_points(course.spans[rows], timed, x0, steps, task.control_dt, task.gait)
        reference = self.ask(rows, points, x0)
        knots = reference.state.shape[1]
        self.reference[rows, :knots] = reference.state
        self.quat[rows, :knots] = rpy_to_quat(reference.state[..., RPY])
        if self._encoder is not None:
            sides = np.concatenate([side * reference.state for side in self._sides])
            latents = self._encoder(sides, np.tile(reference.steps, len(self._sides)))
            self.latent[rows] = np.concatenate(np.split(latents, len(self._sides)), axis=1)
        self.period[rows] = steps
        self.phase[rows] = 0

    def ask(self, rows: np.ndarray, points: SetPoints, x0: np.ndarray) -> Reference:
        """The oracle's answer for some environments.

        :param rows: environments, shape (n,), int
        :param points: what it is asked for
        :param x0: states fed back to it, shape (n, 12)
        """
        return self._oracle(points, x0)
