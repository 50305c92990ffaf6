"""The JSON Schema of task files, against what load_task makes of them."""

from __future__ import annotations

import copy
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from helpers.mutations import SHIPPED, misspelt, mutated, nodes, parent
from ogmp_sb3.commands import check
from ogmp_sb3.config import registry
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.editor_schema import task_schema
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import SequenceEntry
from ogmp_sb3.config.task_files import merged
from ogmp_sb3.config.yaml_files import read_yaml

SCHEMA = task_schema()
WHOLE = SCHEMA["else"]  # of a file that extends no other
VALIDATOR = Draft202012Validator(SCHEMA)


def loads(data: dict[str, Any], name: str = "mine") -> bool:
    try:
        task_from_data(copy.deepcopy(data), TASKS_DIR / f"{name}.yaml")
    except (ValueError, KeyError, TypeError):
        return False
    return True


def put(name: str, key: str, value: Any) -> dict[str, Any]:
    data = copy.deepcopy(SHIPPED[name])
    parent(data, tuple(key.split(".")))[key.split(".")[-1]] = value
    return data


def test_it_is_a_schema_of_draft_2020_12() -> None:
    Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["$schema"] == Draft202012Validator.META_SCHEMA["$id"]


@pytest.mark.parametrize("path", sorted(TASKS_DIR.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_task_is_valid(path: Path) -> None:
    VALIDATOR.validate(read_yaml(path))


def test_every_key_of_a_task_file_is_described_by_the_string_under_its_field() -> None:
    assert WHOLE["properties"]["horizon"] == {
        "anyOf": [{"type": "integer"}, {"type": "null"}],
        "description": "control steps between oracle queries; null: one query per (timed) mode",
    }
    groups = [WHOLE, *(WHOLE["properties"][key] for key in ("sampling", "track", "gait", "action", "evaluation"))]
    for group in groups:
        for key, schema in group["properties"].items():
            assert schema["description"], key


def test_functions_and_their_parameters_are_described_by_their_docstrings() -> None:
    jump = WHOLE["properties"]["modes"]["properties"]["jump"]["anyOf"][0]
    assert jump["description"] == "Jump onto a block and down again."
    assert jump["properties"]["w"]["description"] == "length of the block along the track, m"
    assert (jump["required"], jump["properties"]["run_up"]["default"]) == (["w", "h"], 0.45)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("modes.jump", {"w": 0.3, "hight": 0.2}),
        ("modes.jump", {"w": 0.3}),
        ("modes.jump.h", [0.1, 0.2, 0.3]),
        ("modes.jump.h", "front"),
        ("oracle", "prevew"),
        ("oracle_params.preview.Q.vertical", 1.0),
        ("feedback", ["x", "w"]),
        ("bound", {"w": 1.0}),
        ("horizon", 30.5),
        ("rho", "wide"),
        ("sampling.order", "shuffled"),
        ("sampling.sequence", ["jmp"]),
        ("sampling.sequence", [{"jump": {}, "leap": {}}]),
        ("curriculum", 3),
        ("track.boxes", None),
        ("rewards.body_contact", {"weight": "much"}),
        ("observations.clok", {}),
        ("evaluation.metrics", ["retrun"]),
        ("objective", "run"),
    ],
)
def test_what_load_task_rejects_the_schema_rejects_where_it_can(key: str, value: Any) -> None:
    data = put("parkour", key, value)
    assert not loads(data)
    assert not VALIDATOR.is_valid(data)


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("dive", "modes.flip.r", "front"),
        ("dive", "modes.flip.r", ["front", "left"]),
        ("parkour", "modes.jump", None),
        ("parkour", "modes.jump.h", 0),
        ("parkour", "sampling", {"order": "sequence", "sequence": ["jump", {"jump": {"h": 0.1}}, {"pace": None}]}),
        ("parkour", "curriculum", None),
        ("parkour", "rewards.body_contact", None),
        ("parkour", "rho", 1),
        ("parkour", "horizon", None),
    ],
)
def test_every_form_of_a_value_is_valid(name: str, key: str, value: Any) -> None:
    data = put(name, key, value)
    assert loads(data)
    VALIDATOR.validate(data)


@pytest.mark.parametrize(
    "own",
    [
        {},
        {"rho": 0.4, "modes": {"jump": {"h": 0.3}, "leap": None}},
        {"oracle_params": {"preview": {"Q": {"z": 1.0}, "R": {"fx": 1.0e-3}}, "lqr": None}},
        {"gait": None, "sampling": {"weights": {"jump": None}}, "curriculum": {"modes": {"jump": None}, "step": None}},
        {"rewards": {"body_contact": {"weight": -0.1}}, "observations": {"height_scan": {"points": 5}}},
        {"evaluation": {"metrics": None, "terminations": {"fall": {"fill_gaps": True}}}},
    ],
)
def test_a_file_that_extends_another_may_leave_out_everything(own: dict[str, Any]) -> None:
    task_from_data(merged(SHIPPED["parkour"], own), TASKS_DIR / "mine.yaml")
    for name in ("parkour", "../base.yaml"):
        VALIDATOR.validate({"extends": name, **own})
    if own:
        assert not VALIDATOR.is_valid(own)


@pytest.mark.parametrize(
    "wrong",
    [
        {"extends": 3},
        {"extends": None},
        {"extend": "parkour"},
        {"rhoo": 1},
        {"rho": "wide"},
        {"oracle": None},
        {"modes": {"jump": {"hight": 1}}},
        {"modes": {"jmp": None}},
        {"modes": {"jump": {"h": None}}},
        {"sampling": {"sequence": [{"jump": {}, "leap": {}}]}},
    ],
)
def test_a_mistake_in_a_file_that_extends_another_is_rejected(wrong: dict[str, Any]) -> None:
    assert not VALIDATOR.is_valid({"extends": "parkour", **wrong})


