"""JSON Schema of the task file, for editors: completion, descriptions, and mistakes marked while one types.

It is made from the dataclasses of :mod:`ogmp_sb3.config.task` and the signatures in :mod:`ogmp_sb3.config.registry`,
those of plug-ins included. It never rejects a task that :func:`ogmp_sb3.load_task` accepts, which knows more: what a
value may be, and what goes together.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import re
import textwrap
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any

from ogmp_sb3.config import catalogue, registry
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.registry import Registry
from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.config.task import EvaluationConfig, SamplingConfig, TaskConfig
from ogmp_sb3.config.task_files import EXTENDS
from ogmp_sb3.config.variation import CurriculumConfig
from ogmp_sb3.config.weights import Named

Schema = dict[str, Any]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
SCALARS = {bool: "boolean", int: "integer", float: "number", str: "string"}
TEXT: Schema = {"type": "string"}
EXTENDED = "the task that this one extends: a name, or the path of a YAML file relative to this one"
NULL: Schema = {"type": "null"}
NUMBER: Schema = {"type": "number"}
NUMBERS: list[Schema] = [NUMBER, {"type": "array", "prefixItems": [NUMBER, NUMBER], "minItems": 2, "maxItems": 2}]


def task_schema() -> Schema:
    """The schema of a task file, as plain data: one that extends another may leave out everything."""
    whole = _of_dataclass(TaskConfig, _named_fields())
    return {
        "$schema": DIALECT,
        "title": "A task of ogmp_sb3",
        "if": {"required": [EXTENDS]},
        "then": _with_extends(_only_what_differs(whole)),
        "else": _with_extends(whole),
    }


def _with_extends(task: Schema) -> Schema:
    names = {"anyOf": [{"enum": catalogue.names("task")}, TEXT], "description": EXTENDED}
    return {**task, "properties": {EXTENDS: names, **task["properties"]}}


def _only_what_differs(schema: Schema) -> Schema:
    """The schema of what merges with such data: nothing is required, and null takes out what need not be there."""
    needed = schema.get("required", ())
    changed = {key: value for key, value in schema.items() if key != "required"}
    if "anyOf" in schema:
        changed["anyOf"] = [_only_what_differs(each) for each in schema["anyOf"]]
    if "properties" in schema:
        inner = {name: _only_what_differs(each) for name, each in schema["properties"].items()}
        changed["properties"] = {name: each if name in needed else _or_null(each) for name, each in inner.items()}
    if isinstance(schema.get("additionalProperties"), dict):
        changed["additionalProperties"] = _or_null(_only_what_differs(schema["additionalProperties"]))
    return changed


def _named_fields() -> dict[tuple[type[Any], str], Schema]:
    """The fields whose annotations say less than the registries know."""
    modes = registry.modes.names()
    weights = _mapping(dict.fromkeys(modes, NUMBER))
    in_sequence = _mapping({name: _or_null(_call(registry.modes, name, partial=True)) for name in modes})
    entry = {"anyOf": [{"enum": modes}, {**in_sequence, "minProperties": 1, "maxProperties": 1}]}
    terminations = _terms(registry.terminations)
    return {
        (TaskConfig, "modes"): _terms(registry.modes),
        (TaskConfig, "oracle"): {"enum": registry.oracles.names()},
        (TaskConfig, "oracle_params"): _mapping({n: _call(registry.oracles, n) for n in registry.oracles.names()}),
        (TaskConfig, "feedback"): _list({"enum": list(STATE_NAMES)}),
        (TaskConfig, "bound"): _mapping(dict.fromkeys(STATE_NAMES, NUMBER)),
        (TaskConfig, "observations"): _terms(registry.observations),
        (TaskConfig, "critic_observations"): _terms(registry.observations),
        (TaskConfig, "rewards"): _terms(registry.rewards),
        (TaskConfig, "terminations"): terminations,
        (TaskConfig, "objective"): {"enum": registry.objectives.names()},
        (SamplingConfig, "weights"): weights,
        (SamplingConfig, "sequence"): _list(entry),
        (CurriculumConfig, "modes"): _mapping({name: _call(registry.modes, name, partial=True) for name in modes}),
        (CurriculumConfig, "weights"): weights,
        (CurriculumConfig, "randomisation"): _mapping(
            {name: _call(registry.randomisations, name, partial=True) for name in registry.randomisations.names()}
        ),
        (TaskConfig, "randomisation"): _or_null(_terms(registry.randomisations)),
        (EvaluationConfig, "randomisation"): _or_null(_terms(registry.randomisations)),
        (EvaluationConfig, "terminations"): terminations,
        (EvaluationConfig, "metrics"): _list({"enum": registry.metrics.names()}),
    }


def _of_dataclass(kind: type[Any], named: Mapping[tuple[type[Any], str], Schema]) -> Schema:
    hints, texts = typing.get_type_hints(kind), field_texts(kind)
    fields = [f for f in dataclasses.fields(kind) if not f.metadata.get("internal")]
    properties = {}
    for field in fields:
        schema = named.get((kind, field.name)) or _of(hints[field.name], named)
        properties[field.name] = _described(schema, texts.get(field.name), field.default)
    needed = [f.name for f in fields if f.default is f.default_factory is dataclasses.MISSING]
    return _described(_mapping(properties, needed), _summary(kind))


def _of(annotation: Any, named: Mapping[tuple[type[Any], str], Schema]) -> Schema:
    """What :func:`ogmp_sb3.config.strict.read` accepts for an annotation, and perhaps more."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (types.UnionType, typing.Union):
        return {"anyOf": [NULL if a is types.NoneType else _of(a, named) for a in arguments]}
    if origin is typing.Literal:
        return {"enum": list(arguments)}
    if origin is typing.Annotated:
        names = [name for check in arguments[1:] if isinstance(check, Named) for name in check.names]
        return _mapping(dict.fromkeys(names, NUMBER)) if names else _of(arguments[0], named)
    if origin is dict:
        return {"type": "object", "additionalProperties": _of(arguments[1], named)}
    if origin is tuple and arguments[-1] is Ellipsis:
        return _list(_of(arguments[0], named))
    if origin is tuple:
        items = [_of(a, named) for a in arguments]
        return {"type": "array", "prefixItems": items, "minItems": len(items), "maxItems": len(items)}
    if annotation is Range:
        return {"anyOf": [*NUMBERS, *_one_or_more({"type": "string"})]}
    if typing.is_typeddict(annotation):
        return _of_typed_dict(annotation, named)
    if hasattr(annotation, "from_data"):  # reads itself, whatever it reads
        return {}
    if dataclasses.is_dataclass(annotation):
        return _of_dataclass(annotation, named)  # type: ignore[arg-type]
    return {"type": SCALARS[annotation]} if annotation in SCALARS else {}


