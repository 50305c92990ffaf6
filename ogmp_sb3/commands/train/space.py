"""What a search is over: overrides with several values, in Hydra's grammar, as Optuna's distributions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hydra.core.override_parser.types import IntervalSweep, Override, RangeSweep, Sweep

from ogmp_sb3.commands.train.sweeper import BUDGET
from ogmp_sb3.config.messages import did_you_mean
from ogmp_sb3.runs.multirun import SEED, plain_key
from ogmp_sb3.runs.run_directory import RESUMABLE

LOG = "log"  # the one tag: a number is drawn evenly on a logarithmic scale
FIXED = ("task", BUDGET)  # keys that have one value
INSIDE = 0.382  # where in an interval it is tried out: no whole number, as a rule
MANY = 10_000  # combinations, up to which those that were not tried yet are listed
Values = dict[str, Any]


@dataclass(frozen=True)
class Space:
    """The keys of a search."""

    given: tuple[str, ...]
    """overrides of every job"""
    searched: Mapping[str, Any]
    """what each key is drawn from, an Optuna distribution, by the key as it was typed"""
    seeds: tuple[str, ...]
    """overrides that each trial has jobs for, one a seed; an empty text for none"""

    def texts(self, values: Values) -> list[str]:
        """Values as overrides."""
        return [f"{key}={_text(values[key])}" for key in self.searched]

    def name(self, values: Values) -> str:
        """Identifies values, as texts: what differs in the seventh digit is the same."""
        return ",".join(self.texts(values))

    def command_lines(self, values: Values) -> list[list[str]]:
        """The jobs of some values, without their samples."""
        return [[*self.given, *self.texts(values), *([seed] if seed else [])] for seed in self.seeds]

    def combinations(self) -> list[Values] | None:
        """All values there are, None if there are too many."""
        choices = [_choices(distribution) for distribution in self.searched.values()]
        if any(values is None for values in choices) or math.prod(map(len, choices)) > MANY:  # type: ignore[arg-type]
            return None
        return [dict(zip(self.searched, values, strict=True)) for values in itertools.product(*choices)]  # type: ignore[arg-type]

    def plain(self) -> dict[str, Any]:
        """The same as text, to compare with, without what may change when a job goes on."""
        return {
            "given": sorted(text for text in self.given if plain_key(text.partition("=")[0]) not in RESUMABLE),
            "searched": {key: str(self.searched[key]) for key in sorted(self.searched)},
            "seeds": list(self.seeds),
        }


def read_space(overrides: Sequence[Override]) -> Space:
    """What a command line leaves open.

    :raises ValueError: if nothing is, a key is given twice, or values cannot be drawn
    """
    given, searched, seeds = [], {}, [""]
    typed = [plain_key(override.key_or_group) for override in overrides]
    for override, key in zip(overrides, typed, strict=True):
        if typed.count(key) > 1:
            raise ValueError(f"'{key}' is given twice.")
        if not override.is_sweep_override():
            if key != BUDGET:
                given.append(str(override.input_line))
        elif key in FIXED:
            raise ValueError(f"'{override.input_line}': a search takes one value of '{key}'.")
        elif key == SEED and override.is_discrete_sweep():
            seeds = [f"{SEED}={value}" for value in override.sweep_string_iterator()]
        else:
            searched[override.get_key_element()] = _distribution(override)
    if not searched:
        raise ValueError(
            "a search needs a key whose values it chooses: give an interval, rho=interval(0.2,0.8), or several values, "
            "oracle=lqr,preview."
        )
    return Space(tuple(given), searched, tuple(seeds))


def check_space(space: Space, mistake: Callable[[list[str]], Exception | None]) -> None:
    """Try jobs before any is trained: inside of all intervals, and at either end of each.

    :param mistake: of the command line of a job, None if it is right
    :raises Exception: the mistake, if there is one for every choice of words, or at the end of an interval
    """
    tried = [(values, mistake(space.command_lines(values)[0])) for values in _inside(space)]
    right = [values for values, found in tried if found is None]
    if not right:
        raise next(found for _, found in tried if found is not None)
    for key, distribution in space.searched.items():
        for end in (getattr(distribution, "low", None), getattr(distribution, "high", None)):
            found = None if end is None else mistake(space.command_lines({**right[0], key: end})[0])
            if found is not None:
                raise found


def _inside(space: Space) -> Iterator[Values]:
    """Values inside of all intervals: with the first choice of everything else, then each other choice alone."""
    first = {key: _inner(distribution) for key, distribution in space.searched.items()}
    yield first
    for key, distribution in space.searched.items():
        for choice in getattr(distribution, "choices", ())[1:]:
            yield {**first, key: choice}


def _inner(distribution: Any) -> Any:
    if hasattr(distribution, "choices"):
        return distribution.choices[0]
    whole = isinstance(distribution.low, int)
    inner = distribution.low + INSIDE * (distribution.high - distribution.low)
    return round(inner) if whole else inner


def _distribution(override: Override) -> Any:
    """What the values of one override are drawn from."""
    from optuna.distributions import CategoricalDistribution

    value = override.value()
    tags = value.tags if isinstance(value, Sweep) else set()
    for tag in tags - {LOG}:
        raise ValueError(f"'{override.input_line}': unknown tag '{tag}'{did_you_mean(tag, [LOG])}")
    if isinstance(value, IntervalSweep):
        return _number(override, value.start, value.end, LOG in tags, None)
    if isinstance(value, RangeSweep) and len(numbers := sorted(map(_rounded, value.range()))) > 1:
        return _number(override, numbers[0], numbers[-1], LOG in tags, abs(value.step))
    if LOG in tags:
        raise ValueError(f"'{override.input_line}': the tag '{LOG}' is for numbers, interval(...) or range(...).")
    texts = list(dict.fromkeys(override.sweep_string_iterator()))
    if not texts:
        raise ValueError(f"'{override.input_line}' names no value to choose from.")
    return CategoricalDistribution(texts)


def _number(override: Override, low: Any, high: Any, log: bool, step: Any) -> Any:
    """What the numbers of one override are drawn from."""
    from optuna.distributions import FloatDistribution, IntDistribution

    if low >= high:
        raise ValueError(f"'{override.input_line}': the interval ends at {high:g}, which is not above {low:g}.")
    if log and low <= 0:
        raise ValueError(f"'{override.input_line}': on a logarithmic scale numbers must be above 0, found {low:g}.")
    whole = isinstance(low, int) and isinstance(high, int)
    if log and step not in (None, 1):
        raise ValueError(f"'{override.input_line}': a range with the tag '{LOG}' has steps of 1, found {step:g}.")
    if log and step is not None and not whole:
        raise ValueError(
            f"'{override.input_line}': a range with the tag '{LOG}' is of whole numbers; or interval(...)."
        )
    return IntDistribution(low, high, log, step or 1) if whole else FloatDistribution(low, high, log, step)


def _choices(distribution: Any) -> Sequence[Any] | None:
    """All values of a distribution, None if they cannot be counted."""
    if hasattr(distribution, "choices"):
        return list(distribution.choices)
    if isinstance(distribution.low, int):
        return range(distribution.low, distribution.high + 1, distribution.step)
    if distribution.step is None:
        return None
    steps = round((distribution.high - distribution.low) / distribution.step)
    return [_rounded(distribution.low + i * distribution.step) for i in range(steps + 1)]


def _rounded(number: Any) -> Any:
    """A number without the last digits, which a sum of steps gets wrong."""
    return float(f"{number:.12g}") if isinstance(number, float) else number


def _text(value: Any) -> str:
    """A value as Hydra reads it; numbers to six digits, which name a directory."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
