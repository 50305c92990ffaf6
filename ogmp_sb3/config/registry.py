"""Named things a task file can ask for, and error messages that say what is allowed.

A registered function's signature is the schema of its YAML parameters: parameters without a default are
required, the others are optional, and anything else is an error with the closest match.

Plug-ins are loaded when a name is looked up that is not registered, or all names are asked for: where only what
ships is named, none is. :mod:`ogmp_sb3.config.plugins` says how (:func:`set_loader`).
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, TypeVar

from ogmp_sb3.config.messages import did_you_mean

Loader = Callable[[], str]
T = TypeVar("T", bound=Callable[..., Any])
F = TypeVar("F", bound=Callable[..., Any])  # what is registered keeps its own type


class NameTaken(ValueError):
    """Two packages give one name to different things."""


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
        broken = "" if name in self._functions else _load_more()
        if name not in self._functions:
            raise KeyError(f"unknown {self.kind} {name!r}{did_you_mean(name, self._functions)}{broken}")
        return self._functions[name]

    def names(self) -> list[str]:
        """All names, those of plug-ins too, sorted."""
        _load_more()
        return sorted(self._functions)

    def parameters(self, name: str) -> dict[str, inspect.Parameter]:
        """The YAML parameters of a function: its signature without what the library passes."""
        signature = inspect.signature(self.get(name), eval_str=True)
        return dict(list(signature.parameters.items())[self.arguments :])

    def limits(self, name: str) -> Mapping[str, tuple[float, float]]:
        """What the numbers of a function may be, least and greatest, by parameter; of :func:`parameter_limits`."""
        limits: Mapping[str, tuple[float, float]] = getattr(self.get(name), "limits", {})
        return limits

    def units(self, name: str) -> Mapping[str, str]:
        """The units of a function's parameters, of those that have one; of :func:`parameter_units`."""
        units: Mapping[str, str] = getattr(self.get(name), "units", {})
        return units

    def not_sizes(self, name: str) -> tuple[str, ...]:
        """The parameters of a function that do not say how much; of :func:`not_a_size`."""
        names: tuple[str, ...] = getattr(self.get(name), "not_sizes", ())
        return names

    def check(self, name: str, keys: Iterable[str]) -> None:
        """Check the names of the parameters that a YAML file gives.

        :param name: a registered name
        :param keys: the names of its parameters in the file
        :raises KeyError: if a parameter is unknown, or a required one is missing
        """
        parameters = self.parameters(name)
        keys = list(keys)
        for key in keys:
            if key not in parameters:
                raise KeyError(f"{self.kind} '{name}' has no parameter {key!r}{did_you_mean(key, parameters)}")
        for key, parameter in parameters.items():
            if parameter.default is inspect.Parameter.empty and key not in keys:
                raise KeyError(f"{self.kind} '{name}' needs the parameter '{key}'.")


def parameter_limits(**limits: tuple[float, float]) -> Callable[[F], F]:
    """Decorator of a mode or a randomisation: what its parameters may be, least and greatest."""

    def decorate(function: F) -> F:
        function.limits = limits  # type: ignore[attr-defined]
        return function

    return decorate


def parameter_units(**units: str) -> Callable[[F], F]:
    """Decorator: the units of parameters that grow with the robot, by which ``ogmp-task`` scales them.

    Those of :data:`~ogmp_sb3.porting.scale.GROWTH`, and ``"m of the base"`` for its height. A delay has none here:
    electronics do not grow.
    """

    def decorate(function: F) -> F:
        function.units = units  # type: ignore[attr-defined]
        return function

    return decorate


def not_a_size(*names: str) -> Callable[[F], F]:
    """Decorator of a randomisation: parameters that say when or where, not how much, which sweeps leave alone."""

    def decorate(function: F) -> F:
        function.not_sizes = names  # type: ignore[attr-defined]
        return function

    return decorate


def looks_ahead(reach: Callable[..., float]) -> Callable[[F], F]:
    """Decorator of an observation that looks ahead along the track: the track is laid that far.

    :param reach: how far ahead of the base it looks, m, from the observation's YAML parameters
    """

    def decorate(function: F) -> F:
        function.reach = reach  # type: ignore[attr-defined]
        return function

    return decorate


modes: Registry[Any] = Registry("mode")
oracles: Registry[Any] = Registry("oracle", arguments=3)
observations: Registry[Any] = Registry("observation", arguments=1)
rewards: Registry[Any] = Registry("reward", arguments=1)
randomisations: Registry[Any] = Registry("randomisation", arguments=1)
terminations: Registry[Any] = Registry("termination", arguments=1)
metrics: Registry[Any] = Registry("metric", arguments=1)
objectives: Registry[Any] = Registry("objective", arguments=1)

KINDS = (modes, oracles, observations, rewards, terminations, randomisations, metrics, objectives)

_load_more: Loader = str  # nothing to load, nothing to say


def set_loader(load: Loader) -> None:
    """Say how names that are not registered may be found.

    :param load: registers all that is installed, and returns sentences on what is broken, or nothing
    """
    global _load_more
    _load_more = load
