"""The command line of ``ogmp-train`` as Hydra gets it, and Hydra's errors as one sentence each.

Keys are checked before Hydra composes anything. Those of the task file may be typed with ``task.`` or without: at the
top of the configuration there is a place for each of them (:mod:`composition`), so that Hydra keeps, and names
directories by, what was typed. What is below them is left to the strict reading of the task, which knows more: what
Hydra would refuse because the file does not have it is added by force.
"""

from __future__ import annotations

import difflib
import io
import os
import re
from collections.abc import Callable, Iterable
from contextlib import redirect_stderr
from dataclasses import fields
from typing import Any

from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, ValueType
from hydra.errors import HydraException, MissingConfigException
from omegaconf.errors import OmegaConfBaseException

from ogmp_sb3.commands.cli import task_keys
from ogmp_sb3.config.messages import describe, did_you_mean
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.runs.multirun import plain_key
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.sb3.hyperparameters import DEFAULTS, PPOConfig

PROGRAM = "ogmp-train"
TASK_KEYS = task_keys(TaskConfig)
ADDED = ("experiment", "search")  # groups that are given as +experiment=...
DIRECTORIES = ("hydra.run.dir", "hydra.sweep.dir", "hydra.sweep.subdir")  # keys with one value, commas and all
PATHS = ("robot", "encoder")  # keys of the task whose value may be a path
PAPER = DEFAULTS.parent / "experiment" / "paper"  # the paper's own settings of each task
FULL_ERROR = "HYDRA_FULL_ERROR"  # Hydra's variable: errors are raised, not printed
LINKS = ("See https://", "full_key:", "object_type=", "reference_type=", "Config search path:", "provider=")


def joined(arguments: list[str]) -> list[str]:
    """The same command line with ``--config-dir`` and its directory, which may have any name, as one word."""
    words = iter(arguments)
    return [f"--config-dir={next(words, '')}" if word in ("--config-dir", "-cd") else word for word in words]


def checked(arguments: list[str], tasks: Iterable[dict[str, Any]]) -> list[str]:
    """The same command line with Hydra's options in front and every key checked.

    :param arguments: the command line
    :param tasks: the data of the tasks that it names, as far as they are known
    :return: keys that not all of the tasks have are added by force
    :raises KeyError: for an unknown key
    :raises ValueError: for an option or an override that cannot be read
    """
    # Hydra wants its options before the overrides; people write them anywhere.
    arguments = sorted(map(_with_quotes, arguments), key=lambda a: a[0:1] == "~" or ("=" in a and a[0:1] != "-"))
    options = _options(arguments)
    multirun = options.multirun or "hydra.mode=MULTIRUN" in arguments
    overrides = {text: _parsed(text) for text in options.overrides}
    _check_spellings(override.key_or_group for override in overrides.values())
    tasks = list(tasks)
    rewritten = {
        text: _checked(text, override, tasks, multirun, bool(options.config_name or options.config_path))
        for text, override in overrides.items()
    }
    return [rewritten.get(argument, argument) for argument in arguments]


def _checked(text: str, override: Override, tasks: list[dict[str, Any]], multirun: bool, own_config: bool) -> str:
    """One override, checked, as Hydra gets it."""
    key = override.key_or_group
    if override.is_sweep_override() and not multirun:
        raise ValueError(f"{text!r} has several values: add -m to train each of them, or write [a,b] for a list.")
    if override.is_delete():
        if key == "task":
            raise ValueError(f"{text!r}: a training needs a task.")
        return f"~task.{text[1:]}" if _of_task(key) else text
    if own_config or "/" in key or "@" in key:
        return text  # Hydra's own, such as hydra/launcher=joblib, or judged when it is read
    if key.startswith("task.") or _of_task(key):
        held = [_holds(task, plain_key(key)) for task in tasks]
        return text if text.startswith("+") or _of_task(key) or (held and all(held)) else f"++{text}"
    if not (override.is_add() or override.is_force_add()):
        _check_key(key, text.partition("=")[2])
    return text


def _of_task(key: str) -> bool:
    """Whether a key is one of the task, or below one."""
    return key.partition(".")[0] in TASK_KEYS


def _check_spellings(keys: Iterable[str]) -> None:
    """:raises ValueError: if a key is given both with ``task.`` and without."""
    seen: dict[str, str] = {}
    for key in keys:
        if seen.setdefault(plain_key(key), key) != key:
            raise ValueError(f"'{plain_key(key)}' is given twice.")


def _with_quotes(argument: str) -> str:
    """An argument whose value is a path, as Hydra reads it: any character may be in the name of a directory."""
    key, _, value = argument.partition("=")
    if key not in DIRECTORIES and plain_key(key) not in PATHS:
        return argument
    override = read_by_hydra(argument)
    several = override is not None and override.value_type != ValueType.ELEMENT
    return f"{key}={quoted(value)}" if override is None or (several and key in DIRECTORIES) else argument


