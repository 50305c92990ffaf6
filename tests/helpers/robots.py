"""Robots that differ from the example's by a few words of their files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from helpers.paths import ROOT
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.robot import RobotConfig

PUP = load_robot(str(ROOT / "examples" / "ogmp_pup" / "ogmp_pup" / "robots" / "pup" / "robot.yaml"))

GEOMS = '<geom contype="0" conaffinity="1" friction="1.0"/>'
FEET = '<geom type="sphere" size="0.02" mass="0.05" material="sole"/>'
SERVOS = '<position kp="40" kv="0.8" forcerange="-15 15"/>'
JOINTS = '<joint armature="0.004" damping="0.05"/>'
COMPILER = '<compiler angle="radian" autolimits="true"/>'
OPTION = 'cone="pyramidal"/>'
KNEE = '<position name="FL_knee" joint="FL_knee"/>'
TRUNK_SENSOR = '<contact name="trunk_contact" body1="trunk" body2="world" num="1" data="found"/>'
"""Elements of its MJCF, to be replaced."""


def variant(folder: Path, *changes: tuple[str, str], once: bool = False, **fields: Any) -> RobotConfig:
    """The example's robot with changes.

    :param folder: where its MJCF is written
    :param changes: of the MJCF: what stands there, and what shall
    :param once: change the first place alone
    :param fields: of robot.yaml
    """
    mjcf = PUP.mjcf_path.read_text(encoding="utf-8")
    for found, written in changes:
        assert found in mjcf, found
        mjcf = mjcf.replace(found, written, 1 if once else -1)
    (folder / "pup.xml").write_text(mjcf, encoding="utf-8")
    return replace(PUP, mjcf=str(folder / "pup.xml"), **fields)


def with_attributes(element: str, attributes: str) -> str:
    """An empty element with further attributes, which come first: ``<geom gap="1" size="2"/>``."""
    name, _, rest = element.partition(" ")
    return f"{name} {attributes} {rest}"
