"""One episode as a table: what metrics are computed from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ogmp_sb3.guidance.reference_data import Query
from ogmp_sb3.guidance.sampling import ModeCall


@dataclass(frozen=True, kw_only=True)
class EpisodeRecord:
    """One episode, one row per control step; row 0 is the start. World frame.

    A step in which the simulation failed has no row.
    """

    base_pos_w: np.ndarray
    """shape (steps + 1, 3), m"""
    base_quat: np.ndarray
    """shape (steps + 1, 4)"""
    base_linvel_w: np.ndarray
    """shape (steps + 1, 3), m/s"""
    base_linacc_w: np.ndarray
    """shape (steps + 1, 3), m/s^2"""
    height: np.ndarray
    """base over the terrain under it, gaps filled, shape (steps + 1,), m"""
    state_error: np.ndarray
    """``||x - x_ref||`` over position and velocity, shape (steps + 1,)"""
    reward: np.ndarray
    """shape (steps + 1,); row 0 is 0"""
    reference_pos_w: np.ndarray
    """the oracle's knot of each step, shape (steps + 1, 3), m"""
    phase: np.ndarray
    """control steps from the oracle's query to this step, shape (steps + 1,), int; 1 begins a new reference"""
    deviation: np.ndarray
    """``||W (x - x_ref)||`` of the permissible-state bound, shape (steps + 1,)"""
    termination: str
    """which rule ended the episode"""
    control_dt: float
    """s"""
    max_steps: int
    """time limit, control steps"""
    leg_length: float
    """m"""
    nominal_height: float
    """of the base over the ground in the nominal pose, m"""
    track_length: float | None
    """m; flat ground follows. None: endless"""
    modes: tuple[dict[str, float | str], ...]
    """parameters of the modes in order, with the mode's name under ``mode``"""
    queries: tuple[Query, ...] = ()
    """what the oracle was asked for in order, if the latent is observed"""

    @property
    def steps(self) -> int:
        """Control steps survived."""
        return len(self.reward) - 1

    @property
    def calls(self) -> list[ModeCall]:
        """The modes in order, as functions with their parameters."""
        return [ModeCall(str(m["mode"]), {key: m[key] for key in m if key != "mode"}) for m in self.modes]
