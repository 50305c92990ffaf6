"""An oracle of our own."""

import numpy as np

from ogmp_sb3.extend import POS, VEL, Plant, Positive, Reference, SetPoints, oracle


@oracle
def fade(set_points: SetPoints, x0: np.ndarray, plant: Plant, time_constant: Positive) -> Reference:
    """Follow the set-points; the offset from them at the query fades exponentially.

    :param set_points: what the modes ask for
    :param x0: state at the query, shape (rows, 12)
    :param plant: only its time step is used
    :param time_constant: after which e^-1 of the offset is left, s
    """
    state = set_points.state.copy()  # (rows, knots + 1, 12)
    left = np.exp(-np.arange(state.shape[1])[:, None] * plant.dt / time_constant)
    state[..., POS] += left * (x0[:, None, POS] - state[:, :1, POS])
    state[:, 1:, VEL] = np.diff(state[..., POS], axis=1) / plant.dt
    state[:, 0] = x0
    return Reference(state, set_points.steps)