def _of_typed_dict(kind: Any, named: Mapping[tuple[type[Any], str], Schema]) -> Schema:
    hints, texts = typing.get_type_hints(kind, include_extras=True), field_texts(kind)
    properties = {name: _described(_of(hint, named), texts.get(name)) for name, hint in hints.items()}
    return _described(_mapping(properties, sorted(kind.__required_keys__)), _summary(kind))


def _terms(kind: Registry[Any]) -> Schema:
    """Functions by name, each with its parameters or null."""
    return _mapping({name: _or_null(_call(kind, name)) for name in kind.names()})


def _call(kind: Registry[Any], name: str, partial: bool = False) -> Schema:
    """The YAML parameters of a registered function; ``partial``: none of them is required."""
    texts = _parameter_texts(kind.get(name))
    properties, needed = {}, []
    for key, parameter in kind.parameters(name).items():
        ranged = kind in (registry.modes, registry.randomisations)
        schema = _range(parameter.annotation) if ranged else _of(parameter.annotation, {})
        if parameter.default is inspect.Parameter.empty and not partial:
            needed.append(key)
        properties[key] = _described(schema, texts.get(key), parameter.default)
    return _described(_mapping(properties, needed), _summary(kind.get(name)))


def _range(annotation: Any) -> Schema:
    """A mode parameter: fixed or drawn."""
    if typing.get_origin(annotation) is typing.Literal:
        return {"anyOf": _one_or_more({"enum": list(typing.get_args(annotation))})}
    return {"anyOf": NUMBERS}


def _one_or_more(item: Schema) -> list[Schema]:
    return [item, _list(item)]


def _mapping(properties: Mapping[str, Schema], needed: Iterable[str] = ()) -> Schema:
    schema: Schema = {"type": "object", "properties": dict(properties), "additionalProperties": False}
    return {**schema, "required": list(needed)} if needed else schema


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _or_null(schema: Schema) -> Schema:
    return _described({"anyOf": [schema, NULL]}, schema.get("description"))


def _described(schema: Schema, text: str | None, default: Any = dataclasses.MISSING) -> Schema:
    """A schema with a description, and the default if it is a plain value."""
    plain = default is None or type(default) in SCALARS
    return {**schema, **({"description": text} if text else {}), **({"default": default} if plain else {})}


def _summary(thing: Any) -> str:
    return (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ")


def field_texts(kind: type[Any]) -> dict[str, str]:
    """The strings under the fields of a dataclass."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(definition, ast.ClassDef)
    texts = {}
    for field, below in itertools.pairwise(definition.body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                texts[name] = text
    return texts


def _parameter_texts(function: Any) -> dict[str, str]:
    """What a docstring says of the parameters."""
    lines = re.findall(r"^:param (\w+): (.+?)(?=^:|^$|\Z)", inspect.getdoc(function) or "", re.DOTALL | re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in lines}
