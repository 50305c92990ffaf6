"""Named things a task file can ask for, and error messages that say what is allowed.

A registered function's signature is the schema of its YAML parameters: parameters without a default are
required, the others are optional, and anything else is an error with the closest match.
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterable
from typing import Any, Generic, TypeVar

T = TypeVar("T", bound=Callable[..., Any])


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

    def register(self, name: str | None = None) -> Callable[[T], T]:
        """Decorator that registers a function under ``name``, by default its own.

        :raises ValueError: if the name is taken
        """

        def decorate(function: T) -> T:
            key = name or function.__name__
            if key in self._functions:
                raise ValueError(f"{self.kind} '{key}' is registered already.")
            self._functions[key] = function
            return function

        return decorate

    def get(self, name: str) -> T:
        """:raises KeyError: if nothing is registered under ``name``."""
        if name not in self._functions:
            raise KeyError(f"unknown {self.kind} {name!r}{did_you_mean(name, self._functions)}")
        return self._functions[name]

    def names(self) -> list[str]:
        """All registered names, sorted."""
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
