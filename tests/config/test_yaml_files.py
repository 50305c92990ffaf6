"""YAML files and overrides as plain data, and the one sentence that every mistake gets."""

import copy
import dataclasses
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from helpers.mistakes import MISSING, MISTAKES, SHIPPED, put, sentence, write
from ogmp_sb3 import load_task
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.yaml_files import apply_overrides, read_value, read_yaml, resolved

# ---- read_yaml ----


def test_a_yaml_file_is_read_as_plain_data(tmp_path: Path) -> None:
    path = tmp_path / "t.yaml"
    path.write_text("a: 1e-3\nb: &x {c: [1, null, true]}\nd: *x\ne: ${a}\n")
    data = read_yaml(path)
    assert data == {"a": 1e-3, "b": {"c": [1, None, True]}, "d": {"c": [1, None, True]}, "e": "${a}"}
    assert type(data) is dict
    assert type(data["b"]["c"]) is list
    assert data["b"] is not data["d"]  # a change of one must not change the other


def test_an_environment_variable_in_a_file_stays_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OGMP_SECRET", "42")
    path = tmp_path / "t.yaml"
    path.write_text("a: ${oc.env:OGMP_SECRET}\n")
    assert read_yaml(path) == {"a": "${oc.env:OGMP_SECRET}"}


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"a: [1", "not readable as YAML"),
        (b"a:\n\t- b", "not readable as YAML"),
        (b"a: 1\na: 2", "found duplicate key a"),
        (b"a: {b: 1, b: 2}", "found duplicate key b"),
        (b"a: 1\n---\nb: 2", "expected a single document"),
        (b"a: !!python/object/apply:os.getcwd []", "could not determine a constructor for the tag"),
        (b"a: !!bool maybe", "not readable as YAML"),
        (b"a: !!timestamp now", "not readable as YAML"),
        (b"a: !!float x", "not readable as YAML"),
        (b"a: *nothing", "found undefined alias"),
        (b"a: &x [*x]", "nested too deeply, or inside itself"),
        (b"a: " + b"[" * 3000, "nested too deeply, or inside itself"),
        (b"a: " + b"9" * 5000, "not readable as YAML"),
        (b"? [1, 2]\n: 3", "not readable as YAML"),
        (b"null: 3", "not readable as YAML"),
        (b"a: \xff\xfe", "not readable as YAML"),
        (b"a: \x00", "not readable as YAML"),
        (b"[1, 2]", "expected a mapping at the top, found the list [1, 2]"),
        (b"- a: 1", "expected a mapping at the top, found the list"),
        (b"3", "not readable as YAML"),
    ],
)
def test_a_file_that_is_no_mapping_is_one_sentence(tmp_path: Path, content: bytes, found: str) -> None:
    path = tmp_path / "t.yaml"
    path.write_bytes(content)
    with pytest.raises(ValueError) as caught:
        read_yaml(path)
    (message,) = caught.value.args
    assert message.startswith(f"{path}: ")
    assert found in message
    assert "\n" not in message


def test_a_missing_file_and_a_directory_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nothing\.yaml: no such file\."):
        read_yaml(tmp_path / "nothing.yaml")
    with pytest.raises(ValueError, match=r"not readable as YAML"):
        read_yaml(tmp_path)


# ---- read_value ----


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.3", 0.3),
        ("1e-3", 1e-3),
        ("1E3", 1000.0),
        ("30", 30),
        ("-1", -1),
        ("null", None),
        ("true", True),
        ("lqr", "lqr"),
        ("[0.1, 1e-1]", [0.1, 0.1]),
        ("{r: [front, back], h: 1}", {"r": ["front", "back"], "h": 1}),
        ("a=b", "a=b"),
        ("'1'", "1"),
        ("${rho}", "${rho}"),
    ],
)
def test_an_override_reads_as_it_would_in_a_file(tmp_path: Path, text: str, value: Any) -> None:
    path = tmp_path / "t.yaml"
    path.write_text(f"a: {text}\n")
    found = read_value(text)
    assert found == value == read_yaml(path)["a"]
    assert type(found) is type(value)


@pytest.mark.parametrize("text", ["[", "a: b: c", "!!python/name:os.system", "!!bool x", "9" * 5000, "[" * 3000])
def test_an_override_that_is_not_yaml_is_one_line(text: str) -> None:
    with pytest.raises(ValueError) as caught:
        read_value(text)
    assert "\n" not in caught.value.args[0]