def quoted(text: str) -> str:
    """Text as a value that Hydra reads as this text, whatever characters it has."""
    escaped = re.sub(r"(\\*)('|$)", lambda found: 2 * found[1] + (found[2] and "\\'"), text)
    return f"'{escaped}'"


def read_by_hydra(text: str) -> Override | None:
    """An override as Hydra reads it; None if it does not."""
    try:
        return OverridesParser.create().parse_override(text)
    except HydraException:
        return None


def _options(arguments: list[str]) -> Any:
    """What Hydra's options are set to."""
    complaint = io.StringIO()
    try:
        with redirect_stderr(complaint):
            options, rest = get_args_parser().parse_known_args(arguments)
    except SystemExit as stop:
        if not stop.code:  # --version
            raise
        raise ValueError(f"{complaint.getvalue().rpartition('error: ')[2].strip()} (see ogmp-train --help).") from None
    unknown = [argument for argument in rest if argument.startswith("-")]
    if unknown:
        raise ValueError(f"unknown option {unknown[0]!r} (see ogmp-train --help).")
    options.overrides += rest
    return options


def _parsed(text: str) -> Override:
    """One override as Hydra reads it."""
    try:
        return OverridesParser.create().parse_override(text)
    except HydraException as error:
        raise ValueError(f"{text!r} must have the form key=value as Hydra reads it: {_one_line(str(error))}.") from None


def _holds(task: dict[str, Any], key: str) -> bool:
    """Whether a task has a key, which is given without ``task.``.

    :raises TypeError: if the key lies within what is no mapping
    """
    node: Any = task
    names = key.split(".")
    for i, name in enumerate(names):
        if not isinstance(node, dict | None):
            raise TypeError(f"'{'.'.join(names[:i])}' is {describe(node)}: it has no '{'.'.join(names[i:])}' to set.")
        if node is None or name not in node:
            return False
        node = node[name]
    return True


def _check_key(key: str, value: str) -> None:
    """:raises KeyError: if the key is neither one of a training nor of Hydra itself."""
    first, _, rest = key.partition(".")
    ppo = {f"ppo.{field.name}" for field in fields(PPOConfig)}
    plain = {"task", *(field.name for field in fields(TrainConfig))}
    if first == "hydra" or key in plain | ppo:
        return
    if key in ADDED:
        raise KeyError(f"{key!r} is a group that is added: write '+{key}={value}'.")
    if first == "ppo" and rest:
        raise KeyError(f"{key!r} is not a known key{did_you_mean(key, ppo)}")
    names = {name: name for name in (*plain, *TASK_KEYS)} | {name.removeprefix("ppo."): name for name in ppo}
    close = [first] if first in names else difflib.get_close_matches(first, names, n=1)
    known = f"(allowed: {', '.join(sorted(plain))}, ppo.<key>, hydra.<key>, and the keys of the task file)"
    best = f" Did you mean '{names[close[0]]}{'.' * bool(rest)}{rest}={value}'?" if close else ""
    raise KeyError(f"{key!r} is not a known key {known}.{best}")


def run_hydra(main: Callable[[], object]) -> None:
    """Run a program of Hydra's.

    :param main: what ``hydra.main`` made of it
    :raises ValueError: for every error that Hydra would print, unless the user set ``HYDRA_FULL_ERROR``
    """
    asked = os.environ.get(FULL_ERROR)
    os.environ[FULL_ERROR] = "1"
    try:
        main()
    except (HydraException, OmegaConfBaseException) as error:
        if asked:
            raise
        raise ValueError(sentence(error)) from None
    finally:
        os.environ.pop(FULL_ERROR)
        if asked is not None:
            os.environ[FULL_ERROR] = asked


def sentence(error: Exception) -> str:
    """One sentence for an error of Hydra or OmegaConf."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        path, names = str(error.missing_cfg_file), set(error.options or ())
        group, _, name = path.rpartition("/")
        if path.startswith("experiment/"):  # of which Hydra knows no options in folders
            group, _, name = path.partition("/")
            names.update(f"paper/{file.stem}" for file in PAPER.glob("*.yaml"))
        return f"unknown {group or 'configuration'} {name!r}{did_you_mean(name, names)}"
    missing = re.match(r"You must specify '(\w+)'.*?Available options:(.*)", str(error), re.DOTALL)
    if missing:
        group, options = missing.groups()
        return f"{group!r} is missing: give {group}=<name> or {group}=<file> (allowed: {', '.join(options.split())})."
    text = _one_line(str(error))
    if isinstance(error.__cause__, OmegaConfBaseException):
        text = f"{text}: {_one_line(str(error.__cause__))}"
    return text if text.endswith((".", "?")) else f"{text}."


def _one_line(text: str) -> str:
    """What a message of several lines says, without its links and types."""
    lines = (line.strip() for line in text.splitlines())
    return " ".join(line for line in lines if line and not line.startswith(LINKS))
