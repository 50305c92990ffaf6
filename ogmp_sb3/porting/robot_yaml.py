"""``robot.yaml`` as a person would write it: lists in lines of a width, a comment beside each number."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterable

from ogmp_sb3.config.yaml_files import read_value
from ogmp_sb3.porting.port import Port

WIDTH = 120
PLAIN = re.compile(r"[\w./~][\w ./:~+-]*")  # what may stand without quotes in a list too


def robot_yaml(port: Port) -> str:
    """The text of a robot's file."""
    robot, legs = port.robot, len(port.anatomy.legs)
    inertia = ", ".join(f"{value:.6g}" for value in robot.srb.inertia)
    lines = [
        f"name: {quoted(robot.name)}",
        f"mjcf: {quoted(robot.mjcf)}",
        *textwrap.wrap(f"source: {quoted(robot.source)}", WIDTH, subsequent_indent="  ", break_long_words=False),
        f"base: {quoted(robot.base)}",
        f"joints: # order of actions and joint observations: {legs} legs, from the base down",
        *(f"  - {quoted(joint)}" for joint in robot.joints),
        f"feet: [{', '.join(map(quoted, robot.feet))}]    # may touch the ground, with all below them",
        f"nominal_height: {robot.nominal_height:g}    # m, base above flat ground at the nominal pose",
        *_list("nominal_joints", robot.nominal_joints, f"rad: {port.posture.source}"),
        f"leg_length: {robot.leg_length:g}    # m, from hip to sole, straight; for the Froude number",
    ]
    if robot.servos is not None:
        lines += [f"servos:    # {port.servos}; null: the model's own"]
        lines += [f"  {line}" for line in _list("kp", robot.servos.kp, "N m/rad")]
        lines += [f"  {line}" for line in _list("kd", robot.servos.kd, "N m s/rad")]
        if robot.servos.torque is not None:
            lines += [f"  {line}" for line in _list("torque", robot.servos.torque, "N m")]
    if robot.hold:
        lines += ["hold:    # joints of no leg: stiff, where they are in the nominal pose, rad"]
        lines += [f"  {quoted(joint)}: {value:g}" for joint, value in robot.hold.items()]
    lines += [
        "srb:    # single rigid body: the whole robot at the nominal pose",
        f"  mass: {robot.srb.mass:g}    # kg",
        f"  inertia: [{inertia}]    # kg m^2, ixx iyy izz about its centre of mass, in the base's axes",
    ]
    return "\n".join([*lines, ""])


def quoted(text: str) -> str:
    """Text as YAML reads it: in quotes where it would be read as something else, as ``no`` and ``1`` would.

    :raises ValueError: for what OmegaConf would fill in
    """
    if "${" in text:
        raise ValueError(f"'{text}' cannot be written into a YAML file of ours, where '${{' has a meaning: rename it.")
    return text if PLAIN.fullmatch(text) and _is_itself(text) else json.dumps(text, ensure_ascii=False)


def _is_itself(text: str) -> bool:
    """Whether our YAML files have this text where it stands without quotes."""
    try:
        return bool(read_value(text) == text)
    except ValueError:
        return False


def _list(key: str, values: Iterable[float], comment: str) -> list[str]:
    """A list of numbers, on as many lines as it needs."""
    numbers = ", ".join(f"{value:g}" for value in values)
    lines = textwrap.wrap(f"{key}: [{numbers}]", WIDTH - 8, subsequent_indent="  ")
    return [
        f"{lines[0]}    # {comment}" if len(lines) == 1 else f"{key}:    # {comment}",
        *(
            []
            if len(lines) == 1
            else textwrap.wrap(f"[{numbers}]", WIDTH - 8, initial_indent="  ", subsequent_indent="   ")
        ),
    ]