# ---- overrides of a task ----


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        ("rho=1e-3", "rho", 1e-3),
        ("rho=2", "rho", 2.0),
        ("rho=null", "rho", None),
        ("horizon=15", "horizon", 15),
        ("oracle=lqr", "oracle", "lqr"),
        ("curriculum=null", "curriculum", None),
        ("feedback=[x, z]", "feedback", ("x", "z")),
        ("modes.jump.h=[0.1,2e-1]", "modes.jump.h", Range(0.1, 0.2)),
        ("bound.z=1", "bound", {"x": 1.0, "z": 1.0}),
        ("bound={x: 0, z: 1}", "bound", {"x": 0.0, "z": 1.0}),
        ("rewards.body_contact=null", "rewards.body_contact", None),
        ("observations.height_scan.points=5", "observations.height_scan.points", 5),
        ("terminations.off_track={}", "terminations.off_track", {}),
        ("gait={height: 1}", "gait.height", 1.0),
        ("evaluation.episode_steps=7", "evaluation.episode_steps", 7),
    ],
)
def test_an_override_sets_a_dotted_key_and_leaves_the_rest(text: str, key: str, value: Any) -> None:
    task = load_task("parkour", [text])
    given_key, _, given_text = text.partition("=")
    assert task == load_task("parkour", {given_key: yaml.safe_load(re.sub(r"(\d)e", r"\1.0e", given_text))})
    found: Any = task
    for name in key.split("."):
        found = found[name] if isinstance(found, dict) else getattr(found, name)
    assert found == value
    assert type(found) is type(value)
    plain = load_task("parkour")
    changed = {f.name for f in dataclasses.fields(task) if getattr(task, f.name) != getattr(plain, f.name)}
    assert changed == {key.split(".")[0]}


@pytest.mark.parametrize(("key", "value", "kind"), [m[:3] for m in MISTAKES if not isinstance(m[1], dict)])
def test_a_mistake_in_an_override_gets_the_same_sentence_as_in_the_file(
    key: str, value: Any, kind: type[Exception]
) -> None:
    path = Path("/nowhere/mine.yaml")
    with pytest.raises(kind) as in_file:
        task_from_data(put(SHIPPED["parkour"], key, value), path)
    data = apply_overrides(copy.deepcopy(SHIPPED["parkour"]), {key: value}, str(path))
    with pytest.raises(kind) as in_override:
        task_from_data(data, path)
    assert in_override.value.args == in_file.value.args


def test_overrides_apply_in_order() -> None:
    assert load_task("parkour", ["rho=1", "rho=2"]).rho == 2.0
    assert load_task("parkour", ["curriculum=null", "curriculum.step=0.2"]).curriculum.step == 0.2
    assert load_task("parkour", ["curriculum=null", "curriculum.step=0.2"]).curriculum.modes == {}


def test_nested_mappings_lists_tuples_and_numpy_numbers_are_overrides_too() -> None:
    expected = load_task("parkour", ["modes.jump.h=[0.1,0.2]", "rho=0.25", "feedback=[x]"])
    nested = {"modes": {"jump": {"h": (0.1, 0.2)}}, "rho": np.float64(0.25), "feedback": ("x",)}
    assert load_task("parkour", nested) == expected
    assert load_task("parkour", {"modes": {"jump.h": [0.1, 0.2]}, "rho": 0.25, "feedback": ["x"]}) == expected
    assert load_task("parkour", (o for o in ["modes.jump.h=[0.1,0.2]", "rho=0.25", "feedback=[x]"])) == expected


def test_a_group_that_the_file_leaves_out_can_be_overridden(tmp_path: Path) -> None:
    path = write(tmp_path, put(put(SHIPPED["parkour"], "gait", MISSING), "evaluation", MISSING))
    task = load_task(path, ["gait.height=0.6", "evaluation.episode_steps=50"])
    assert (task.gait.height, task.gait.cycle, task.evaluation.episode_steps) == (0.6, 0.25, 50)


def test_a_mode_and_a_term_can_be_added_by_dotted_keys() -> None:
    task = load_task("dive", ["modes.pace.v=[0.1,1]", "observations.height_scan={points: 3, spacing: 0.1}"])
    assert task.modes["pace"] == {"v": Range(0.1, 1.0)}
    assert list(task.observations) == ["proprioception", "clock", "mode_latent", "height_scan"]


def test_overriding_one_of_two_oracles_that_share_their_weights_leaves_the_other() -> None:
    params = load_task("parkour", ["oracle_params.preview.Q.x=7"]).oracle_params
    assert (params["preview"]["Q"]["x"], params["lqr"]["Q"]["x"]) == (7.0, 0.0)


