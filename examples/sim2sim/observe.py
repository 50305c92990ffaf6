"""Observations of an exported policy, component by component, from nothing but the state of a robot and its track."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from preview import Preview, commanded_speed, latent_features

HIGHEST, DEEPEST = 2.0, 1.0  # m: how high a base, and how deep or high other ground, a policy ever sees
NOTHING = -50.0  # m: height where there is no ground
LATENTS = {"mode_latent": False, "mirrored_mode_latent": True}  # by component, whether of the mirror image


@dataclass(frozen=True)
class State:
    """What a simulator says of a robot."""

    pos: np.ndarray
    """of the base's origin, world, m"""
    quat: np.ndarray
    """of the base, w x y z"""
    linvel: np.ndarray
    """of the base's origin, world, m/s"""
    angvel: np.ndarray
    """of the base, world, rad/s"""
    joint_pos: np.ndarray
    """rad, in the controller's order"""
    joint_vel: np.ndarray
    """rad/s"""

    @property
    def rotation(self) -> np.ndarray:
        """Body to world, shape (3, 3)."""
        w, x, y, z = self.quat
        v = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + 2.0 * w * v + 2.0 * v @ v

    @property
    def srb(self) -> np.ndarray:
        """State of the oracle: angles (not fed back, so 0), position, angular and linear velocity, shape (12,)."""
        return np.concatenate([np.zeros(3), self.pos, self.angvel, self.linvel])


def ground_height(boxes: np.ndarray, x: np.ndarray, y: float) -> np.ndarray:
    """Height of the track's surface at places, m.

    :param boxes: x0 x1 y0 y1 top, shape (n, 5)
    """
    x = np.atleast_1d(x)[:, None]
    on = (boxes[:, 0] <= x) & (x < boxes[:, 1]) & (boxes[:, 2] <= y) & (y < boxes[:, 3])
    heights: np.ndarray = np.where(on, boxes[:, 4], NOTHING).max(axis=1)
    return heights


class Observer:
    """Makes the observations of an exported policy on one track after another.

    :param folder: what ogmp-export wrote
    :param info: its controller.json
    :raises ValueError: for a component that this example does not know, or an oracle that it does not
    """

    def __init__(self, folder: Path, info: dict[str, Any]) -> None:
        self._terms, self._components = info["observation"]["terms"], info["observation"]["components"]
        self._horizon = info["horizon"]
        known = {**COMPONENTS, **dict.fromkeys(LATENTS)}
        for name in (component["name"] for component in self._components):
            if name not in known:
                close = "".join(f" Did you mean '{each}'?" for each in get_close_matches(name, known, 1))
                raise ValueError(f"the policy observes '{name}', which this example does not know (observe.py).{close}")
        names = [component["name"] for component in self._components]
        if self._horizon is None and any(name in (*LATENTS, "clock_sin", "clock_cos") for name in names):
            raise ValueError(f"the task '{info['task']}' has no horizon: this example knows modes along a track alone.")
        self._latents = [name for name in names if name in LATENTS]
        self._oracle = Preview(info) if self._latents else None
        self._encoder = onnxruntime.InferenceSession(str(folder / "encoder.onnx")) if self._latents else None
        self.begin({"boxes": [[-1e3, 1e3, -1e3, 1e3, 0.0]], "spans": [[1e9] + [0.0] * 10]})

    def begin(self, track: dict[str, Any]) -> None:
        """Go on with another track, at the start of an episode."""
        self.boxes, self.spans = np.array(track["boxes"]), np.array(track["spans"])
        self.phase, self.latent = 0, {}

    def observe(self, state: State, last_action: np.ndarray) -> np.ndarray:
        """The observation of a control step; once each, in order. Every ``horizon`` steps the oracle is asked.

        :param last_action: of the controller
        """
        self.last_action = last_action
        if self._horizon is not None and self.phase == self._horizon:
            self.phase = 0
        if self.phase == 0 and self._oracle is not None and self._encoder is not None:
            reference = self._oracle.reference(self.spans, state.srb)
            for name in self._latents:
                features = latent_features(reference, LATENTS[name])
                self.latent[name] = self._encoder.run(["latent"], {"features": features})[0][0]
        values = [self._component(component["name"], state) for component in self._components]
        self.phase += 1
        return np.concatenate([np.atleast_1d(value) for value in values])

    def _component(self, name: str, state: State) -> np.ndarray | float:
        return self.latent[name] if name in LATENTS else COMPONENTS[name](self, state)

    @property
    def angle(self) -> float:
        """Phase of the clock, rad."""
        return 2.0 * np.pi * self.phase / self._horizon

    def base_height(self, state: State) -> float:
        """The base's origin over the ground below it, m."""
        return min(state.pos[2] - ground_height(self.boxes, state.pos[0], state.pos[1])[0], HIGHEST)

    def scan(self, state: State) -> np.ndarray:
        """Ground ahead, relative to that below the base, m."""
        term = self._terms["height_scan"]
        x = state.pos[0] + term["spacing"] * np.arange(term["points"])
        heights = ground_height(self.boxes, x, state.pos[1])
        return np.clip(heights - heights[0], -DEEPEST, DEEPEST)


COMPONENTS: dict[str, Callable[[Observer, State], np.ndarray | float]] = {
    "base_height": Observer.base_height,
    "base_quat": lambda _, state: state.quat,
    "joint_pos": lambda _, state: state.joint_pos,
    "base_linvel_b": lambda _, state: state.rotation.T @ state.linvel,
    "base_angvel_b": lambda _, state: state.rotation.T @ state.angvel,
    "joint_vel": lambda _, state: state.joint_vel,
    "heading": lambda _, state: float(np.arctan2(state.rotation[1, 0], state.rotation[0, 0])),
    "gravity_b": lambda _, state: -state.rotation[2],
    "last_action": lambda observer, _: observer.last_action,
    "clock_sin": lambda observer, _: float(np.sin(observer.angle)),
    "clock_cos": lambda observer, _: float(np.cos(observer.angle)),
    "commanded_speed": lambda observer, state: commanded_speed(observer.spans, state.pos[0]),
    "height_scan": Observer.scan,
}