def test_names_of_tasks_to_extend_are_completed() -> None:
    for branch in ("then", "else"):
        assert SCHEMA[branch]["properties"]["extends"]["anyOf"][0] == {
            "enum": ["dive", "dive_robot", "parkour", "parkour_robot", "stairs"]
        }
        assert list(SCHEMA[branch]["properties"])[1:] == list(WHOLE["properties"])[1:]


MODERATE = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
VALUES = [parent(data, path)[path[-1]] for data in SHIPPED.values() for path in nodes(data)]


@st.composite
def rearranged(draw: st.DrawFn) -> dict[str, Any]:
    """A shipped task with a few values dropped, switched off, or replaced by others of the shipped files."""
    data = copy.deepcopy(SHIPPED[draw(st.sampled_from(sorted(SHIPPED)))])
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(list(nodes(data))))
        node, value = parent(data, path), parent(data, path)[path[-1]]
        like = [v for v in VALUES if type(v) is type(value)]
        match draw(st.sampled_from(["drop", "null", "other", "any", "number"])):
            case "drop":
                node.pop(path[-1])
            case "null":
                node[path[-1]] = None
            case "other":
                node[path[-1]] = copy.deepcopy(draw(st.sampled_from(like)))
            case "any":
                node[path[-1]] = copy.deepcopy(draw(st.sampled_from(VALUES)))
            case "number":
                node[path[-1]] = draw(st.sampled_from([0, 1, 0.3, 2.0, [0, 1], [0.1, 0.1]]))
    return data


@MODERATE
@given(data=mutated() | rearranged())
def test_what_loads_is_valid(data: dict[str, Any]) -> None:
    if loads(data):
        VALIDATOR.validate(data)


@st.composite
def differences(draw: st.DrawFn) -> dict[str, Any]:
    """A few values of shipped tasks, or null, at keys that parkour has."""
    own: dict[str, Any] = {}
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from([path for path in nodes(SHIPPED["parkour"]) if all(type(k) is str for k in path)]))
        value = parent(SHIPPED["parkour"], path)[path[-1]]
        like = [v for v in VALUES if type(v) is type(value)]
        node = own
        for key in path[:-1]:
            if not isinstance(node.get(key), dict):
                node[key] = {}
            node = node[key]
        node[path[-1]] = copy.deepcopy(draw(st.sampled_from([None, None, *like])))
    return own


@MODERATE
@given(own=differences())
def test_what_loads_when_it_is_merged_is_valid(own: dict[str, Any]) -> None:
    if loads(merged(SHIPPED["parkour"], own)):
        VALIDATOR.validate({"extends": "parkour", **own})


@MODERATE
@given(mistake=misspelt())
def test_a_misspelt_key_is_rejected_by_both(mistake: tuple[dict[str, Any], str]) -> None:
    task, _ = mistake
    assert not loads(task)
    assert not VALIDATOR.is_valid(task)


def test_what_is_registered_later_is_in_the_schema(monkeypatch: pytest.MonkeyPatch) -> None:
    def hop(view, times: int, foot: Literal["left", "right"], names: tuple[str, ...] = (), part: Path | None = None):
        """Hop.

        :param times: how often,
            at least once
        """

    monkeypatch.setattr(registry.rewards, "_functions", {"hop": hop})
    (schema, null) = task_schema()["else"]["properties"]["rewards"]["properties"]["hop"]["anyOf"]
    assert null == {"type": "null"}
    assert schema == {
        "type": "object",
        "properties": {
            "times": {"type": "integer", "description": "how often, at least once"},
            "foot": {"enum": ["left", "right"]},
            "names": {"type": "array", "items": {"type": "string"}},
            "part": {"anyOf": [{}, {"type": "null"}], "default": None},
        },
        "required": ["times", "foot"],
        "additionalProperties": False,
        "description": "Hop.",
    }


@dataclass(frozen=True)
class Wind:
    """Wind."""

    speed: Range | None = None
    """m/s"""
    entries: tuple[SequenceEntry, ...] = ()


@pytest.mark.parametrize("value", [3, 0.5, [0.5, 2], "front", ["front", "back"], None])
def test_a_range_may_stand_in_any_dataclass(monkeypatch: pytest.MonkeyPatch, value: Any) -> None:
    def gust(view, wind: Wind): ...

    monkeypatch.setattr(registry.rewards, "_functions", {"gust": gust})
    validator = Draft202012Validator(task_schema()["else"]["properties"]["rewards"])
    data = {"speed": value, "entries": ["jump", {"pace": {"v": 1}}]}
    read(Wind, data, Where("file"))
    validator.validate({"gust": {"wind": data}})
    for wrong in ({"speeed": value}, {"speed": {"low": 1}}, {"speed": [1, 2, 3]}):
        assert not validator.is_valid({"gust": {"wind": wrong}})


def test_check_writes_it_and_needs_no_task(tmp_path: Path, monkeypatch, capsys) -> None:
    file = tmp_path / "task.schema.json"
    monkeypatch.setattr("sys.argv", ["ogmp-check", f"schema={file}"])
    check.main()
    assert json.loads(file.read_text(encoding="utf-8")) == SCHEMA
    monkeypatch.setattr("sys.argv", ["ogmp-check", "out=check"])
    with pytest.raises(SystemExit, match="2"):
        check.main()
    assert "give a task to check" in capsys.readouterr().err