def test_null_switches_a_mode_off_with_its_weights_and_curriculum() -> None:
    task = load_task("parkour", ["modes.jump=null"])
    assert list(task.mode_ranges) == ["pace", "leap"]
    assert list(task.sampling.weights) == ["pace", "leap"]
    assert list(task.curriculum.weights) == ["pace", "leap"]
    assert list(task.curriculum.modes) == ["pace", "leap"]


def test_null_cannot_switch_off_a_mode_that_a_sequence_needs() -> None:
    assert "'sampling.sequence' has 'settle' (allowed: flip)" in sentence(KeyError, "dive", ["modes.settle=null"])


def test_overrides_are_not_changed() -> None:
    overrides = {"curriculum": {"weights": {"pace": 1.0}}, "curriculum.weights.jump": 0.5}
    before = copy.deepcopy(overrides)
    task = load_task("parkour", overrides)
    assert overrides == before
    overrides["curriculum"]["weights"]["pace"] = 9.0  # type: ignore[index]
    assert task.curriculum is not None
    assert task.curriculum.weights["pace"] == 1.0


def test_parameters_of_terms_and_oracles_have_the_types_that_functions_ask_for() -> None:
    task = load_task("parkour", ["oracle_params.preview.eps=1", "rewards.body_contact.weight=-1"])
    assert isinstance(task.oracle_params["preview"]["eps"], float)
    assert isinstance(task.rewards["body_contact"]["weight"], float)


@pytest.mark.parametrize(
    ("overrides", "kind", "message"),
    [
        (["rho"], ValueError, "override 'rho' must have the form key=value"),
        (["=3"], ValueError, "override '=3' must have the form key=value"),
        (["rho="], ValueError, "override 'rho=' must have the form key=value (null for nothing)"),
        ([None], ValueError, "override 'None' must have the form key=value"),
        (["rho=["], ValueError, "override 'rho=[' has a value that is not YAML"),
        (["rho=a: b: c"], ValueError, "has a value that is not YAML"),
        (["rho=!!python/name:os.system"], ValueError, "has a value that is not YAML"),
        (["rho=" + "9" * 5000], ValueError, "has a value that is not YAML"),
        (["rho.x=3"], TypeError, "'rho' is the number 0.5: it has no 'x' to set"),
        (["modes.jump.h.low=3"], TypeError, "'modes.jump.h' is the list [0.2, 0.35]: it has no 'low' to set"),
        (["feedback.0=x"], TypeError, "'feedback' is the list"),
        (["modes.jum.h=1"], KeyError, "unknown mode 'jum'"),
        (["mode.jump.h=1"], KeyError, "'mode' is not a known key"),
        (["rho..x=1"], TypeError, "'rho' is the number 0.5"),
        ([".rho=1"], KeyError, "'' is not a known key"),
        (["a.b.c=1"], KeyError, "'a' is not a known key"),
        ({"rh\no": 1}, KeyError, r"'rh\no' is not a known key"),
        ({3: 4}, KeyError, "'3' is not a known key"),
        ({None: 4}, KeyError, "'None' is not a known key"),
        ({"rho": object()}, TypeError, "'rho' must be a number, found the value <object object"),
        ({"rho": {"x": 1}}, TypeError, "'rho' must be a number, found a mapping"),
        ("rho=3", TypeError, "overrides must be a mapping or a list of key=value, found the text 'rho=3'"),
        (b"rho=3", TypeError, "overrides must be a mapping or a list of key=value"),
        (3, TypeError, "overrides must be a mapping or a list of key=value, found the number 3"),
        (None, TypeError, "overrides must be a mapping or a list of key=value, found nothing"),
    ],
)
def test_a_mistaken_override_is_one_sentence(overrides: Any, kind: type[Exception], message: str) -> None:
    assert message in sentence(kind, "parkour", overrides)


# ---- apply_overrides, task_from_data ----


def test_overrides_of_plain_data_are_put_in_place() -> None:
    data = copy.deepcopy(SHIPPED["parkour"])
    assert apply_overrides(data, ["modes.jump.h=1"], "t") is data
    assert data["modes"]["jump"]["h"] == 1


@pytest.mark.parametrize(
    "overrides, bound",
    [
        (["bound={z: 1.0}"], {"z": 1.0}),
        ({"bound": {"z": 1.0}}, {"z": 1.0}),
        ({"bound": {"pitch": 2.0, "x": 0.0}}, {"pitch": 2.0, "x": 0.0}),
        (["bound={x: 1.0}", "bound.y=2.0"], {"x": 1.0, "y": 2.0}),
        (["bound.y=2.0", "bound={x: 1.0}"], {"x": 1.0}),
        (["bound.z=2.0"], {"z": 2.0, "wx": 0.025, "wy": 0.025}),
        ({"bound.x": 2.0}, {"x": 2.0, "z": 1.0, "wx": 0.025, "wy": 0.025}),
    ],
)
def test_a_mapping_for_the_bound_replaces_it_and_a_single_weight_does_not(
    overrides: Any, bound: dict[str, float]
) -> None:
    assert load_task("dive", overrides).bound == bound


