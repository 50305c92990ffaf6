"""Task and robot files with mistakes, and the sentence that each gets."""

import copy
import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from ogmp_sb3 import load_task
from ogmp_sb3.config.catalogue import ROBOTS_DIR, TASKS_DIR
from ogmp_sb3.config.task import MAX_SUBSTEPS
from ogmp_sb3.config.yaml_files import read_yaml

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


IN_ORDER = {"order": "sequence"}
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
    (
        "modes.jump.hh",
        1,
        KeyError,
        "mode 'jump' has no parameter 'hh' (allowed: h, lead, run_up, tail, v, w). Did you mean 'h'?",
    ),
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
    (
        "sampling",
        {**IN_ORDER, "sequence": ["pace", "jmp"]},
        KeyError,
        "'sampling.sequence' has 'jmp'",
        "Did you mean 'jump'?",
    ),
    (
        "sampling",
        {**IN_ORDER, "sequence": ["flip"]},
        KeyError,
        "'sampling.sequence' has 'flip' (allowed: jump, leap, pace)",
    ),
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
    ("curriculum.raise_above", 2, ValueError, "lower_below <= raise_above < 1 must hold, found", "raise_above 2"),
    ("curriculum.lower_below", 0.9, ValueError, "'curriculum': 0 <= lower_below <= raise_above < 1 must hold"),
    # ground, gait, action
    ("track.width", 0, ValueError, "'track': 'width' must be above 0, found 0"),
    ("track.length", -1, ValueError, "'track': 'length' must be above 0, found -1"),
    ("track.boxes", 1, ValueError, "'track': boxes must be at least 2, found 1"),
    ("gait.height", -1, ValueError, "'gait': 'height' must be above 0, found -1"),
    (
        "curriculum.raise_above",
        1.0,
        ValueError,
        "0 <= lower_below <= raise_above < 1 must hold, found lower_below 0.15, raise_above 1",
    ),
    ("sampling.sequence", ["pace"], ValueError, "a sequence of modes needs order: sequence; found order: random"),
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
