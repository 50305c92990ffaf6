"""Termination terms: pure functions of an :class:`~ogmp_sb3.env.view.EnvView`.

The permissible-state bound, the reward floor and the time limit are the environment's own.
"""

from __future__ import annotations

import numpy as np

from ogmp_sb3.config.registry import parameter_units, terminations
from ogmp_sb3.env.view import EnvView
from ogmp_sb3.guidance.terrain import NOTHING


@terminations.register()
@parameter_units(min_height="m of the base")
def fall(view: EnvView, min_height: float, fill_gaps: bool = True) -> np.ndarray:
    """True where the base is too low over the terrain under it.

    :param min_height: m
    :param fill_gaps: measure from the track's surface over a gap, not from its bottom
    :return: shape (num_envs,), bool
    """
    ground = np.maximum(view.ground_height, 0.0) if fill_gaps else view.ground_height
    fallen: np.ndarray = view.base_pos_w[:, 2] - ground < min_height
    return fallen


@terminations.register()
def off_track(view: EnvView) -> np.ndarray:
    """True where there is no ground under the base, shape (num_envs,), bool."""
    return view.ground_height <= NOTHING
