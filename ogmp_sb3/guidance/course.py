"""The courses of a batch of environments: terrain and set-point spans, laid ahead of each robot mode by mode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.task import MAX_BOXES, TaskConfig
from ogmp_sb3.guidance.modes import Segment
from ogmp_sb3.guidance.sampling import ModeCall, ModeSampler, corner_segments, flat_ground
from ogmp_sb3.guidance.set_points import END, SPAN_SIZE, VX, append_spans, span_row, span_speed
from ogmp_sb3.guidance.terrain import Plateau, empty_terrain, place

START_PLATEAU = 2.0  # m: flat ground behind the start of a track
KEEP_BEHIND = 0.8  # m: terrain behind the base that is kept
REACH = 1.2  # m: terrain ahead of the base that is always there
MAX_LOOKAHEAD = 100.0  # m: more is a slip of the pen
COMMANDED = 2  # a timed mode may be commanded to last this many times as long as any that is drawn
LEAST_SPANS, MAX_SPANS = 24, 1_000  # room for spans of each environment; a task that needs more is a slip of the pen


class Course:
    """What the modes drawn so far ask of the ground and of the robot, for every environment.

    :param task: the task
    :param num_envs: number of environments
    :param row_tasks: a task for each environment, by which its modes are drawn; empty: ``task`` for all
    :raises ValueError: if the modes do not go together
    """

    def __init__(self, task: TaskConfig, num_envs: int, row_tasks: Sequence[TaskConfig] = ()) -> None:
        self.task = task
        tasks = row_tasks or [task] * num_envs
        different = {id(each): each for each in tasks}
        samplers = {key: ModeSampler(each) for key, each in different.items()}
        rooms = {key: extent(each) for key, each in different.items()}
        self._samplers, extents = [samplers[id(each)] for each in tasks], [rooms[id(each)] for each in tasks]
        self.timed = extents[0].timed  # all are or none: only timed modes have no horizon, which rows share
        self._lookahead = np.array([each.lookahead for each in extents])
        self.most_steps = max(each.steps for each in extents)
        self.terrain = empty_terrain(num_envs, task.track.boxes)
        self.spans = np.zeros((num_envs, max(each.spans for each in extents), SPAN_SIZE))
        self._span_count = np.zeros(num_envs, dtype=int)
        self._laid = np.zeros(num_envs)  # m of track laid so far
        self._mode_count = np.zeros(num_envs, dtype=int)
        self.modes: list[list[ModeCall]] = [[] for _ in range(num_envs)]
        self.commands: list[list[ModeCall]] = [[] for _ in range(num_envs)]  # modes that come before drawn ones

    def command(self, row: int, call: ModeCall) -> None:
        """Have a mode come next, before drawn ones and behind those commanded already.

        A timed mode that brings its own ground waits for the next variant.

        :raises ValueError: if it lasts too long
        """
        segment = call.segment()
        if self.timed and _steps(self.task, segment) >= self.most_steps:
            values = ", ".join(f"{key} {value}" for key, value in call.parameters.items())
            raise ValueError(
                f"{call.name} ({values}) lasts {segment.spans[-1].end:.1f} s; there is room for "
                f"{(self.most_steps - 1) * self.task.control_dt:.1f} s."
            )
        self.commands[row].append(call)

    def begin(self, row: int, rng: np.random.Generator, level: float, x: float = 0.0) -> float:
        """Begin a new variant for a robot at x (m); returns the height of the ground at its start, m."""
        self.terrain[row] = empty_terrain(1, self.terrain.shape[1])[0]
        self._span_count[row] = self._mode_count[row] = 0
        self._laid[row] = 0.0
        self.modes[row] = []
        if not self.timed:
            self._place(row, [Plateau(-START_PLATEAU, 0.0, 0.0)], -np.inf)
        self.extend(row, x, rng, level)
        return self.modes[row][0].segment().start_height

    def short_of_track(self, rows: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Those of the rows whose track must go on.

        :param rows: environments, shape (n,), int
        :param x: where their robots are along the track, shape (n,), m
        """
        return rows[self._laid[rows] - x < self._lookahead[rows]] if not self.timed else rows[:0]

    def extend(self, row: int, x: float, rng: np.random.Generator, level: float) -> None:
        """Lay modes ahead of a place on the track; in a timed task, go on to the next mode.

        :param row: the environment
        :param x: where its robot is along the track, m
        :param rng: its generator
        :param level: its curriculum level
        """
        while self.timed or self._laid[row] - x < self._lookahead[row]:
            call = self._next_mode(row, rng, level)
            segment = call.segment()
            self.modes[row].append(call)
            self._mode_count[row] += 1
            if segment.plateaus:
                self._place(row, list(segment.plateaus), x - KEEP_BEHIND)
            self._add_spans(row, [span_row(s, self._laid[row]) for s in segment.spans], x - KEEP_BEHIND)
            self._laid[row] += segment.length
            if self.timed:
                return

    def query_steps(self, rows: np.ndarray) -> np.ndarray:
        """Control steps until the next oracle query, shape (n,), int: the horizon, or the length of a timed mode."""
        if not self.timed:
            assert self.task.horizon is not None
            return np.full(len(rows), self.task.horizon)
        ends = self.spans[rows, self._span_count[rows] - 1, END]
        steps: np.ndarray = np.maximum(np.round(ends / self.task.control_dt).astype(int), 1)
        return steps

    def commanded_speed(self, rows: np.ndarray, x: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """The speed along x that modes ask for: of the span at a place, or in a timed task at a time; m/s, shape (n,).

        :param rows: environments, shape (n,), int
        :param x: places along the track, shape (n,), m
        :param phase: control steps since the present mode began, shape (n,), int; of timed tasks
        """
        speed: np.ndarray = span_speed(self.spans, rows, phase * self.task.control_dt if self.timed else x)
        return speed

    def mode_at(self, row: int, x: float) -> ModeCall:
        """The mode that a place on the track belongs to; in a timed task the present one.

        :param row: the environment
        :param x: m along the track
        """
        start = self._laid[row]
        for call in reversed(self.modes[row]):
            start -= call.segment().length
            if self.timed or start <= x:
                return call
        return self.modes[row][0]

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything laid so far but :attr:`modes`, one row each; what is written into them is laid."""
        return {name: getattr(self, name) for name in ("terrain", "spans", "_span_count", "_laid", "_mode_count")}

    def _next_mode(self, row: int, rng: np.random.Generator, level: float) -> ModeCall:
        """The next mode: as commanded, else of the variant; behind the end of the track, flat ground."""
        commands = self.commands[row]
        if commands and not (self.timed and self._mode_count[row] and commands[0].segment().plateaus):
            return commands.pop(0)
        length = self.task.track.length
        if length is not None and not self.timed and self._laid[row] >= length:
            speed = float(self.spans[row, self._span_count[row] - 1, VX])
            return flat_ground(speed, 1.0)
        return self._samplers[row].draw(rng, int(self._mode_count[row]), level)

    def _place(self, row: int, plateaus: list[Plateau], keep_from: float) -> None:
        boxes = [plateau.box(self._laid[row], 0.5 * self.task.track.width) for plateau in plateaus]
        if not place(self.terrain, row, boxes, keep_from):
            raise ValueError(
                f"{self.task.file}: 'track.boxes' is {self.task.track.boxes}, too few for the terrain around a robot; "
                "raise it, or make the modes longer."
            )

    def _add_spans(self, row: int, new: list[tuple[float, ...]], keep_from: float) -> None:
        used = 0 if self.timed else int(self._span_count[row])
        count = append_spans(self.spans[row], used, np.array(new), keep_from)
        if count < 0:
            raise ValueError(
                f"{self.task.file}: 'modes' are too short: over {self.spans.shape[1]} set-point spans around a robot."
            )
        self._span_count[row] = count


def _steps(task: TaskConfig, segment: Segment) -> int:
    """Control steps of a timed mode."""
    return round(segment.spans[-1].end / task.control_dt)


def _check_later_modes(task: TaskConfig) -> None:
    """:raises ValueError: if a timed mode that is not the first of a variant brings its own ground."""
    first, *later = task.sampling.sequence
    if task.sampling.repeat == "all" or not later:
        later = [*later, first]
    for entry in later:
        ranges = {**task.mode_ranges[entry.mode], **entry.ranges}
        if ModeCall(entry.mode, {key: range_.corners()[0] for key, range_ in ranges.items()}).segment().plateaus:
            raise ValueError(
                f"{task.file}: 'sampling.sequence' has '{entry.mode}' behind another mode; a timed mode that brings "
                "its own ground can only be the first of an episode."
            )


class Extent(NamedTuple):
    """What the modes of a task need room for, if all are as short, or as long, as they can be."""

    timed: bool
    """whether modes take a time, rather than a length of the track"""
    lookahead: float
    """how far ahead the track is laid, m"""
    steps: int
    """control steps of a reference"""
    boxes: int
    """terrain boxes around a robot"""
    spans: int
    """set-point spans around a robot"""


def extent(task: TaskConfig) -> Extent:
    """What the modes of a task need room for.

    :raises ValueError: if they do not go together
    """
    corners = list(corner_segments(task))
    timed = corners[0].timed
    if any(segment.timed != timed for segment in corners):
        raise ValueError(f"{task.file}: 'modes' mixes modes along a track with timed modes.")
    if timed:
        lookahead, steps, around = 0.0, _most_steps(task, corners), 1.0
    elif task.horizon is None:
        raise ValueError(f"{task.file}: 'horizon' must be a number of control steps for modes along a track.")
    else:
        lookahead, steps = _lookahead(task, task.horizon, corners), task.horizon
        around = 3 + (KEEP_BEHIND + lookahead) / min(segment.length for segment in corners)
    boxes, spans = (around * max(len(getattr(s, kind)) for s in corners) for kind in ("plateaus", "spans"))
    return Extent(timed, lookahead, steps, int(min(boxes, MAX_BOXES)), int(np.clip(spans, LEAST_SPANS, MAX_SPANS)))


def _most_steps(task: TaskConfig, corners: list[Segment]) -> int:
    """Control steps of the longest reference of a task whose modes are timed."""
    if task.horizon is not None:
        raise ValueError(f"{task.file}: 'horizon' must be null for timed modes: a mode is one query.")
    if task.sampling.order != "sequence":
        raise ValueError(f"{task.file}: 'sampling.order' must be sequence for timed modes.")
    _check_later_modes(task)
    return COMMANDED * max(_steps(task, segment) for segment in corners) + 1


def _lookahead(task: TaskConfig, horizon: int, corners: list[Segment]) -> float:
    """How far ahead the track is laid, m: at least as far as references and observations go."""
    speeds = [span.velocity[0] for segment in corners for span in segment.spans]
    ahead = max(speeds) * horizon * task.control_dt + 0.3
    observed = _observed_ahead(task)
    lookahead = max(REACH, ahead, *observed.values())
    if lookahead > MAX_LOOKAHEAD:
        observations = "".join(f", or 'observations.{name}'," for name in observed)
        raise ValueError(
            f"{task.file}: speeds in 'modes' times 'horizon'{observations} reach {lookahead:g} m ahead; at most "
            f"{MAX_LOOKAHEAD:g} m of the track are laid."
        )
    return lookahead


def _observed_ahead(task: TaskConfig) -> dict[str, float]:
    """How far ahead of the base each observation looks that does so, m."""
    reach = {name: getattr(registry.observations.get(name), "reach", None) for name in task.observed}
    return {name: reach_of(**task.observed[name]) for name, reach_of in reach.items() if reach_of is not None}
