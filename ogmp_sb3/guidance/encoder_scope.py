"""What an encoder was trained on, and whether the references of a task lie within it."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from typing import Any

from ogmp_sb3.config import registry
from ogmp_sb3.config.ranges import ModeRanges, Range
from ogmp_sb3.config.registry import Registry
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.latent import load_encoder

TRAINED_ON = "trained_on"  # key of encoder.json
REFERENCE_KEYS = (
    "robot", "control_dt", "modes", "sampling", "curriculum", "gait", "oracle", "oracle_params", "feedback", "horizon",
)  # fmt: skip
"""the keys of a task file that its references depend on"""
RANDOM = "random"

Scope = dict[str, Any]
"""plain data by key of the task file: ``[low, high]`` or the words of a mode's parameter, or what the task has there"""


def scope(task: TaskConfig) -> Scope:
    """What the references of a task depend on; of its modes, everything that can be drawn, at any level."""
    modes, robot = _drawn_modes(task), task.robot_config
    parameters = {f"modes.{mode}.{key}": _limits(range_) for mode in modes for key, range_ in modes[mode].items()}
    oracle = _defaults(registry.oracles, task.oracle) | task.oracle_params.get(task.oracle, {})
    return {
        "modes": sorted(modes),
        **parameters,
        "sampling": _order(task),
        "oracle": task.oracle,
        **dict(leaves({"oracle_params": {task.oracle: oracle}})),
        "feedback": sorted(task.feedback),
        "horizon": task.horizon,
        "control_dt": task.control_dt,
        "gait.height": task.gait.height,
        "gait.cycle": task.gait.cycle,
        "robot.nominal_height": robot.nominal_height,
        "robot.srb.mass": robot.srb.mass,
        "robot.srb.inertia": list(robot.srb.inertia),
        "robot.feet": len(robot.feet),
    }


def outside(task: TaskConfig) -> str | None:
    """Where the references of a task leave what its encoder was trained on.

    :return: a sentence without its stop; None if they do not, or if that is not known
    :raises KeyError: if there is no such encoder
    :raises ValueError: if its files are damaged
    """
    if not task.uses_latent or task.encoder is None:
        return None
    trained = load_encoder(task.encoder).info.get(TRAINED_ON)
    if trained is None:
        return None
    here, trained = scope(task), _with_newer_parameters(trained)
    differing = [key for key in {**here, **trained} if not _within(key, here, trained)]
    if not differing:
        return None
    key, *others = differing
    more = f" ({', '.join(others)} {'differs' if len(others) == 1 else 'differ'} too)" if others else ""
    values = f"{_text(trained.get(key))}, and is {_text(here.get(key))} in this task{more}"
    return f"{task.file}: the encoder '{task.encoder}' was trained on other references: '{key}' was {values}"


def _with_newer_parameters(trained: Scope) -> Scope:
    """A scope with the parameters that its modes have got since: they were what is now their default."""
    known = set(registry.modes.names())
    defaults = {
        f"modes.{mode}.{key}": _limits(_fixed(value))
        for mode in trained["modes"]
        if mode in known
        for key, value in _defaults(registry.modes, mode).items()
    }
    return {**defaults, **trained}


def leaves(data: Mapping[str, Any], within: str = "") -> Iterator[tuple[str, Any]]:
    """What nested mappings hold, by dotted key."""
    for name, value in data.items():
        if isinstance(value, Mapping) and value:
            yield from leaves(value, f"{within}{name}.")
        else:
            yield f"{within}{name}", value


def _drawn_modes(task: TaskConfig) -> ModeRanges:
    """The modes that can be drawn, and of each parameter the least range that holds all that can be."""
    easy = {} if task.curriculum is None else task.curriculum.modes
    modes: dict[str, dict[str, list[Range]]] = {}
    for name, own in _entries(task):
        drawn = modes.setdefault(name, {})
        defaults = {key: _fixed(value) for key, value in _defaults(registry.modes, name).items()}
        for key, range_ in (defaults | task.mode_ranges[name]).items():
            at_level_0 = easy.get(name, {}).get(key, range_)
            drawn.setdefault(key, []).extend([own[key]] if key in own else [range_, at_level_0])
    return {name: {key: _hull(ranges) for key, ranges in drawn.items()} for name, drawn in modes.items()}


def _entries(task: TaskConfig) -> Iterator[tuple[str, dict[str, Range]]]:
    """The modes that can be drawn, with parameters of their own place in a sequence."""
    if task.sampling.order != RANDOM:
        yield from ((entry.mode, entry.ranges) for entry in task.sampling.sequence)
        return
    easy = {} if task.curriculum is None else task.curriculum.weights
    for name in task.mode_ranges:
        weight = task.sampling.weights.get(name, 1.0)
        if weight or easy.get(name, weight):
            yield name, {}


def _order(task: TaskConfig) -> str:
    """How modes follow each other."""
    if task.sampling.order == RANDOM:
        return RANDOM
    return f"{', '.join(entry.mode for entry in task.sampling.sequence)}, then {task.sampling.repeat}"


def _defaults(kind: Registry[Any], name: str) -> dict[str, Any]:
    """The parameters of a registered function that have a default."""
    parameters = kind.parameters(name).items()
    return {key: each.default for key, each in parameters if each.default is not inspect.Parameter.empty}


def _fixed(value: float | str) -> Range:
    return Range(words=(value,)) if isinstance(value, str) else Range(value, value)


def _hull(ranges: list[Range]) -> Range:
    """The least range that holds all of some."""
    words = tuple(sorted({word for range_ in ranges for word in range_.words}))
    return Range(min(r.low for r in ranges), max(r.high for r in ranges), words)


def _limits(range_: Range) -> list[Any]:
    return list(range_.words) or [range_.low, range_.high]


def _within(key: str, here: Scope, trained: Scope) -> bool:
    """Whether what a task has under a key lies within what an encoder was trained on."""
    now, then = here.get(key), trained.get(key)
    if key.startswith("modes.") and (now is None or key.split(".")[1] not in trained["modes"]):
        return True  # it is not drawn, or the whole mode is new, which is said of 'modes'
    if key.startswith("oracle_params."):
        # What is said of 'oracle' is not said again; a weight that is not named is 0.
        return here["oracle"] != trained["oracle"] or (now or 0.0) == (then or 0.0)
    if key == "sampling":
        return then in (RANDOM, now)
    if key.startswith("modes") and isinstance(now, list) and isinstance(then, list):
        if all(isinstance(each, str) for each in now):
            return set(now) <= set(then)
        return bool(then[0] <= now[0] and now[1] <= then[1])
    return bool(now == then)


def _text(value: Any) -> str:
    """A value as a sentence has it."""
    if isinstance(value, list) and len(value) == 2 and not isinstance(value[0], str):
        low, high = value
        return f"{low:g}" if low == high else f"{low:g} to {high:g}"
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    return "null" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
