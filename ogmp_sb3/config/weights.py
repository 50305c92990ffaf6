"""Annotations of parameters whose values are checked when a file is read: weights by name, and numbers above 0.

The functions get plain values; :func:`ogmp_sb3.config.strict.read` runs the checks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, TypedDict

from ogmp_sb3.config.messages import Where, did_you_mean
from ogmp_sb3.config.robot import INPUT_NAMES, STATE_NAMES


@dataclass(frozen=True)
class Named:
    """Checks weights by name."""

    names: tuple[str, ...]
    """those that are allowed"""
    what: str = field(repr=False)  # the documentation would look for links in it
    """what has these names, for messages"""
    definite: bool = False
    """whether every name needs a weight above 0; else a weight is at least 0, and that of a name left out is 0"""

    def __call__(self, weights: Mapping[str, float], where: Where) -> None:
        """Check weights.

        :raises KeyError: if a name is unknown or missing
        :raises ValueError: if a weight is too small
        """
        for name in weights:
            if name not in self.names:
                raise KeyError(f"{where} has {name!r}{did_you_mean(name, self.names)}")
        for name in self.names:
            if self.definite and name not in weights:
                raise KeyError(f"{where / name} is missing: every {self.what} needs a weight.")
            if self.definite:
                above_zero(weights[name], where / name)
            elif weights.get(name, 0.0) < 0:
                raise ValueError(f"{where / name} must be at least 0, found {weights[name]:g}.")


def above_zero(value: float, where: Where) -> None:
    """Check a number.

    :raises ValueError: if it is not above 0
    """
    if not value > 0:
        raise ValueError(f"{where} must be above 0, found {value:g}.")


StateWeights = Annotated[dict[str, float], Named(STATE_NAMES, "state")]
"""Weights of states, at least 0; those that are not named have the weight 0."""


class PhaseWeights(TypedDict):
    """Weights of states for each phase of contact."""

    stance: StateWeights
    """while the feet are on the ground"""
    flight: StateWeights
    """while they are not"""


TrackingWeights = StateWeights | PhaseWeights
"""Weights of states, the same in both phases of contact or for each of them."""
InputWeights = Annotated[dict[str, float], Named(INPUT_NAMES, "input", definite=True)]
"""Weights of all inputs, above 0."""
Positive = Annotated[float, above_zero]
"""A number above 0."""
