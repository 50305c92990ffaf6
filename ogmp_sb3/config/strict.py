"""Strict reading of YAML data into frozen dataclasses: every mistake is one sentence with file and key.

A dataclass's annotations are its schema. Supported: ``bool``, ``int``, ``float``, ``str``, ``X | None``,
``X | tuple[Y, ...]``, ``X | D`` with a ``TypedDict`` D that is meant where one of its keys is there, ``tuple[X, ...]``,
``tuple[X, Y, Z]``, ``dict[str, X]``, ``Literal``, ``Annotated[X, check]`` with a function ``check(value, where)`` that
raises, nested dataclasses, and any class with a ``from_data(data, where)`` class method.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, TypeVar

from ogmp_sb3.config.messages import Where, describe, did_you_mean

T = TypeVar("T")

LARGEST = 2**63  # whole numbers lie between this and its negative
NOT_GIVEN = "is missing: the file must give it."
GREATEST = 1e12  # of numbers, either sign: nothing that is counted in m, s, kg, N or rad is greater


def read(kind: type[T], data: Any, where: Where) -> T:
    """Turn plain data into a value of a type, strictly.

    :param kind: the annotation to satisfy
    :param data: what the YAML holds
    :param where: for messages
    :raises KeyError: for an unknown or a missing key
    :raises TypeError: for a value of the wrong type
    :raises ValueError: for a value outside its range
    """
    return typing.cast(T, _read(kind, data, where))


def _read(kind: Any, data: Any, where: Where) -> Any:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return data
    if origin in (types.UnionType, typing.Union):
        if data is None and type(None) in arguments:
            return None
        inner = [a for a in arguments if a is not type(None)]
        fitting = [a for a in inner if type(data) is a or _is_meant(a, data)] or inner[:1]
        return _read(fitting[0], data, where)
    if origin is typing.Literal:
        if data not in arguments:
            raise ValueError(f"{where} is {describe(data)}{did_you_mean(data, map(str, arguments))}")
        return data
    if origin is typing.Annotated:
        return _checked(arguments, data, where)
    if origin is dict:
        return {str(k): _read(arguments[1], v, where / k) for k, v in _mapping(data, where).items()}
    if origin is tuple:
        return _read_tuple(arguments, data, where)
    if typing.is_typeddict(kind):
        return _read_keys(typing.get_type_hints(kind, include_extras=True), kind.__required_keys__, data, where)
    if hasattr(kind, "from_data"):
        return kind.from_data(data, where)
    if dataclasses.is_dataclass(kind):
        return _read_dataclass(kind, data, where)
    return _read_scalar(kind, data, where)


def _is_meant(kind: Any, data: Any) -> bool:
    """Whether data is a list for a tuple, or for a TypedDict rather than a mapping of scalars: it has one of its keys,
    or holds mappings.
    """
    if typing.get_origin(kind) is tuple:
        return isinstance(data, list | tuple)
    if not typing.is_typeddict(kind) or not isinstance(data, dict):
        return False
    return any(key in data for key in kind.__annotations__) or any(isinstance(v, dict) for v in data.values())


def _checked(arguments: tuple[Any, ...], data: Any, where: Where) -> Any:
    kind, *checks = arguments
    value = _read(kind, data, where)
    for check in checks:
        check(value, where)
    return value


def _read_tuple(arguments: tuple[Any, ...], data: Any, where: Where) -> tuple[Any, ...]:
    if not isinstance(data, list | tuple):
        raise TypeError(f"{where} must be a list, found {describe(data)}.")
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        arguments = (arguments[0],) * len(data)
    if len(arguments) != len(data):
        raise ValueError(f"{where} must have {len(arguments)} entries, found {len(data)}.")
    return tuple(_read(a, d, where / i) for i, (a, d) in enumerate(zip(arguments, data, strict=True)))


def _read_dataclass(kind: Any, data: Any, where: Where) -> Any:
    hints = typing.get_type_hints(kind, include_extras=True)
    fields = [f for f in dataclasses.fields(kind) if f.init and not f.metadata.get("internal")]
    required = {f.name for f in fields if f.default is f.default_factory is dataclasses.MISSING}
    values = _read_keys({f.name: hints[f.name] for f in fields}, required, data, where)
    try:
        return kind(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def null_leaves_out(kind: Any, keys: Sequence[str]) -> bool:
    """Whether null at a key of nested mappings can only mean to leave the key out.

    :param kind: the annotation of the outermost mapping
    :param keys: from there
    :return: False where null is a value, where a key is required, and where no annotation says what there may be
    """
    if typing.get_origin(kind) in (types.UnionType, typing.Union):
        kind = next(a for a in typing.get_args(kind) if a is not types.NoneType)
    name, *rest = keys
    if dataclasses.is_dataclass(kind) and not hasattr(kind, "from_data"):
        field = {f.name: f for f in dataclasses.fields(kind)}.get(name)
        if field is None:
            return False
        hint = typing.get_type_hints(kind, include_extras=True)[name]
        required = field.default is field.default_factory is dataclasses.MISSING
    elif typing.get_origin(kind) is dict:
        hint, required = typing.get_args(kind)[1], False
    else:
        return False
    return (
        null_leaves_out(hint, rest)
        if rest
        else not (required or hint is Any or types.NoneType in typing.get_args(hint))
    )


def _read_keys(hints: dict[str, Any], required: Collection[str], data: Any, where: Where) -> dict[str, Any]:
    """The values of a mapping whose keys are known."""
    data = _mapping(data, where)
    check_keys(data, hints, where)
    for name in hints:
        if name in required and name not in data:
            raise KeyError(f"{where / name} {NOT_GIVEN}")
    return {name: _read(hints[name], data[name], where / name) for name in hints if name in data}


def check_keys(data: Iterable[Any], allowed: Collection[str], where: Where) -> None:
    """Check the keys of a mapping.

    :raises KeyError: for an unknown one
    """
    for key in data:
        if key not in allowed:
            raise KeyError(f"{where / key} is not a known key{did_you_mean(key, allowed)}")


def _read_scalar(kind: Any, data: Any, where: Where) -> Any:
    words = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
    if kind in (int, float) and type(data) is int and abs(data) >= LARGEST:
        raise ValueError(f"{where} is too large: whole numbers have at most 64 bits.")
    if kind is float and type(data) is int:
        data = float(data)
    if not isinstance(data, kind) or (kind is int and isinstance(data, bool)):
        raise TypeError(f"{where} must be {words[kind]}, found {describe(data)}.")
    if kind is float and not math.isfinite(data):
        raise ValueError(f"{where} must be finite, found {data}.")
    if kind is float and abs(data) > GREATEST:
        raise ValueError(f"{where} is too large: numbers lie between -{GREATEST:g} and {GREATEST:g}, found {data:g}.")
    return data


def _mapping(data: Any, where: Where) -> dict[Any, Any]:
    if not isinstance(data, dict):
        raise TypeError(f"{where} must be a mapping, found {describe(data)}.")
    return data


def positive(name: str, value: float) -> None:
    """Check a number of a dataclass.

    :raises ValueError: if it is not above 0
    """
    if not value > 0:
        raise ValueError(f"'{name}' must be above 0, found {value:g}.")


def not_negative(name: str, weights: Mapping[str, float]) -> None:
    """Check weights of a dataclass.

    :raises ValueError: if one is below 0
    """
    for key, weight in weights.items():
        if weight < 0:
            raise ValueError(f"'{name}.{key}' must be at least 0, found {weight:g}.")


def all_different(name: str, entries: tuple[str, ...]) -> None:
    """Check names of a dataclass.

    :raises ValueError: if one is there twice
    """
    for entry in entries:
        if entries.count(entry) > 1:
            raise ValueError(f"'{name}' has {entry!r} twice.")


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Check a number of a dataclass.

    :raises ValueError: if it is not within ``low`` and ``high``
    """
    if value < low:
        raise ValueError(f"'{name}' must be at least {low:g}, found {value:g}.")
    if value > high:
        raise ValueError(f"'{name}' must be at most {high:,.0f}, found {value:g}.")
