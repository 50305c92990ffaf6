"""A task made for one robot, for another one: dynamically similar, as long legs walk slower steps of their length.

Lengths grow with the legs, times and speeds with the square root of that (at the same Froude number v^2 / (g L)), and
forces with the weight (Alexander and Jayes, *A dynamic similarity hypothesis for the gaits of quadrupedal mammals*,
1983).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.servos import read_servos
from ogmp_sb3.porting.port import PHYSICS_DT

GROWTH = {
    "m": (1.0, 0.0), "s": (0.5, 0.0), "m/s": (0.5, 0.0), "rad/s": (-0.5, 0.0), "kg": (0.0, 1.0), "N": (0.0, 1.0),
    "N m": (1.0, 1.0), "N m s": (1.5, 1.0), "1/m": (-1.0, 0.0), "1/(N m)": (-1.0, -1.0), "rad": (0.0, 0.0),
}  # fmt: skip
"""Powers of the ratios of leg lengths and of masses by which a quantity grows, by its unit."""
HEIGHT = "m of the base"  # unit of heights that grow as the robot stands, not as its legs are long
STATE_UNITS = {"x": "m", "y": "m", "z": "m", "wx": "rad/s", "wy": "rad/s", "wz": "rad/s"} | dict.fromkeys(
    ("vx", "vy", "vz"), "m/s"
)
INPUT_UNITS = dict.fromkeys(("fx", "fy", "fz"), "N") | dict.fromkeys(("mx", "my", "mz"), "N m")
INITIAL_UNITS = {"x": "m", "y": "m", "velocity": "m/s"}
REGISTRIES: Mapping[str, registry.Registry[Any]] = {
    "modes": registry.modes,
    "randomisation": registry.randomisations,
    "observations": registry.observations,
    "critic_observations": registry.observations,
    "rewards": registry.rewards,
    "terminations": registry.terminations,
}
NARROWEST = 0.4  # rad: an action reaches at least this share of what it reaches for servos that are soft
DIGITS = 3


@dataclass(frozen=True)
class Similar:
    """How much larger another robot is."""

    length: float
    """ratio of leg lengths"""
    mass: float
    """ratio of masses"""
    height: float
    """ratio of nominal heights: quadrupeds stand lower on their legs than bipeds"""

    @classmethod
    def of(cls, robot: RobotConfig, own: RobotConfig) -> Similar:
        """How much larger a robot is than another one."""
        return cls(
            robot.leg_length / own.leg_length, robot.srb.mass / own.srb.mass, robot.nominal_height / own.nominal_height
        )

    def factor(self, unit: str) -> float:
        """By how much a quantity of a unit is larger."""
        if unit == HEIGHT:
            return self.height
        length, mass = GROWTH[unit]
        return float(self.length**length * self.mass**mass)


def scaled(data: Mapping[str, Any], task: TaskConfig, robot: RobotConfig) -> dict[str, Any]:
    """What of a task's file must change for another robot: nested as the file, without what stays.

    :param data: the file, merged with those that it extends
    :param task: the task
    :param robot: the other robot
    """
    own = task.robot_config
    grow = Similar.of(robot, own)
    changes: dict[str, Any] = {}
    for part, of in REGISTRIES.items():
        changes[part] = _terms(data.get(part), of, grow)
    for name, more in _left_out(data["modes"], grow).items():
        changes["modes"][name] |= more
    curriculum, evaluation = data.get("curriculum") or {}, data.get("evaluation") or {}
    changes["curriculum"] = {
        part: _terms(curriculum.get(part), REGISTRIES[part], grow) for part in ("modes", "randomisation")
    }
    changes["evaluation"] = {
        "terminations": _terms(evaluation.get("terminations"), REGISTRIES["terminations"], grow),
        "initial": _scaled(evaluation.get("initial"), INITIAL_UNITS, grow),
    }
    changes["initial"] = _scaled(data.get("initial"), INITIAL_UNITS, grow)
    changes["track"] = {"width": rounded(max(grow.length, 1.0) * task.track.width)}
    changes["gait"] = {
        "height": rounded(task.gait.height * grow.height),
        "cycle": rounded(task.gait.cycle * grow.factor("s")),
    }
    if task.horizon is not None:
        changes["horizon"] = round(task.horizon * grow.factor("s"))
    changes["bound"] = {name: rounded(w / grow.factor(_unit(name))) for name, w in (data.get("bound") or {}).items()}
    changes["oracle_params"] = {
        name: _weights(parameters, grow) for name, parameters in (data.get("oracle_params") or {}).items()
    }
    reach = _reach(robot) / _reach(own)
    changes["action"] = {
        "scale": rounded(task.action.scale * float(np.clip(reach, NARROWEST, 1.0))),
        "noise": rounded(task.action.noise * min(reach, 1.0)),
    }
    in_use = {"track": asdict(task.track), "gait": asdict(task.gait), "action": asdict(task.action)}
    return _different(changes, {**data, **in_use})


def rounded(value: float) -> float:
    """A number with as many digits as a person would give it."""
    return float(f"{value:.{DIGITS}g}")


def _terms(terms: Mapping[str, Any] | None, of: registry.Registry[Any], grow: Similar) -> dict[str, Any]:
    """The parameters of terms that have a unit, scaled."""
    return {name: _scaled(given, of.units(name), grow) for name, given in (terms or {}).items() if given is not None}


def _left_out(modes: Mapping[str, Any], grow: Similar) -> dict[str, Any]:
    """The parameters that a file leaves out of its modes, whose defaults are of one robot too."""
    found: dict[str, Any] = {}
    for name, given in modes.items():
        defaults = {key: parameter.default for key, parameter in registry.modes.parameters(name).items()}
        others = {key: value for key, value in defaults.items() if isinstance(value, float) and key not in given}
        grown = _scaled(others, registry.modes.units(name), grow)
        found[name] = {key: value for key, value in grown.items() if value != others[key]}
    return found


def _scaled(values: Mapping[str, Any] | None, units: Mapping[str, str], grow: Similar) -> dict[str, Any]:
    """Numbers and ranges that have a unit, scaled."""
    return {
        key: _times(value, grow.factor(units[key]))
        for key, value in (values or {}).items()
        if key in units and value is not None
    }


def _times(value: Any, factor: float) -> Any:
    """A number or a range times a factor; a word is no size."""
    if isinstance(value, list | tuple):
        return [_times(each, factor) for each in value]
    return rounded(factor * value) if isinstance(value, int | float) else value


def _weights(parameters: Mapping[str, Any] | None, grow: Similar) -> dict[str, Any]:
    """Weights of a tracking oracle: errors and inputs that correspond cost the same."""
    found: dict[str, Any] = {}
    for key, units in (("Q", STATE_UNITS), ("R", INPUT_UNITS)):
        weights = (parameters or {}).get(key)
        if isinstance(weights, Mapping):
            nested = all(isinstance(each, Mapping) for each in weights.values())
            found[key] = (
                {phase: _squares(each, units, grow) for phase, each in weights.items()}
                if nested
                else _squares(weights, units, grow)
            )
    return found


def _squares(weights: Mapping[str, float], units: Mapping[str, str], grow: Similar) -> dict[str, float]:
    return {name: rounded(weight / grow.factor(units[name]) ** 2) for name, weight in weights.items() if name in units}


def _unit(state: str) -> str:
    """The unit of a state; an angle grows like nothing, so like a length over a length."""
    return STATE_UNITS.get(state, "rad")


def _reach(robot: RobotConfig) -> float:
    """The error at which a robot's servos give all of their torque, in the middle, rad; 1 if nothing limits them."""
    servos = read_servos(build_model(robot, PHYSICS_DT, 1), robot)
    reach = float(np.median(servos.torque_high / servos.kp))
    return reach if np.isfinite(reach) else 1.0


def _different(changes: Mapping[str, Any], data: Mapping[str, Any]) -> dict[str, Any]:
    """What of nested mappings is not in a file as it is."""
    found: dict[str, Any] = {}
    for key, value in changes.items():
        before = data.get(key) if isinstance(data, Mapping) else None
        if isinstance(value, Mapping):
            inner = _different(value, before if isinstance(before, Mapping) else {})
            if inner:
                found[key] = inner
        elif value != before:
            found[key] = value
    return found
