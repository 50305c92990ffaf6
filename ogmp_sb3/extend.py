"""All that the author of a plug-in imports: decorators that register functions, and what those are given and return.

A mode, an oracle and a reward of one's own::

    import numpy as np
    from ogmp_sb3.extend import POS, EnvView, Plant, Plateau, Reference, Segment, SetPoints, Span, mode, oracle, reward

    @mode
    def stroll(v: float, length: float = 0.6) -> Segment:
        ground = Plateau(start=0.0, end=length, top=0.0)
        return Segment(length=length, plateaus=(ground,), spans=(Span(end=length, velocity=(v, 0.0)),))

    @oracle
    def shift(set_points: SetPoints, x0: np.ndarray, plant: Plant, share: float = 0.5) -> Reference:
        state = set_points.state.copy()  # (rows, knots + 1, 12)
        state[..., POS] += share * (x0[:, None, POS] - state[:, :1, POS])
        state[:, 0] = x0
        return Reference(state, set_points.steps)

    @reward("upright")
    def reward_of_height(view: EnvView, weight: float) -> np.ndarray:
        return weight * (view.base_pos_w[:, 2] - view.ground_height > 0.4)  # (num_envs,)

``@mode`` registers a function under its own name, ``@mode("name")`` under another; the same goes for the other kinds.
Parameters beyond what the library passes are the keys that a task file gives, and need annotations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, overload

from ogmp_sb3.config import registry
from ogmp_sb3.config.registry import (
    NameTaken,
    Registry,
    looks_ahead,
    not_a_size,
    parameter_limits,
    parameter_units,
)
from ogmp_sb3.config.robot import SRB, STATE_NAMES
from ogmp_sb3.config.weights import InputWeights, PhaseWeights, Positive, StateWeights, TrackingWeights
from ogmp_sb3.env.episode_disturbance import Disturbance, Subject
from ogmp_sb3.env.observations import Part, Signal
from ogmp_sb3.env.view import EnvView
from ogmp_sb3.evaluation.metrics import limited, reaches
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.guidance.modes import Contact, Segment, Span
from ogmp_sb3.guidance.oracles import Plant
from ogmp_sb3.guidance.plans import make_oracle
from ogmp_sb3.guidance.rotations import (
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    quat_to_rpy,
    rpy_to_matrix,
    rpy_to_quat,
    wrap_angle,
)
from ogmp_sb3.guidance.set_points import Reference, SetPoints
from ogmp_sb3.guidance.srb import GRAVITY, OMEGA, POS, RPY, STATE_SIZE, VEL
from ogmp_sb3.guidance.terrain import NOTHING, Plateau, height_at

__all__ = [
    "GRAVITY",
    "NOTHING",
    "OMEGA",
    "POS",
    "RPY",
    "SRB",
    "STATE_NAMES",
    "STATE_SIZE",
    "VEL",
    "Contact",
    "Decorator",
    "Disturbance",
    "EnvView",
    "EpisodeRecord",
    "InputWeights",
    "NameTaken",
    "Part",
    "PhaseWeights",
    "Plant",
    "Plateau",
    "Positive",
    "Reference",
    "Segment",
    "SetPoints",
    "Signal",
    "Span",
    "StateWeights",
    "Subject",
    "TrackingWeights",
    "height_at",
    "limited",
    "looks_ahead",
    "make_oracle",
    "metric",
    "mode",
    "not_a_size",
    "objective",
    "observation",
    "oracle",
    "parameter_limits",
    "parameter_units",
    "quat_conjugate",
    "quat_multiply",
    "quat_rotate",
    "quat_rotate_inverse",
    "quat_to_rpy",
    "randomisation",
    "reaches",
    "reward",
    "rpy_to_matrix",
    "rpy_to_quat",
    "termination",
    "wrap_angle",
]

F = TypeVar("F", bound=Callable[..., Any])


class Decorator:
    """Registers functions of one kind, and gives them back as they are: ``@reward`` or ``@reward("name")``."""

    def __init__(self, functions: Registry[Any]) -> None:
        self._functions = functions

    def __repr__(self) -> str:
        return f"<decorator that registers a {self._functions.kind}>"

    @overload
    def __call__(self, function: F, /) -> F: ...

    @overload
    def __call__(self, name: str | None = None, /) -> Callable[[F], F]: ...

    def __call__(self, function: F | str | None = None, /) -> F | Callable[[F], F]:
        """Register a function.

        :param function: what is decorated; or the name it gets, by default its own
        :raises NameTaken: if the name is taken
        :raises TypeError: if a parameter of the task file has no annotation, by which its value is read
        """
        if function is None or isinstance(function, str):
            return self._functions.register(function)
        return self._functions.register()(function)


mode = Decorator(registry.modes)
"""Of a mode: ``(parameters) -> Segment``, numbers and words from the task file to terrain and set-points."""
oracle = Decorator(registry.oracles)
"""Of an oracle: ``(set_points, x0, plant, parameters) -> Reference``."""
observation = Decorator(registry.observations)
"""Of an observation: ``(view, parameters) -> Signal``."""
randomisation = Decorator(registry.randomisations)
"""Of a randomisation: ``(subject, parameters) -> Disturbance``, numbers drawn for an episode to what disturbs it."""
reward = Decorator(registry.rewards)
"""Of a reward: ``(view, parameters) -> array`` of shape (num_envs,)."""
termination = Decorator(registry.terminations)
"""Of a rule that ends an episode: ``(view, parameters) -> array`` of shape (num_envs,), bool."""
metric = Decorator(registry.metrics)
"""Of a metric: ``(record) -> float``, or bool for yes and no."""
objective = Decorator(registry.objectives)
"""Of a true objective: ``(record) -> float``, or bool for yes and no."""
