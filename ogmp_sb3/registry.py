"""Named things a task file can ask for, and error messages that say what is allowed.

A registered function's signature is the schema of its YAML parameters: parameters without a default are
required, the others are optional, and anything else is an error with the closest match.

Plug-ins are loaded when a name is looked up that is not registered, or all names are asked for: where only what
ships is named, none is.
"""

from __future__ import annotations

import difflib
import inspect
import typing
from collections.abc import Callable, Iterable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, Generic, TypeVar

from ogmp_sb3 import plugins
from ogmp_sb3.plugins import NameTaken, Plugin

T = TypeVar("T", bound=Callable[..., Any])
F = TypeVar("F", bound=Callable[..., Any])  # what is registered keeps its own type


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """The end of an error sentence: what is allowed, and the closest match if there is one.

    :param name: what was found
    :param allowed: the names that would have been right
    :return: e.g. ``" (allowed: jump, leap, pace). Did you mean 'leap'?"``
    """
    names = sorted(str(a) for a in allowed)
    text = f" (allowed: {', '.join(names) if names else 'none'})."
    close = difflib.get_close_matches(str(name), names, n=1)
    return f"{text} Did you mean '{close[0]}'?" if close else text


class Registry(Generic[T]):
    """A name for each function of one kind.

    :param kind: what the functions are, in the singular, for messages (``"oracle"``)
    :param arguments: how many leading arguments the library passes itself; the rest are YAML parameters
    """

    def __init__(self, kind: str, arguments: int = 0) -> None:
        self.kind = kind
        self.arguments = arguments
        self._functions: dict[str, T] = {}

    def register(self, name: str | None = None) -> Callable[[F], F]:
        """Decorator that registers a function under ``name``, by default its own.

        :raises NameTaken: if the name is taken
        :raises TypeError: if a YAML parameter has no annotation, by which its value is read
        """

        def decorate(function: F) -> F:
            key = name or function.__name__
            if key in self._functions:
                first, second = self._functions[key].__module__, function.__module__
                raise NameTaken(f"{self.kind} '{key}' of {second} is registered already, by {first}.")
            for parameter in list(inspect.signature(function).parameters.values())[self.arguments :]:
                if parameter.annotation is inspect.Parameter.empty:
                    raise TypeError(f"{self.kind} '{key}': the parameter '{parameter.name}' needs an annotation.")
            self._functions[key] = typing.cast(T, function)
            return function

        return decorate

    def get(self, name: str) -> T:
        """The function of a name.

        :raises KeyError: if nothing is registered under it, by plug-ins neither
        """
        if name not in self._functions:
            load_plugins()
        if name not in self._functions:
            raise KeyError(f"unknown {self.kind} {name!r}{did_you_mean(name, self._functions)}{broken_plugins()}")
        return self._functions[name]

    def names(self) -> list[str]:
        """All names, those of plug-ins too, sorted."""
        load_plugins()
        return sorted(self._functions)

    def parameters(self, name: str) -> dict[str, inspect.Parameter]:
        """The YAML parameters of a function: its signature without what the library passes."""
        signature = inspect.signature(self.get(name), eval_str=True)
        return dict(list(signature.parameters.items())[self.arguments :])

    def check(self, name: str, given: Iterable[str]) -> None:
        """Check the names of the parameters that a YAML file gives.

        :param name: a registered name
        :param given: the parameter names found
        :raises KeyError: if a parameter is unknown, or a required one is missing
        """
        parameters = self.parameters(name)
        given = list(given)
        for key in given:
            if key not in parameters:
                raise KeyError(f"{self.kind} '{name}' has no parameter {key!r}{did_you_mean(key, parameters)}")
        for key, parameter in parameters.items():
            if parameter.default is inspect.Parameter.empty and key not in given:
                raise KeyError(f"{self.kind} '{name}' needs the parameter '{key}'.")


modes: Registry[Any] = Registry("mode")
oracles: Registry[Any] = Registry("oracle", arguments=3)
observations: Registry[Any] = Registry("observation", arguments=1)
rewards: Registry[Any] = Registry("reward", arguments=1)
terminations: Registry[Any] = Registry("termination", arguments=1)
metrics: Registry[Any] = Registry("metric", arguments=1)
objectives: Registry[Any] = Registry("objective", arguments=1)

KINDS = (modes, oracles, observations, rewards, terminations, metrics, objectives)

_plugins: list[Plugin] | None = None  # None: not looked for yet


def load_plugins() -> list[Plugin]:
    """Import every installed plug-in, once. Of a broken one nothing stays registered.

    :raises NameTaken: if one wants a name that is taken
    """
    global _plugins
    if _plugins is None:
        _plugins = []  # before the first is loaded, for it may look names up
        try:
            for entry in plugins.installed():
                _plugins.append(_load(entry, [plugins.SHIPPED, *(p.folder for p in _plugins if p.folder)]))
        except NameTaken:
            _plugins = None
            raise
    return _plugins


def _load(entry: EntryPoint, folders: list[Path]) -> Plugin:
    before = [dict(kind._functions) for kind in KINDS]
    try:
        return plugins.load(entry, folders)
    except Exception as error:
        for kind, functions in zip(KINDS, before, strict=True):
            kind._functions = functions
        plugin = plugins.describe(entry, error=error)
        if isinstance(error, NameTaken):
            raise NameTaken(f"{plugin}: {error}") from None
        return plugin


def loaded_plugins() -> list[Plugin]:
    """The plug-ins that are loaded now."""
    return [plugin for plugin in _plugins or [] if not plugin.error]


def broken_plugins() -> str:
    """Why a name may be unknown, as sentences; empty if no plug-in is broken."""
    broken = (plugin for plugin in load_plugins() if plugin.error)
    return "".join(f" And {plugin} is broken ({plugin.error})." for plugin in broken)
