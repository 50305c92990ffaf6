"""A task file that extends another one for another robot, as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ogmp_sb3.porting.robot_yaml import WIDTH, quoted
from ogmp_sb3.porting.scale import Similar

WHY = {
    "modes": "lengths x {m:.2f}, speeds x {m/s:.2f}",
    "gait": "m, s",
    "horizon": "control steps, {s:.2f} times as many",
    "bound": "so that rho means the same share of a leg",
    "oracle_params": "errors and inputs that correspond cost the same",
    "action": "rad; noise by the error at which the servos give all of their torque",
    "track": "m",
}


def task_yaml(base: str, robot: str, encoder: str | None, changes: Mapping[str, Any], grow: Similar) -> str:
    """The text of a task.

    :param base: the task that it extends
    :param robot: the robot, by name or path
    :param encoder: of the latent; None: the task has none
    :param changes: of :func:`~ogmp_sb3.porting.scale.scaled`
    :param grow: how much larger the robot is
    """
    lines = [
        f"# {base} for {robot}, scaled by the rules of ogmp-task: legs are {grow.length:.2f} times as long, the robot "
        f"{grow.mass:.2f} times",
        "# as heavy. What is not here is as there. Look at it with ogmp-check, and change what your robot does better.",
        f"extends: {quoted(base)}",
        f"robot: {quoted(robot)}",
        *([] if encoder is None else [f"encoder: {quoted(encoder)}"]),
    ]
    units = {unit: grow.factor(unit) for unit in ("m", "s", "m/s")}
    for key, value in changes.items():
        comment = f"    # {WHY[key].format_map(units)}" if key in WHY else ""
        if isinstance(value, Mapping):
            lines += ["", f"{key}:{comment}", *_block(value, "  ")]
        else:
            lines += ["", f"{key}: {_flow(value)}{comment}"]
    return "\n".join([*lines, ""])


def _block(values: Mapping[str, Any], indent: str) -> list[str]:
    """Entries of a mapping, each on one line if it fits."""
    lines: list[str] = []
    for key, value in values.items():
        line = f"{indent}{key}: {_flow(value)}"
        if isinstance(value, Mapping) and (len(line) > WIDTH or any(isinstance(v, Mapping) for v in value.values())):
            lines += [f"{indent}{key}:", *_block(value, indent + "  ")]
        else:
            lines.append(line)
    return lines


def _flow(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_flow(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_flow(each) for each in value) + "]"
    return yaml_number(value) if isinstance(value, float) else str(value)


def yaml_number(value: float) -> str:
    """A number that YAML reads as one: 1.77e-05 as it is, 2e-05 as 2.0e-05."""
    text = f"{value:g}"
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
