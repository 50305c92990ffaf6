"""Load and check task and robot files: :func:`load_task`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from ogmp_sb3.config import registry
from ogmp_sb3.config.catalogue import find, is_file, shown_path
from ogmp_sb3.config.messages import Where, did_you_mean, located
from ogmp_sb3.config.ranges import ModeRanges
from ogmp_sb3.config.registry import Registry
from ogmp_sb3.config.robot import STATE_NAMES, RobotConfig
from ogmp_sb3.config.strict import NOT_GIVEN, check_keys, read
from ogmp_sb3.config.task import RandomisationTerms, TaskConfig, Terms
from ogmp_sb3.config.task_files import EXTENDS, KEYS, extended_files, read_task
from ogmp_sb3.config.variation import CurriculumConfig
from ogmp_sb3.config.yaml_files import apply_overrides, read_yaml, resolved

KINDS_OF_RANGES = {"modes": registry.modes, "randomisation": registry.randomisations}


def load_task(name_or_path: str | Path, overrides: Mapping[str, Any] | Iterable[str] = ()) -> TaskConfig:
    """Read and check a task, whether from YAML, overrides or keyword arguments.

    :param name_or_path: a shipped task (``"parkour"``), one of a plug-in, or the path of a YAML file
    :param overrides: ``{"rho": 0.3, "modes.jump.h": [0.1, 0.2]}`` or ``["rho=0.3", "modes.jump.h=[0.1,0.2]"]``
    :raises ValueError: for a value that is out of range or a file that cannot be read
    :raises KeyError: for an unknown or missing name
    :raises TypeError: for a value of the wrong type
    """
    path = find("task", name_or_path)
    data = read_task(path)
    data = apply_overrides(data, overrides, shown_path(path))
    return task_from_data(resolved(data, Where(shown_path(path))), path)


def task_from_data(data: dict[str, Any], path: Path) -> TaskConfig:
    """Check plain task data, as read from ``path`` (which names it in messages). Raises as :func:`load_task`.

    :param data: without ``extends``, see :func:`~ogmp_sb3.config.task_files.read_task`
    :param path: of the task file
    """
    try:
        return _checked(data, path)
    except (KeyError, TypeError, ValueError) as error:
        files = extended_files(path)
        if not files:
            raise
        raise type(error)(_in_its_file(str(error.args[0]), path, files)) from None


def _in_its_file(sentence: str, path: Path, files: list[Path]) -> str:
    """A mistake's sentence with the file to look into: one that a task extends, if that alone has the same mistake.

    :param files: that the task extends, the nearest first
    """
    shown = shown_path(path)
    for file in reversed(files if not sentence.endswith(NOT_GIVEN) else []):
        own = sentence.replace(shown, shown_path(file), 1)
        if own == _mistake(file):
            return own
    return sentence.replace(shown, f"{shown} (extends {shown_path(files[0])})", 1)


def _mistake(path: Path) -> str | None:
    """The sentence that a task file gets by itself."""
    try:
        _checked(resolved(read_task(path), Where(shown_path(path))), path)
    except (KeyError, TypeError, ValueError) as error:
        return str(error.args[0])
    return None


def _checked(data: dict[str, Any], path: Path) -> TaskConfig:
    where = Where(shown_path(path))
    check_keys(data, KEYS, where)
    if EXTENDS in data:
        raise KeyError(f"{where / EXTENDS} is for task files: what a task extends cannot be overridden.")
    task = read(TaskConfig, data, where)
    with located(where / "robot"):
        robot = load_robot(task.robot, path.parent)
    _check_names(task.bound, STATE_NAMES, where / "bound")
    _check_names(task.feedback, STATE_NAMES, where / "feedback")
    if all(parameters is None for parameters in task.observations.values()):
        raise ValueError(f"{where / 'observations'} names no observation.")
    for name in task.evaluation.metrics:
        _read_terms({name: {}}, registry.metrics, where / "evaluation.metrics")
    _read_terms({task.objective: {}}, registry.objectives, where / "objective")
    _check_modes(task, where)
    for key, terms in (
        ("randomisation", task.randomisation),
        ("evaluation.randomisation", task.evaluation.randomisation),
    ):
        _check_randomisation(terms or {}, where / key)
    ending = _read_terms(task.evaluation.terminations, registry.terminations, where / "evaluation.terminations")
    return replace(
        _without_removed_modes(task),
        name=path.stem,
        file=where.file,
        robot_config=robot,
        oracle_params=_read_oracles(task, where),
        observations=_read_terms(task.observations, registry.observations, where / "observations"),
        critic_observations=_read_terms(task.critic_observations, registry.observations, where / "critic_observations"),
        rewards=_read_terms(task.rewards, registry.rewards, where / "rewards"),
        terminations=_read_terms(task.terminations, registry.terminations, where / "terminations"),
        evaluation=replace(task.evaluation, terminations=ending),
    )


def load_robot(name_or_path: str, relative_to: Path = Path()) -> RobotConfig:
    """Read and check a robot file. Raises as :func:`load_task`.

    :param name_or_path: a shipped robot (``"hector"``), one of a plug-in, or the path of a robot.yaml
    :param relative_to: directory that a relative path starts from
    """
    path = find("robot", name_or_path, relative_to)
    where = Where(shown_path(path))
    robot = replace(read(RobotConfig, resolved(read_yaml(path), where), where), path=path)
    try:
        file = robot.mjcf_path
    except ValueError as error:
        raise ValueError(f"{where / 'mjcf'}: {error}") from None
    if not is_file(file):
        raise ValueError(f"{where / 'mjcf'}: there is no file {file}.")
    return robot


def _check_modes(task: TaskConfig, where: Where) -> None:
    if not task.mode_ranges:
        raise ValueError(f"{where / 'modes'} names no mode.")
    for name in task.modes:
        with located(where / "modes"):
            registry.modes.get(name)
    check_ranges(task.mode_ranges, where / "modes", complete=True)
    _check_sampling(task, where / "sampling")
    if task.curriculum is not None:
        _check_curriculum(task, task.curriculum, where / "curriculum")


def _check_randomisation(terms: RandomisationTerms, where: Where) -> None:
    for name in terms:
        with located(where):
            registry.randomisations.get(name)
    in_use = {name: ranges for name, ranges in terms.items() if ranges is not None}
    check_ranges(in_use, where, complete=True, kinds=registry.randomisations)


def _check_sampling(task: TaskConfig, where: Where) -> None:
    _check_names(task.sampling.weights, task.modes, where / "weights")
    _check_names((entry.mode for entry in task.sampling.sequence), task.mode_ranges, where / "sequence")
    for i, entry in enumerate(task.sampling.sequence):
        check_ranges({entry.mode: entry.ranges}, where / "sequence" / i, complete=False)
    if task.sampling.order == "random":
        _check_a_mode_is_drawn(task, task.sampling.weights, where / "weights")


def _check_curriculum(task: TaskConfig, curriculum: CurriculumConfig, where: Where) -> None:
    for kind, easy, full, named in (
        ("modes", curriculum.modes, task.mode_ranges, task.modes),
        ("randomisation", curriculum.randomisation, task.randomised, task.randomisation),
    ):
        if named is None:  # all of it is off
            continue
        _check_names(easy, named, where / kind)
        check_ranges(easy, where / kind, complete=False, kinds=KINDS_OF_RANGES[kind])
        for name, ranges in easy.items():
            for key, range_ in ranges.items():
                if range_.words:
                    raise ValueError(f"{where / kind / name / key} is a word, which has no values between two levels.")
                if name in full and key not in full[name]:
                    raise KeyError(
                        f"{where / kind / name / key} needs '{kind}.{name}.{key}' too, its value at level 1."
                    )
    _check_names(curriculum.weights, task.modes, where / "weights")
    _check_a_mode_is_drawn(task, {**task.sampling.weights, **curriculum.weights}, where / "weights")


def _check_a_mode_is_drawn(task: TaskConfig, weights: dict[str, float], where: Where) -> None:
    if not any(weights.get(name, 1.0) for name in task.mode_ranges):
        raise ValueError(f"{where} gives every mode the weight 0.")


def _without_removed_modes(task: TaskConfig) -> TaskConfig:
    """The task with weights and curriculum of the modes in use only."""

    def used(by_mode: dict[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in by_mode.items() if name in task.mode_ranges}

    curriculum = task.curriculum
    if curriculum is not None:
        disturbed = {name: ranges for name, ranges in curriculum.randomisation.items() if name in task.randomised}
        curriculum = replace(
            curriculum, modes=used(curriculum.modes), weights=used(curriculum.weights), randomisation=disturbed
        )
    sampling = replace(task.sampling, weights=used(task.sampling.weights))
    return replace(task, sampling=sampling, curriculum=curriculum)


def check_ranges(named: ModeRanges, where: Where, complete: bool, kinds: Registry[Any] = registry.modes) -> None:
    """Check modes, or disturbances, and their parameters.

    :param complete: every parameter without a default must be there
    :param kinds: what they are
    :raises KeyError: for an unknown or missing name
    :raises ValueError: for a value that is out of range
    :raises TypeError: for a value of the wrong type
    """
    for name, ranges in named.items():
        parameters, limits = kinds.parameters(name), kinds.limits(name)
        if complete:
            with located(where / name):
                kinds.check(name, ranges)
        _check_names(ranges, parameters, where / name)
        for key, range_ in ranges.items():
            annotation = parameters[key].annotation
            words = get_args(annotation) if get_origin(annotation) is Literal else ()
            if bool(words) != bool(range_.words):
                value = ", ".join(range_.words) or " to ".join(f"{c:g}" for c in sorted({range_.low, range_.high}))
                expected = f"one or more of the words {', '.join(words)}" if words else "a number or [low, high]"
                raise TypeError(f"{where / name / key} must be {expected}, found {value}.")
            _check_names(range_.words, words, where / name / key)
            least, most = limits.get(key, (0.0 if kinds is registry.modes else -math.inf, math.inf))
            for end in (range_.low, range_.high):
                if not least <= end <= most:
                    limit = f"at least {least:g}" if most == math.inf else f"from {least:g} to {most:g}"
                    raise ValueError(f"{where / name / key} must be {limit}, found {end:g}.")


def _read_oracles(task: TaskConfig, where: Where) -> dict[str, dict[str, Any]]:
    """The parameters of the oracles, with the types that the oracles ask for."""
    with located(where / "oracle"):
        registry.oracles.get(task.oracle)
    inside = where / "oracle_params"
    unnamed: dict[str, Any] = {} if task.oracle in task.oracle_params else {task.oracle: {}}
    read_params = _read_terms({**task.oracle_params, **unnamed}, registry.oracles, inside)
    return {name: parameters or {} for name, parameters in read_params.items()}


def _read_terms(terms: Mapping[str, Any], kinds: Registry[Any], where: Where) -> Terms:
    """The terms' parameters, with the types that their functions ask for."""
    result: Terms = {}
    for name, data in terms.items():
        with located(where):
            parameters = kinds.parameters(name)
        if data is None:
            result[name] = None
            continue
        with located(where / name):
            kinds.check(name, data)
        result[name] = {key: read(parameters[key].annotation, value, where / name / key) for key, value in data.items()}
    return result


def _check_names(names: Iterable[str], allowed: Iterable[str], where: Where) -> None:
    allowed = list(allowed)
    for name in names:
        if name not in allowed:
            raise KeyError(f"{where} has {name!r}{did_you_mean(name, allowed)}")
