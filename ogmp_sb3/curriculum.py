"""The curriculum: from easy modes to those of the task, as fast as an environment's episodes last."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ogmp_sb3.ranges import ModeRanges
from ogmp_sb3.schema import not_negative, positive


@dataclass(frozen=True, kw_only=True)
class CurriculumConfig:
    """A schedule on Psi_M, driven by success: each environment has a level from 0 to 1 of its own.

    Level 0 samples the weights and ranges given here, level 1 those of the task, levels between them lie between.
    """

    modes: ModeRanges = field(default_factory=dict)
    """mode parameters at level 0, where they differ from the task's"""
    weights: dict[str, float] = field(default_factory=dict)
    """mode frequencies at level 0, where they differ from the task's"""
    step: float = 0.05
    """change of level after an episode"""
    raise_above: float = 0.8
    """an episode that lasts longer than this share of its time limit raises the level"""
    lower_below: float = 0.3
    """a shorter one lowers it"""

    def __post_init__(self) -> None:
        if not 0 <= self.lower_below <= self.raise_above < 1:
            found = f"lower_below {self.lower_below:g}, raise_above {self.raise_above:g}"
            raise ValueError(f"0 <= lower_below <= raise_above < 1 must hold, found {found}.")
        positive("step", self.step)
        not_negative("weights", self.weights)

    def moved(self, level: np.ndarray, lasted: np.ndarray) -> np.ndarray:
        """Levels after an episode each.

        :param level: before it, shape (n,), 0 to 1
        :param lasted: how long it lasted, as a share of its time limit, shape (n,)
        :return: shape (n,), 0 to 1
        """
        change = np.where(lasted > self.raise_above, self.step, np.where(lasted < self.lower_below, -self.step, 0.0))
        moved: np.ndarray = np.clip(level + change, 0.0, 1.0)
        return moved
