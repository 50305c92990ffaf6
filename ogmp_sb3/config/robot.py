"""What a robot file says, as a frozen, validated dataclass."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ogmp_sb3.config.model_file import model_file
from ogmp_sb3.config.strict import all_different, not_negative, positive

STATE_NAMES = ("roll", "pitch", "yaw", "x", "y", "z", "wx", "wy", "wz", "vx", "vy", "vz")
INPUT_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True, kw_only=True)
class RobotConfig:
    """``robots/<name>/robot.yaml``."""

    name: str
    """name of the robot"""
    mjcf: str
    """MJCF or URDF file: a path from the YAML; or ``package:<package>/<path>``, in an installed package; or
    ``menagerie:<robot>[/<model>]``, of MuJoCo's Menagerie"""
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
    servos: ServoConfig | None = None
    """position servos of the joints, in place of what drives them in the MJCF; None: they have them there"""
    hold: dict[str, float] = field(default_factory=dict)
    """joints that are stiff, and where, rad: neither driven nor observed"""
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
        if self.servos is not None:
            self.servos.check(len(self.joints))
        for name in self.hold:
            if name in self.joints:
                raise ValueError(f"'{name}' is among 'joints' and in 'hold'.")
        if not self.feet:
            raise ValueError("'feet' names no body.")
        all_different("joints", self.joints)
        all_different("feet", self.feet)

    @property
    def mjcf_path(self) -> Path:
        """The MJCF file.

        :raises ValueError: if it is in a package or a collection that is not there
        """
        return model_file(self.mjcf, self.path.parent)


@dataclass(frozen=True, kw_only=True)
class ServoConfig:
    """Position servos, torque = kp (target - position) - kd velocity, in the order of the joints."""

    kp: tuple[float, ...]
    """N m/rad"""
    kd: tuple[float, ...]
    """N m s/rad"""
    torque: tuple[float, ...] | None = None
    """greatest torque, N m; None: as what drives the joints in the MJCF"""

    def check(self, joints: int) -> None:
        """:raises ValueError: if a list has not one number for each joint, or one that cannot be"""
        lists = {"kp": self.kp, "kd": self.kd} | ({} if self.torque is None else {"torque": self.torque})
        for name, values in lists.items():
            if len(values) != joints:
                raise ValueError(f"{joints} joints but {len(values)} numbers in servos.{name}.")
            for i, value in enumerate(values):
                if name == "kd":
                    not_negative("servos.kd", {str(i): value})
                else:
                    positive(f"servos.{name}.{i}", value)


@dataclass(frozen=True, kw_only=True)
class SRB:
    """Mass properties of the single rigid body."""

    mass: float
    """kg"""
    inertia: tuple[float, float, float]
    """about the centre of mass, body axes, kg m^2"""
