"""YAML files and overrides as plain data. Only data: no tags, no code."""

from __future__ import annotations

import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from ogmp_sb3.config.messages import Where, describe

Data = TypeVar("Data", dict[str, Any], list[Any])

WHOLE = ("bound",)
"""Keys of a task file at which a mapping, given by an override, replaces the one that was there: a state that it does
not name has weight 0, whatever the file says. All other mappings merge."""
SAFE_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the compiled one, if it was built
# PyYAML raises the last three on a tag that does not fit its value, such as `!!bool maybe`.
UNREADABLE = (YAMLError, OmegaConfBaseException, OSError, ValueError, LookupError, AttributeError, TypeError)


def read_yaml(path: Path) -> dict[str, Any]:
    """Read one YAML file as plain data. Only data: no tags, no code, and a key given twice is an error.

    :raises ValueError: if the file is missing, is not YAML, or is not a mapping
    """
    try:
        data = OmegaConf.to_container(OmegaConf.load(path))
    except FileNotFoundError:
        raise ValueError(f"{path}: no such file.") from None
    except RecursionError:
        raise ValueError(f"{path}: not readable as YAML (nested too deeply, or inside itself).") from None
    except UNREADABLE as error:
        raise ValueError(f"{path}: not readable as YAML ({' '.join(str(error).split())}).") from None
    if not isinstance(data, dict):
        raise ValueError(f"{path}: expected a mapping at the top, found {describe(data)}.")
    return typing.cast(dict[str, Any], data)


def read_yaml_quickly(path: Path, kind: type[Data]) -> Data:
    """Read a YAML file that a program of ours wrote, in a twentieth of the time and with fewer checks.

    :param kind: ``dict`` or ``list``, as what is expected at its top; of a file that is not there, an empty one
    :raises ValueError: if the file cannot be read, or holds another kind
    """
    try:
        data = yaml.load(path.read_bytes(), SAFE_LOADER)
    except FileNotFoundError:
        return kind()
    except (*UNREADABLE, RecursionError) as error:
        raise ValueError(f"{path}: not readable as YAML ({' '.join(str(error).split())}).") from None
    if not isinstance(data, kind):
        raise ValueError(f"{path}: expected a {'mapping' if kind is dict else 'list'}, found {describe(data)}.")
    return data


def read_value(text: str) -> Any:
    """Read one value as a YAML file would have it, ``1e-3`` being a number.

    :raises ValueError: if it is not YAML
    """
    try:
        # PyYAML alone follows YAML 1.1, where 1e-3 is text; OmegaConf's loader, which reads the files, does not.
        return OmegaConf.to_container(OmegaConf.from_dotlist([f"value={text}"]))["value"]  # type: ignore[index,call-overload]
    except RecursionError:
        raise ValueError("nested too deeply, or inside itself") from None
    except UNREADABLE as error:
        raise ValueError(" ".join(str(error).split())) from None


def resolved(data: dict[str, Any], where: Where, names: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Plain data with values in place of ``${...}``; a text that comes of one is read as a YAML file would have it.

    :param data: as it was read, a text such as ``${horizon}`` or ``${oc.env:SEED}`` still being text
    :param where: for messages
    :param names: what a name may mean beside the keys of the data itself
    :raises ValueError: naming the key, if there is no such value
    """
    if not _has_reference(data):
        return data
    try:
        root = OmegaConf.create({**(names or {}), **data})
    except UNREADABLE as error:
        raise ValueError(f"{where}: a value with ${{...}} cannot be read ({_first_line(error)}).") from None
    return {key: _resolved(value, root, key, where / key) for key, value in data.items()}


def _has_reference(node: Any) -> bool:
    if isinstance(node, dict | list):
        return any(_has_reference(value) for value in (node.values() if isinstance(node, dict) else node))
    return isinstance(node, str) and "${" in node


def _resolved(node: Any, parent: Any, key: Any, where: Where) -> Any:
    """A value of plain data.

    :param parent: the node of OmegaConf's that holds it
    :param key: under which it does
    """
    if not _has_reference(node):
        return node
    try:
        inner = parent[key]
        if OmegaConf.is_config(inner):
            node = OmegaConf.to_container(inner)  # also where a text refers to it
        elif isinstance(node, str):
            return read_value(inner) if isinstance(inner, str) else inner
    except UNREADABLE as error:
        raise ValueError(f"{where}: {node!r} has no value ({_first_line(error)}).") from None
    if isinstance(node, dict):
        return {name: _resolved(value, inner, name, where / name) for name, value in node.items()}
    return [_resolved(value, inner, i, where / i) for i, value in enumerate(node)]


def _first_line(error: Exception) -> str:
    """What OmegaConf says, without the place and without the kind of an error of the environment's."""
    line = str(error).strip().partition("\n")[0].rstrip(".")
    return line.rpartition("raised while resolving interpolation: ")[2].strip("\"'")


def apply_overrides(data: dict[str, Any], overrides: Mapping[str, Any] | Iterable[str], file: str) -> dict[str, Any]:
    """Put overrides into plain data, in place, and return it.

    A mapping goes into the one that is there, key by key; those of :data:`WHOLE` replace it.

    :param overrides: ``{"rho": 0.3, "modes.jump.h": [0.1, 0.2]}`` or ``["rho=0.3", "modes.jump.h=[0.1,0.2]"]``
    :param file: for messages
    :raises ValueError: if an override is not ``key=value``
    :raises TypeError: if it is below something that is no mapping
    """
    for key, value in _override_items(overrides, file):
        _set(data, key.split("."), value, Where(file))
    return data


def _override_items(overrides: Mapping[str, Any] | Iterable[str], file: str) -> Iterable[tuple[str, Any]]:
    if isinstance(overrides, Mapping):
        yield from ((str(key), value) for key, value in overrides.items())
        return
    if isinstance(overrides, str | bytes) or not isinstance(overrides, Iterable):
        raise TypeError(f"{file}: overrides must be a mapping or a list of key=value, found {describe(overrides)}.")
    for text in overrides:
        key, sign, value = str(text).partition("=")
        if not sign or not key or not value.strip():
            raise ValueError(f"{file}: override {str(text)!r} must have the form key=value (null for nothing).")
        try:
            yield key, read_value(value)
        except ValueError as error:
            raise ValueError(f"{file}: override {str(text)!r} has a value that is not YAML ({error}).") from None


def _set(node: dict[str, Any], keys: list[str], value: Any, where: Where) -> None:
    """Set a key in nested mappings. A mapping goes into what is there; reading finds the keys that are wrong."""
    first, *rest = keys
    if not rest and isinstance(value, Mapping) and where.key is None and first in WHOLE:
        node[first] = {}
    if not rest and not isinstance(value, Mapping):
        node[first] = value
        return
    if rest and not isinstance(node.get(first), dict | None):
        raise TypeError(f"{where / first} is {describe(node[first])}: it has no {'.'.join(rest)!r} to set.")
    if not isinstance(node.get(first), dict):
        node[first] = {}
    for key, inner in [(".".join(rest), value)] if rest else value.items():
        _set(node[first], str(key).split("."), inner, where / first)
