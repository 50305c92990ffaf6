"""Gains of the linear-quadratic trackers, from python-control. The only module that imports ``control``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ogmp_sb3.srb import SRBDynamics


@dataclass(frozen=True)
class TrackingGains:
    """What tracks a reference r on ``x_{k+1} = A x_k + B u_k + d`` with the least quadratic cost.

    The cost is ``sum (x_k - r_k)^T Q (x_k - r_k) + u_k^T R u_k``; the optimal input is
    ``u_k = -K x_k + M (v_{k+1} - P d)`` with ``v_k = Q r_k + (A - B K)^T (v_{k+1} - P d)`` and ``v_N = P r_N``
    (Anderson and Moore, *Optimal Control: Linear Quadratic Methods*, ch. 4; Katayama et al., Int. J. Control 41,
    1985, for the preview form).
    """

    K: np.ndarray
    """state feedback, shape (12, 12): rows are inputs"""
    P: np.ndarray
    """solution of the Riccati equation, shape (12, 12)"""
    M: np.ndarray
    """feed-forward, ``(R + B^T P B)^-1 B^T``, shape (12, 12)"""
    closed_loop: np.ndarray
    """``A - B K``, shape (12, 12)"""


def tracking_gains(dynamics: SRBDynamics, Q: np.ndarray, R: np.ndarray) -> TrackingGains:
    """Solve the infinite-horizon problem with ``control.dlqr``.

    :param dynamics: the linear model
    :param Q: state weights, shape (12, 12), positive definite (python-control rejects weights of zero here)
    :param R: input weights, shape (12, 12), positive definite
    :raises ValueError: if the Riccati equation has no stabilising solution
    """
    import control  # heavy: it pulls in matplotlib, about 2.5 s

    try:
        K, P, _ = control.dlqr(dynamics.A, dynamics.B, Q, R, method="scipy")
    except Exception as error:  # control and scipy raise many kinds; all mean the same to the user
        raise ValueError(f"no stabilising LQR gain for these oracle weights ({error}).") from error
    M = np.linalg.solve(R + dynamics.B.T @ P @ dynamics.B, dynamics.B.T)
    return TrackingGains(np.asarray(K), np.asarray(P), M, dynamics.A - dynamics.B @ K)
