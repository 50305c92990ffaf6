"""What a robot file says, as a frozen, validated dataclass."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ogmp_sb3.config.strict import all_different, positive

STATE_NAMES = ("roll", "pitch", "yaw", "x", "y", "z", "wx", "wy", "wz", "vx", "vy", "vz")
INPUT_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True, kw_only=True)
class RobotConfig:
    """``robots/<name>/robot.yaml``."""

    name: str
    """name of the robot"""
    mjcf: str
    """MJCF file, relative to the YAML"""
    source: str
    """where the numbers come from"""
    base: str
    """the body with the free joint; its origin is p in the paper's reward"""
    joints: tuple[str, ...]
    """actuated joints, in the order of actions and observations; each has one actuator, a position servo"""
    feet: tuple[str, ...]
    """bodies that may touch the ground, with all that is below them"""
    nominal_height: float
    """base above flat ground in the nominal pose, m"""
    nominal_joints: tuple[float, ...]
    """joint positions of the nominal pose, rad; within the ranges of joints and servos"""
    leg_length: float
    """for the Froude number, m"""
    srb: SRB
    """single rigid body of the oracles"""
    path: Path = field(default=Path(), metadata={"internal": True})
    """the YAML file"""

    def __post_init__(self) -> None:
        if len(self.nominal_joints) != len(self.joints):
            raise ValueError(f"{len(self.joints)} joints but {len(self.nominal_joints)} nominal_joints.")
        for name in ("nominal_height", "leg_length"):
            positive(name, getattr(self, name))
        positive("srb.mass", self.srb.mass)
        for value in self.srb.inertia:
            positive("srb.inertia", value)
        if not self.feet:
            raise ValueError("'feet' names no body.")
        all_different("joints", self.joints)
        all_different("feet", self.feet)

    @property
    def mjcf_path(self) -> Path:
        """The MJCF file."""
        return self.path.parent / self.mjcf


@dataclass(frozen=True, kw_only=True)
class SRB:
    """Mass properties of the single rigid body."""

    mass: float
    """kg"""
    inertia: tuple[float, float, float]
    """about the centre of mass, body axes, kg m^2"""