def test_every_other_mapping_merges() -> None:
    overrides = {
        "modes": {"flip": {"h": 1.2}},
        "oracle_params.lqr.Q": {"stance": {"z": 5.0}},
        "evaluation": {"initial": {"x": 0.1}},
    }
    task, shipped = load_task("dive", overrides), load_task("dive")
    assert task.mode_ranges["flip"] == {**shipped.mode_ranges["flip"], "h": Range(1.2, 1.2)}
    phases = shipped.oracle_params["lqr"]["Q"]
    assert task.oracle_params["lqr"]["Q"] == {**phases, "stance": {**phases["stance"], "z": 5.0}}
    assert task.evaluation.initial == replace(shipped.evaluation.initial, x=Range(0.1, 0.1))  # type: ignore[type-var]


def test_a_bound_of_another_task_in_an_override_is_not_taken_for_the_task_s() -> None:
    """Only at the top: a mapping of this name anywhere else merges like all others."""
    assert apply_overrides({"a": {"bound": {"x": 1}}}, {"a": {"bound": {"y": 2}}}, "t")["a"]["bound"] == {
        "x": 1,
        "y": 2,
    }


def test_plain_data_that_is_no_mapping_is_an_error() -> None:
    with pytest.raises(TypeError, match=r"^t\.yaml must be a mapping, found the list \[\]\.$"):
        task_from_data([], Path("t.yaml"))  # type: ignore[arg-type]


def test_reading_a_task_leaves_its_data_alone() -> None:
    data = copy.deepcopy(SHIPPED["parkour"])
    task = task_from_data(data, Path("t.yaml"))
    assert data == SHIPPED["parkour"]
    data["oracle_params"]["preview"]["Q"]["z"] = 0.0
    data["rewards"]["body_contact"]["weight"] = 0.0
    assert task.oracle_params["preview"]["Q"]["z"] == 11000.0
    assert task.rewards["body_contact"] == {"weight": -0.3}


# ---- resolved ----


def test_what_refers_to_something_else_has_its_value(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TASK_ID", "7")
    monkeypatch.setenv("RANGE", "[0.1, 0.2]")
    data = {
        "a": "${oc.env:TASK_ID}",
        "b": {"c": "${a}", "d": ["${b.c}", 1.5, "x"], "e": "${.c}"},
        "f": "${oc.env:RANGE}",
        "g": "${b}",
        "h": "run_${a}",
        "i": "${seed}",
        "j": None,
    }
    before = copy.deepcopy(data)
    inner = {"c": 7, "d": [7, 1.5, "x"], "e": 7}
    expected = {"a": 7, "b": inner, "f": [0.1, 0.2], "g": inner, "h": "run_7", "i": 3, "j": None}
    assert resolved(data, Where("t.yaml"), {"seed": 3}) == expected
    assert data == before


def test_data_that_refers_to_nothing_is_left_as_it_is() -> None:
    data = {"a": "$x", "b": [1, {"c": "{}"}]}
    assert resolved(data, Where("t.yaml")) is data


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("${nothing}", "Interpolation key 'nothing' not found"),
        ("${oc.env:NOT_SET_ANYWHERE}", "Environment variable 'NOT_SET_ANYWHERE' not found"),
        ("${no_such:1}", "Unsupported interpolation type no_such"),
    ],
)
def test_what_has_no_value_is_named_in_one_sentence(text: str, reason: str) -> None:
    with pytest.raises(ValueError) as error:
        resolved({"a": {"b": [1, text]}}, Where("t.yaml"))
    assert str(error.value) == f"t.yaml: 'a.b.1': {text!r} has no value ({reason})."
    with pytest.raises(ValueError, match=r"^t.yaml: .* cannot be read|'a'"):
        resolved({"a": "${"}, Where("t.yaml"))


def test_a_task_and_its_overrides_may_refer_to_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BOUND", "0.7")
    path = tmp_path / "t.yaml"
    path.write_text(yaml.safe_dump(SHIPPED["parkour"] | {"rho": "${oc.env:BOUND}", "robot": "hector"}))
    assert load_task(path).rho == 0.7
    assert load_task(path, {"horizon": "${oc.env:STEPS,15}"}).horizon == 15
    with pytest.raises(ValueError, match=r"t.yaml: 'rho': '\$\{x\}' has no value"):
        load_task(path, ["rho=${x}"])
