"""Task variants: which mode comes next, and with which parameters (paper: Psi_T = Psi_M^N)."""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ogmp_sb3.config.answers import answer_text, call
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.registry import modes
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.variation import CurriculumConfig
from ogmp_sb3.guidance.modes import Segment, Span, pace
from ogmp_sb3.guidance.set_points import span_row
from ogmp_sb3.guidance.terrain import Plateau


@dataclass(frozen=True)
class ModeCall:
    """A mode and its parameters."""

    name: str
    """registered name"""
    parameters: dict[str, float | str]
    """parameter values"""

    def segment(self) -> Segment:
        """What the mode asks for; worked out once.

        :raises FunctionFailed: if the mode's function raises an exception
        :raises TypeError: if it returns anything but a Segment
        """
        return self._segment

    @cached_property
    def _segment(self) -> Segment:
        """The answer of the mode's function, which is asked once: where a robot is depends on all modes behind it."""
        segment: Any = call(f"mode '{self.name}'", modes.get(self.name), **self.parameters)
        if not isinstance(segment, Segment):
            raise TypeError(f"what mode '{self.name}' returns must be a Segment; it is {answer_text(segment)}.")
        return segment


def flat_ground(speed: float, length: float) -> ModeCall:
    """What lies behind the end of a track, or behind a mode by itself. A mode, so that courses can record it by name.

    :param speed: m/s
    :param length: m
    """
    return ModeCall(pace.__name__, {"v": speed, "length": length})


PlainModes = list[list[Any]]
"""modes as plain data: name and parameters of each"""


def plain_modes(calls: list[ModeCall]) -> PlainModes:
    """Modes as plain data, for files."""
    return [[call.name, call.parameters] for call in calls]


def mode_calls(modes: PlainModes) -> list[ModeCall]:
    """Modes from plain data."""
    return [ModeCall(name, parameters) for name, parameters in modes]


class ModeSampler:
    """Draws the modes of task variants; what it needs of the task is worked out once.

    :param task: the task
    """

    def __init__(self, task: TaskConfig) -> None:
        self._order, self._names = task.sampling, list(task.mode_ranges)
        easy = task.curriculum or CurriculumConfig()
        self._parameters = {
            name: {key: (easy.modes.get(name, {}).get(key, full), full) for key, full in ranges.items()}
            for name, ranges in task.mode_ranges.items()
        }
        full = [task.sampling.weights.get(name, 1.0) for name in self._names]
        self._weights = [(easy.weights.get(*pair), pair[1]) for pair in zip(self._names, full, strict=True)]

    def draw(self, rng: np.random.Generator, index: int, level: float = 1.0) -> ModeCall:
        """The mode at a place in the sequence of a task variant.

        :param rng: the environment's generator
        :param index: how many modes came before
        :param level: curriculum level, 0 to 1
        """
        own: dict[str, tuple[Range, Range]] = {}  # of a place in a sequence
        if self._order.order == "random":
            weights = list(itertools.accumulate(start + level * (full - start) for start, full in self._weights))
            name = self._names[bisect_right(weights, rng.random() * weights[-1])]
        else:
            sequence = self._order.sequence
            entry = sequence[index % len(sequence) if self._order.repeat == "all" else min(index, len(sequence) - 1)]
            name, own = entry.mode, {key: (range_, range_) for key, range_ in entry.ranges.items()}
        parameters = {**self._parameters[name], **own}
        return ModeCall(name, {key: draw_between(*ranges, level, rng) for key, ranges in parameters.items()})


def corner_segments(task: TaskConfig) -> Iterator[Segment]:
    """The segments of every mode at the extremes of all parameters that the task can draw.

    :raises FunctionFailed, TypeError, ValueError: if a mode cannot be laid, named with its parameters
    """
    full = task.mode_ranges
    drawn: list[tuple[str, dict[str, Range]]] = list(full.items())
    drawn += [(entry.mode, {**full[entry.mode], **entry.ranges}) for entry in task.sampling.sequence]
    if task.curriculum is not None:
        drawn += [(name, {**full[name], **ranges}) for name, ranges in task.curriculum.modes.items()]
    for name, parameters in drawn:
        for values in itertools.product(*(r.corners() for r in parameters.values())):
            call = ModeCall(name, dict(zip(parameters, values, strict=True)))
            segment = call.segment()
            _check_segment(f"{task.file}: 'modes.{name}'", segment, call)
            yield segment


def _check_segment(what: str, segment: Segment, call: ModeCall) -> None:
    """:raises TypeError, ValueError: if the segment cannot be laid; the message begins with ``what``"""
    values = f" ({', '.join(f'{key} {value}' for key, value in call.parameters.items())})" if call.parameters else ""
    for kind, parts in ((Span, segment.spans), (Plateau, segment.plateaus)):
        wrong = [part for part in parts if not isinstance(part, kind)]
        if wrong:
            raise TypeError(f"{what} is made of a {kind.__name__} that is {answer_text(wrong[0])}{values}.")
    if not segment.spans:
        raise ValueError(f"{what} has no set-points, not one Span{values}.")
    numbers = [segment.length, segment.start_height]
    numbers += [number for span in segment.spans for number in span_row(span, 0.0)]
    numbers += [number for plateau in segment.plateaus for number in plateau.box(0.0, 0.0)]
    if not np.isfinite(numbers).all():
        raise ValueError(f"{what} asks for a number that is not finite{values}.")
    if not segment.timed and segment.length <= 0:
        raise ValueError(f"{what} takes no length of the track{values}.")
    if not segment.timed and min(span.velocity[0] for span in segment.spans) < 0:
        raise ValueError(f"{what} runs backwards along the track{values}.")


def draw_parameters(ranges: dict[str, Range], rng: np.random.Generator) -> dict[str, float | str]:
    """Uniform parameters of one mode."""
    return {key: draw_between(range_, range_, 1.0, rng) for key, range_ in ranges.items()}


def draw_between(start: Range, full: Range, level: float, rng: np.random.Generator) -> float | str:
    """A value of a parameter at a curriculum level.

    :param start: what is drawn at level 0
    :param full: at level 1
    """
    if full.words:
        return full.words[int(rng.integers(len(full.words)))]
    low, high = start.low + level * (full.low - start.low), start.high + level * (full.high - start.high)
    return low + (high - low) * rng.random() if high > low else low
