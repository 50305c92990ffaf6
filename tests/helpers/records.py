"""Records of episodes, made by hand."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ogmp_sb3.evaluation.record import EpisodeRecord

STEPS = 150
DIRECTIONS = ("front", "back", "left", "right")


def turn(direction: str, angle: np.ndarray, start: Rotation | None = None) -> np.ndarray:
    """Orientations of a base that turns about its pitch or roll axis; positive is the sense the mode asks for."""
    axis = {"front": (0, 1, 0), "back": (0, -1, 0), "right": (1, 0, 0), "left": (-1, 0, 0)}[direction]
    rotation = Rotation.from_rotvec(np.outer(angle, axis))
    return ((start or Rotation.identity()) * rotation).as_quat()[:, [3, 0, 1, 2]]


def ramp(total: float, steps: int = STEPS, rest: int = 60) -> np.ndarray:
    """An angle that grows to ``total`` and then rests."""
    return np.concatenate([np.linspace(0.0, total, steps + 1 - rest), np.full(rest, total)])


def record(direction: str = "front", total: float = 2 * np.pi, **fields: Any) -> EpisodeRecord:
    """A dive without fault."""
    zeros = np.zeros((STEPS + 1, 3))
    values: dict[str, Any] = {
        "base_pos_w": zeros,
        "base_quat": turn(direction, ramp(total)),
        "base_linvel_w": zeros,
        "base_linacc_w": zeros,
        "height": np.full(STEPS + 1, 0.5),
        "state_error": np.zeros(STEPS + 1),
        "reward": np.zeros(STEPS + 1),
        "reference_pos_w": zeros,
        "phase": np.arange(STEPS + 1),
        "deviation": np.zeros(STEPS + 1),
        "termination": "time_limit",
        "control_dt": 0.03,
        "max_steps": STEPS,
        "leg_length": 0.459,
        "nominal_height": 0.5,
        "track_length": None,
        "modes": ({"mode": "flip", "r": direction, "h": 1.0}, {"mode": "settle"}),
    }
    return EpisodeRecord(**{**values, **fields})
