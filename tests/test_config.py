"""Tests of task and robot files: what they may say, and the one sentence that every mistake gets."""

import copy
import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ogmp_sb3 import load_task
from ogmp_sb3.config import (
    ROBOTS_DIR,
    TASKS_DIR,
    apply_overrides,
    load_robot,
    task_from_data,
    task_names,
    task_path,
)
from ogmp_sb3.definitions import MAX_SUBSTEPS, RobotConfig, TaskConfig
from ogmp_sb3.ranges import Range
from ogmp_sb3.schema import read_yaml
from ogmp_sb3.srb import INPUT_NAMES, STATE_NAMES

SHIPPED = {name: read_yaml(TASKS_DIR / f"{name}.yaml") for name in ("dive", "parkour")}
ROBOT = read_yaml(ROBOTS_DIR / "hector" / "robot.yaml")
MISSING = object()


def put(data: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A copy of ``data`` with a dotted key set, or removed if the value is ``MISSING``."""
    data = copy.deepcopy(data)
    *groups, last = key.split(".")
    node = data
    for group in groups:
        node = node[group]
    if value is MISSING:
        del node[last]
    else:
        node[last] = value
    return data


def write(folder: Path, data: Any) -> Path:
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def sentence(kind: type[Exception], path: Path | str, overrides: Any = ()) -> str:
    """The message of the error that loading ends in: one line that names the file."""
    with pytest.raises((ValueError, KeyError, TypeError)) as caught:
        load_task(path, overrides)
    (message,) = caught.value.args
    assert type(caught.value) is kind, message
    assert "\n" not in message
    name = f"tasks/{path}.yaml" if path in SHIPPED else str(path)
    assert message.startswith(f"{name}: ")
    assert message.count(name) == 1
    assert message[-1] in ".?"
    return message


# ---- RobotConfig ----


def test_the_shipped_robot_is_read_with_its_model_beside_it() -> None:
    robot = load_robot("hector")
    assert isinstance(robot, RobotConfig)
    assert robot.mjcf_path.is_file()
    assert len(robot.joints) == len(robot.nominal_joints) == 10


@pytest.mark.parametrize(
    ("key", "value", "kind", "message"),
    [
        ("joints", MISSING, KeyError, "'joints' is missing"),
        ("joint", [], KeyError, "'joint' is not a known key .*Did you mean 'joints'?"),
        ("path", "x", KeyError, "'path' is not a known key"),
        ("srb.mas", 1, KeyError, r"'srb\.mas' is not a known key .*Did you mean 'mass'?"),
        ("srb.mass", -1, ValueError, "'srb' must be above 0, found -1"),
        ("srb.inertia", [1, 0, 1], ValueError, "'srb' must be above 0, found 0"),
        ("srb.inertia", [1, 1], ValueError, r"'srb\.inertia' must have 3 entries, found 2"),
        ("srb.inertia", "x", TypeError, r"'srb\.inertia' must be a list"),
        ("nominal_joints", [0.0], ValueError, "10 joints but 1 nominal_joints"),
        ("nominal_height", 0, ValueError, "'nominal_height' must be above 0, found 0"),
        ("leg_length", math.nan, ValueError, "'leg_length' must be finite"),
        ("feet", [], ValueError, "'feet' names no body"),
        ("feet", ["L_toe", "L_toe"], ValueError, "'feet' has 'L_toe' twice"),
        ("joints", ["L_knee"] * 10, ValueError, "'joints' has 'L_knee' twice"),
        ("mjcf", "nothing.xml", ValueError, r"'mjcf': there is no file .*nothing\.xml"),
    ],
)
def test_a_mistake_in_a_robot_file_names_robot_file_task_file_and_key(
    tmp_path: Path, key: str, value: Any, kind: type[Exception], message: str
) -> None:
    (tmp_path / "hector.xml").write_text("<mujoco/>")
    (tmp_path / "mine_robot.yaml").write_text(yaml.safe_dump(put(ROBOT, key, value)))
    path = write(tmp_path, put(SHIPPED["parkour"], "robot", "mine_robot.yaml"))
    with pytest.raises(kind, match=message) as caught:
        load_task(path)
    assert caught.value.args[0].startswith(f"{path}: 'robot': {tmp_path}/mine_robot.yaml: ")


def test_a_robot_is_found_relative_to_the_task_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "hector.xml").write_text("<mujoco/>")
    (tmp_path / "sub" / "r.yaml").write_text(yaml.safe_dump(put(ROBOT, "name", "mine")))
    path = write(tmp_path, put(SHIPPED["parkour"], "robot", "sub/r.yaml"))
    monkeypatch.chdir("/")
    robot = load_task(path).robot_config
    assert robot.name == "mine"
    assert robot.mjcf_path == tmp_path / "sub" / "hector.xml"


# ---- TaskConfig ----


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_task_says_what_its_file_says(name: str) -> None:
    task, data = load_task(name), SHIPPED[name]
    assert (task.name, task.file) == (name, f"tasks/{name}.yaml")
    assert task.rho == data["rho"]
    assert task.horizon == data["horizon"]
    assert list(task.observations) == list(data["observations"])
    assert task.oracle_params["preview"] == task.oracle_params["lqr"] == data["oracle_params"]["lqr"]
    assert task.substeps * task.physics_dt == pytest.approx(task.control_dt)
    assert task.evaluation.metrics == tuple(data["evaluation"]["metrics"])


def test_a_task_cannot_be_changed() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_task("parkour").rho = 1.0  # type: ignore[misc]


def test_bound_weights_follow_the_state_names() -> None:
    weights = load_task("parkour", {"bound": {"x": 2.0, "vz": 3.0}}).bound_weights
    assert dict(zip(STATE_NAMES, weights, strict=True)) == dict.fromkeys(STATE_NAMES, 0.0) | {"x": 2.0, "vz": 3.0}


def test_the_test_protocol_has_no_bound_no_floor_and_no_curriculum() -> None:
    task = load_task("parkour", {"evaluation.terminations.off_track": {}}).for_evaluation()
    assert (task.rho, task.min_step_reward, task.curriculum) == (None, None, None)
    assert (task.episode_steps, task.track.length) == (400, 10.0)
    assert list(task.terminations) == ["fall", "off_track"]


# ---- load_task: one mistake, one sentence ----

MISTAKES = [
    # time and limits
    ("control_dt", 0.031, ValueError, "control_dt / physics_dt must be a whole number"),
    ("control_dt", 0.03 * MAX_SUBSTEPS, ValueError, f"must be a whole number below {MAX_SUBSTEPS}"),
    ("control_dt", 1e308, ValueError, "'control_dt' is too large: numbers lie between -1e+12 and 1e+12, found 1e+308"),
    ("control_dt", 0, ValueError, "'control_dt' must be above 0, found 0"),
    ("physics_dt", 0.06, ValueError, "found 0.03 / 0.06 = 0.5"),
    ("physics_dt", 1e-320, ValueError, "control_dt / physics_dt must be a whole number"),
    ("physics_dt", -0.002, ValueError, "'physics_dt' must be above 0, found -0.002"),
    ("physics_dt", "2 ms", TypeError, "'physics_dt' must be a number, found the text '2 ms'"),
    ("episode_steps", 0, ValueError, "'episode_steps' must be at least 1, found 0"),
    ("episode_steps", 10**30, ValueError, "'episode_steps' is too large"),
    ("episode_steps", 300.0, TypeError, "'episode_steps' must be a whole number, found the number 300.0"),
    ("horizon", 0, ValueError, "'horizon' must be at least 1 control step or null, found 0"),
    ("horizon", -1, ValueError, "'horizon' must be at least 1"),
    ("horizon", True, TypeError, "'horizon' must be a whole number, found the value True"),
    ("rho", 0, ValueError, "'rho' must be above 0, or null for no bound, found 0"),
    ("rho", -0.5, ValueError, "'rho' must be above 0"),
    ("rho", math.nan, ValueError, "'rho' must be finite, found nan"),
    ("rho", math.inf, ValueError, "'rho' must be finite, found inf"),
    ("rho", 10**400, ValueError, "'rho' is too large"),
    ("rho", "half", TypeError, "'rho' must be a number, found the text 'half'"),
    ("rho", [0.5], TypeError, "'rho' must be a number, found the list [0.5]"),
    ("rho", "${control_dt}", TypeError, "'rho' must be a number, found the text '${control_dt}'"),
    ("min_step_reward", math.nan, ValueError, "'min_step_reward' must be finite"),
    # keys
    ("rhoo", 0.5, KeyError, "'rhoo' is not a known key (allowed: ", "Did you mean 'rho'?"),
    ("name", "x", KeyError, "'name' is not a known key"),
    ("robot_config", None, KeyError, "'robot_config' is not a known key"),
    ("", 1, KeyError, "'' is not a known key"),
    ("track.widht", 1, KeyError, "'track.widht' is not a known key (allowed: boxes, length, width). Did you mean"),
    ("evaluation.metric", [], KeyError, "'evaluation.metric' is not a known key", "Did you mean 'metrics'?"),
    # modes
    ("modes", None, TypeError, "'modes' must be a mapping, found nothing (null)"),
    ("modes", [], TypeError, "'modes' must be a mapping, found the list []"),
    ("modes.jmp", {"w": 0.3, "h": 0.2}, KeyError, "'modes': unknown mode 'jmp' (allowed: ", "Did you mean 'jump'?"),
    ("modes.jmp", None, KeyError, "'modes': unknown mode 'jmp'", "Did you mean 'jump'?"),
    ("modes.jump", 3, TypeError, "'modes.jump' must be a mapping, found the number 3"),
    ("modes.jump.hh", 1, KeyError, "mode 'jump' has no parameter 'hh' (allowed: h, run_up, v, w). Did you mean 'h'?"),
    ("modes.flip", {"r": "front"}, KeyError, "'modes.flip': mode 'flip' needs the parameter 'h'"),
    ("modes.flip", {"r": "fron", "h": 1}, KeyError, "'modes.flip.r' has 'fron' (allowed: ", "Did you mean 'front'?"),
    ("modes.flip", {"r": 1, "h": 1}, TypeError, "'modes.flip.r' must be one or more of the words front, ", "found 1"),
    ("modes.flip", {"r": [0, 1], "h": 1}, TypeError, "must be one or more of the words", "found 0 to 1"),
    ("modes.jump.h", "front", TypeError, "'modes.jump.h' must be a number or [low, high], found front"),
    ("modes.jump.h", ["a", "b"], TypeError, "'modes.jump.h' must be a number or [low, high], found a, b"),
    ("modes.jump.h", None, TypeError, "'modes.jump.h' must be a number"),
    ("modes.jump.h", [0.3, 0.2], ValueError, "'modes.jump.h' is a reversed range: 0.3 > 0.2"),
    ("modes.jump.h", [0.1, math.inf], ValueError, "'modes.jump.h.1' must be finite, found inf"),
    ("modes.jump.h", -0.1, ValueError, "'modes.jump.h' must be at least 0, found -0.1"),
    ("modes.jump.h", [-0.1, 0.1], ValueError, "'modes.jump.h' must be at least 0, found -0.1"),
    # sampling
    ("sampling.order", "randm", ValueError, "'sampling.order' is the text 'randm'", "Did you mean 'random'?"),
    ("sampling.order", "sequence", ValueError, "'sampling': order: sequence needs a sequence of modes"),
    ("sampling.sequence", ["pace", "jmp"], KeyError, "'sampling.sequence' has 'jmp'", "Did you mean 'jump'?"),
    ("sampling.sequence", ["flip"], KeyError, "'sampling.sequence' has 'flip' (allowed: jump, leap, pace)"),
    ("sampling.sequence", "pace", TypeError, "'sampling.sequence' must be a list, found the text 'pace'"),
    ("sampling.weights.jmp", 1, KeyError, "'sampling.weights' has 'jmp'", "Did you mean 'jump'?"),
    ("sampling.weights.jump", -1, ValueError, "'sampling': 'weights.jump' must be at least 0, found -1"),
    ("sampling.weights.jump", None, TypeError, "'sampling.weights.jump' must be a number"),
    # curriculum
    ("curriculum", True, TypeError, "'curriculum' must be a mapping, found the value True"),
    ("curriculum.weights.jump", -1, ValueError, "'curriculum': 'weights.jump' must be at least 0, found -1"),
    ("curriculum.weights.pace", 0, ValueError, "'curriculum.weights' gives every mode the weight 0"),
    ("curriculum.weights.pac", 1, KeyError, "'curriculum.weights' has 'pac'", "Did you mean 'pace'?"),
    ("curriculum.modes.flip", {"h": 1}, KeyError, "'curriculum.modes' has 'flip' (allowed: jump, leap, pace)"),
    ("curriculum.modes.jump.hh", 1, KeyError, "'curriculum.modes.jump' has 'hh'", "Did you mean 'h'?"),
    ("curriculum.modes.jump.h", "front", TypeError, "'curriculum.modes.jump.h' must be a number or [low, high]"),
    ("curriculum.modes.jump.h", [0.2, 0.1], ValueError, "'curriculum.modes.jump.h' is a reversed range"),
    ("curriculum.modes.jump", None, TypeError, "'curriculum.modes.jump' must be a mapping"),
    ("curriculum.step", 0, ValueError, "'curriculum': 'step' must be above 0, found 0"),
    ("curriculum.raise_above", 2, ValueError, "lower_below <= raise_above <= 1 must hold, found", "raise_above 2"),
    ("curriculum.lower_below", 0.9, ValueError, "'curriculum': 0 <= lower_below <= raise_above <= 1 must hold"),
    # ground, gait, action
    ("track.width", 0, ValueError, "'track': 'width' must be above 0, found 0"),
    ("track.length", -1, ValueError, "'track': 'length' must be above 0, found -1"),
    ("track.boxes", 1, ValueError, "'track': boxes must be at least 2, found 1"),
    ("gait.height", -1, ValueError, "'gait': 'height' must be above 0, found -1"),
    ("gait.cycle", 0, ValueError, "'gait': 'cycle' must be above 0, found 0"),
    ("action.scale", 0, ValueError, "'action': 'scale' must be above 0, found 0"),
    ("action.noise", math.inf, ValueError, "'action.noise' must be finite, found inf"),
    # oracle
    ("oracle", "prevew", KeyError, "'oracle': unknown oracle 'prevew' (allowed: ", "Did you mean 'preview'?"),
    ("oracle", None, TypeError, "'oracle' must be text, found nothing (null)"),
    ("oracle_params.prevew", {}, KeyError, "'oracle_params': unknown oracle 'prevew'", "Did you mean 'preview'?"),
    ("oracle_params.preview", None, TypeError, "'oracle_params.preview' must be a mapping"),
    ("oracle_params.preview.esp", 1, KeyError, "oracle 'preview' has no parameter 'esp'", "Did you mean 'eps'?"),
    ("oracle_params.linear.Q", {}, KeyError, "oracle 'linear' has no parameter 'Q' (allowed: none)"),
    ("oracle_params.preview.Q", None, TypeError, "'oracle_params.preview.Q' must be a mapping"),
    ("oracle_params.preview.Q.rol", 1, KeyError, "'oracle_params.preview.Q' has 'rol'", "Did you mean 'roll'?"),
    ("oracle_params.preview.Q.x", -1, ValueError, "'oracle_params.preview.Q.x' must be at least 0, found -1"),
    ("oracle_params.preview.Q.x", math.nan, ValueError, "'oracle_params.preview.Q.x' must be finite, found nan"),
    ("oracle_params.preview.R.fx", 0, ValueError, "'oracle_params.preview.R.fx' must be above 0, found 0"),
    ("oracle_params.lqr.R.mz", -1.0, ValueError, "'oracle_params.lqr.R.mz' must be above 0, found -1"),
    ("oracle_params.preview.R.fw", 1, KeyError, "'oracle_params.preview.R' has 'fw' (allowed: fx, fy, fz, mx, my, mz)"),
    ("oracle_params.preview.R.fx", "x", TypeError, "'oracle_params.preview.R.fx' must be a number"),
    ("oracle_params.preview.eps", 0, ValueError, "'oracle_params.preview.eps' must be above 0, found 0"),
    ("oracle_params.preview.eps", "small", TypeError, "'oracle_params.preview.eps' must be a number"),
    ("feedback", ["x", "yy"], KeyError, "'feedback' has 'yy' (allowed: ", "Did you mean 'y"),
    ("feedback", ["x", "x"], ValueError, "'feedback' has 'x' twice"),
    ("feedback", "x", TypeError, "'feedback' must be a list, found the text 'x'"),
    # bound
    ("bound.pich", 1, KeyError, "'bound' has 'pich' (allowed: ", "Did you mean 'pitch'?"),
    ("bound.x", -1, ValueError, "'bound.x' must be at least 0, found -1"),
    ("bound.x", 0, ValueError, "'bound' gives every state the weight 0"),
    ("bound.x", None, TypeError, "'bound.x' must be a number"),
    # terms
    ("observations.clok", {}, KeyError, "'observations': unknown observation 'clok'", "Did you mean 'clock'?"),
    ("observations.clok", None, KeyError, "'observations': unknown observation 'clok'"),
    ("observations.z", {}, KeyError, "'observations': unknown observation 'z' (allowed: "),
    ("observations.clock", 3, TypeError, "'observations.clock' must be a mapping, found the number 3"),
    ("observations.height_scan.point", 3, KeyError, "observation 'height_scan' has no parameter 'point'"),
    ("observations.height_scan.points", 1.5, TypeError, "'observations.height_scan.points' must be a whole number"),
    ("rewards.body_contac", {}, KeyError, "'rewards': unknown reward 'body_contac'", "Did you mean 'body_contact'?"),
    (
        "rewards.body_contact",
        {},
        KeyError,
        "'rewards.body_contact': reward 'body_contact' needs the parameter 'weight'",
    ),
    ("rewards.body_contact.weight", None, TypeError, "'rewards.body_contact.weight' must be a number"),
    ("rewards.body_contact.weight", -math.inf, ValueError, "'rewards.body_contact.weight' must be finite"),
    ("terminations.fal", {}, KeyError, "'terminations': unknown termination 'fal'", "Did you mean 'fall'?"),
    ("terminations.fall.fill_gaps", 3, TypeError, "'terminations.fall.fill_gaps' must be true or false"),
    # evaluation and objective
    ("evaluation", None, TypeError, "'evaluation' must be a mapping"),
    ("evaluation.episode_steps", 0, ValueError, "'evaluation': 'episode_steps' must be at least 1, found 0"),
    ("evaluation.track_length", 0, ValueError, "'evaluation': 'track_length' must be above 0, found 0"),
    ("evaluation.terminations.fal", {}, KeyError, "'evaluation.terminations': unknown termination 'fal'"),
    ("evaluation.metrics", ["retrun"], KeyError, "'evaluation.metrics': unknown metric 'retrun'", "mean 'return'?"),
    ("evaluation.metrics", ["return", "return"], ValueError, "'evaluation': 'metrics' has 'return' twice"),
    ("evaluation.metrics", [3], TypeError, "'evaluation.metrics.0' must be text, found the number 3"),
    ("objective", "flip_and_lan", KeyError, "'objective': unknown objective", "Did you mean 'flip_and_land'?"),
    ("objective", 3, TypeError, "'objective' must be text, found the number 3"),
    # robot
    ("robot", "hectr", KeyError, "'robot': unknown robot 'hectr' (allowed: hector). Did you mean 'hector'?"),
    ("robot", "", KeyError, "'robot': unknown robot ''"),
    ("robot", "..", KeyError, "'robot': unknown robot '..'"),
    ("robot", "x" * 5000, KeyError, "'robot': unknown robot"),
    ("robot", "nothing.yaml", ValueError, "'robot': ", "nothing.yaml: no such file"),
    ("robot", None, TypeError, "'robot' must be text"),
]


@pytest.mark.parametrize(("key", "value", "kind", "parts"), [(k, v, e, parts) for k, v, e, *parts in MISTAKES])
def test_a_mistake_is_one_sentence(
    tmp_path: Path, key: str, value: Any, kind: type[Exception], parts: list[str]
) -> None:
    message = sentence(kind, write(tmp_path, put(SHIPPED["parkour"], key, value)))
    for part in parts:
        assert part in message


REQUIRED = [f.name for f in dataclasses.fields(TaskConfig) if f.default is f.default_factory is dataclasses.MISSING]


@pytest.mark.parametrize(
    ("key", "message"),
    [
        *((key, f"'{key}' is missing") for key in REQUIRED),
        ("modes.jump.w", "'modes.jump': mode 'jump' needs the parameter 'w'"),
        ("modes.leap.d", "'modes.leap': mode 'leap' needs the parameter 'd'"),
        ("oracle_params", "'oracle_params.preview': oracle 'preview' needs the parameter 'Q'"),
        ("oracle_params.preview", "'oracle_params.preview': oracle 'preview' needs the parameter 'Q'"),
        ("oracle_params.lqr.R", "'oracle_params.lqr': oracle 'lqr' needs the parameter 'R'"),
        *((f"oracle_params.preview.R.{u}", f"'oracle_params.preview.R.{u}' is missing") for u in INPUT_NAMES),
        ("rewards.body_contact.weight", "'rewards.body_contact': reward 'body_contact' needs the parameter 'weight'"),
        ("terminations.fall.min_height", "termination 'fall' needs the parameter 'min_height'"),
        ("observations.height_scan.points", "observation 'height_scan' needs the parameter 'points'"),
        ("modes.pace", "'sampling.weights' has 'pace' (allowed: jump, leap)"),
    ],
)
def test_a_missing_key_is_named(tmp_path: Path, key: str, message: str) -> None:
    assert message in sentence(KeyError, write(tmp_path, put(SHIPPED["parkour"], key, MISSING)))


@pytest.mark.parametrize(
    ("key", "value", "kind", "message"),
    [
        ("modes", {}, ValueError, "'modes' names no mode"),
        ("modes", {"pace": None}, ValueError, "'modes' names no mode"),
        ("bound", {}, ValueError, "'bound' gives every state the weight 0"),
        ("observations", {}, ValueError, "'observations' names no observation"),
        ("observations", {"clock": None}, ValueError, "'observations' names no observation"),
        ("sampling", {"weights": dict.fromkeys(("pace", "jump", "leap"), 0)}, ValueError, "every mode the weight 0"),
        ("oracle_params", {"preview": {"Q": {}, "R": {}, "eps": 1}}, KeyError, "preview.R.fx' is missing"),
    ],
)
def test_what_must_not_be_empty_is_named(tmp_path: Path, key: str, value: Any, kind: type[Exception], message: str):
    assert message in sentence(kind, write(tmp_path, put(SHIPPED["parkour"], key, value)))


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("", KeyError, "'description' is missing"),
        ("[1, 2]", ValueError, "expected a mapping at the top, found the list"),
        ("hello", KeyError, "'hello' is not a known key"),
        ("rho: [", ValueError, "not readable as YAML"),
        ("rho: 1\nrho: 2", ValueError, "found duplicate key rho"),
        ("rho: !!python/name:os.system", ValueError, "not readable as YAML"),
        ('"a\\nb": 1', KeyError, r"'a\nb' is not a known key"),
        ("1: 2", KeyError, "'1' is not a known key"),
    ],
)
def test_a_file_that_is_no_task_is_one_sentence(tmp_path: Path, text: str, kind: type[Exception], message: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(kind, match=re.escape(message).replace(r"\\n", r"\\+n")) as caught:
        load_task(path)
    assert caught.value.args[0].startswith(f"{path}: ")
    assert "\n" not in caught.value.args[0]


# ---- load_task: overrides ----


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


# ---- task_path, task_names ----


def test_a_task_is_found_by_name_and_by_path(tmp_path: Path) -> None:
    assert set(SHIPPED) <= set(task_names())
    assert all(task_path(name).is_file() for name in task_names())
    path = write(tmp_path, SHIPPED["parkour"])
    assert task_path(path) == task_path(str(path)) == path
    assert load_task(path).name == "mine"


@pytest.mark.parametrize("name", ["parkuor", "Parkour"])
def test_an_unknown_task_has_a_closest_match(name: str) -> None:
    with pytest.raises(KeyError, match=rf"unknown task '{name}' \(allowed: .*\)\. Did you mean 'parkour'\? Or give"):
        load_task(name)


@pytest.mark.parametrize("name", ["", ".", "..", "*", "a\nb", "a\0b", "x" * 5000, 3, None])
def test_what_cannot_name_a_task_is_an_error(name: Any) -> None:
    with pytest.raises(KeyError, match="unknown task"):
        load_task(name)


@pytest.mark.parametrize("name", ["nothing.yaml", "/", "/nowhere/x.yml", "a\0b.yaml", "x" * 5000 + ".yaml"])
def test_a_missing_task_file_is_an_error(name: str) -> None:
    with pytest.raises(ValueError, match="no such file"):
        load_task(name)
