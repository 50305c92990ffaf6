"""Gains of the linear-quadratic trackers, from python-control. The only module that imports ``control``."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.guidance.srb import SRBDynamics


def tracking_gains(dynamics: SRBDynamics, Q: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve the infinite-horizon problem ``sum x_k^T Q x_k + u_k^T R u_k`` with ``control.dlqr``.

    :param dynamics: the linear model
    :param Q: state weights, shape (12, 12), positive definite (python-control rejects weights of zero here)
    :param R: input weights, shape (12, 12), positive definite
    :return: the state feedback K of ``u_k = -K x_k``, rows are inputs, and the solution P of the Riccati equation,
        each of shape (12, 12)
    :raises ValueError: if the Riccati equation has no stabilising solution
    """
    import control  # heavy: it pulls in matplotlib, about 2.5 s

    try:
        K, P, _ = control.dlqr(dynamics.A, dynamics.B, Q, R, method="scipy")
    except Exception as error:  # control and scipy raise many kinds; all mean the same to the user
        raise ValueError(f"no stabilising LQR gain for these oracle weights ({error}).") from error
    return np.asarray(K), np.asarray(P)
