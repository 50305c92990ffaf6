"""The single rigid body under a quadratic tracker, simulated by compiled loops for the oracles."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.machine import compiled


@compiled
def simulate_lqr(A, B, d, K, hover, index, stance, r, x0):  # type: ignore[no-untyped-def]
    """States under ``u_k = hover - K (x_k - r_k)`` in stance and no input in flight, shape (rows, knots + 1, 12).

    :param A: of each orientation, shape (orientations, 12, 12)
    :param B: of each orientation, shape (orientations, 12, 6)
    :param d: gravity, shape (12,)
    :param K: gain of each orientation, shape (orientations, 6, 12)
    :param hover: the input that carries the weight, shape (6,)
    :param index: which orientation each step is in, shape (rows, knots)
    :param stance: whether the feet are on the ground during each step, shape (rows, knots)
    :param r: set-points, shape (rows, knots + 1, 12)
    :param x0: state at the query, shape (rows, 12)
    """
    rows, knots = stance.shape
    state = np.empty((rows, knots + 1, 12))
    for row in range(rows):
        state[row, 0] = x0[row]
        for k in range(knots):
            i = index[row, k]
            x = state[row, k]
            following = A[i] @ x + d
            if stance[row, k]:
                following += B[i] @ (hover - K[i] @ (x - r[row, k]))
            state[row, k + 1] = following
    return state


@compiled
def simulate_preview(A, B, d, Q, R, P_end, index, stance, r, steps, x0):  # type: ignore[no-untyped-def]
    """States under the preview control of :func:`~ogmp_sb3.guidance.oracles.preview`, shape (rows, knots + 1, 12).

    :param Q: diagonals of the state weights in flight and in stance, shape (2, 12)
    :param R: diagonal of the weights of the total input, shape (6,)
    :param P_end: cost of the state behind a last step in flight and in stance, shape (2, 12, 12)
    :param steps: how many steps of each row are meant, shape (rows,); others are as in :func:`simulate_lqr`
    """
    rows, knots = stance.shape
    state = np.empty((rows, knots + 1, 12))
    K = np.empty((knots, 6, 12))
    feed_forward = np.empty((knots, 6))
    for row in range(rows):
        last = steps[row]
        P = P_end[int(stance[row, last - 1])].copy()
        v = P @ r[row, last]
        for k in range(last - 1, -1, -1):
            i = index[row, k]
            w = v - P @ d
            closed_loop = A[i].copy()
            if stance[row, k]:
                BtP = B[i].T @ P
                S = BtP @ B[i]
                for j in range(6):
                    S[j, j] += R[j]
                right = np.empty((6, 13))
                right[:, :12] = BtP @ A[i]
                right[:, 12] = B[i].T @ w
                solved = np.linalg.solve(S, right)
                K[k] = solved[:, :12]
                feed_forward[k] = solved[:, 12]
                closed_loop -= B[i] @ K[k]
            v = closed_loop.T @ w
            P = A[i].T @ P @ closed_loop
            weight = Q[int(stance[row, k])]
            for j in range(12):
                v[j] += weight[j] * r[row, k, j]
                P[j, j] += weight[j]
            P = 0.5 * (P + P.T)
        state[row, 0] = x0[row]
        for k in range(last):
            i = index[row, k]
            following = A[i] @ state[row, k] + d
            if stance[row, k]:
                following += B[i] @ (feed_forward[k] - K[k] @ state[row, k])
            state[row, k + 1] = following
        for k in range(last, knots):
            state[row, k + 1] = state[row, last]
    return state


@compiled
def simulate_preview_upright(b, d, dt, Q, R, P_end, stance, r, steps, x0):  # type: ignore[no-untyped-def]
    """:func:`simulate_preview` for an upright body, whose six axes are double integrators of their own.

    An axis has the state ``x`` = (position, velocity) and one input: ``x_{k+1} = A x_k + b u_k + d`` with
    ``A = [[1, dt], [0, 1]]`` and ``u_k = f_k - K_k x_k``, where ``f`` and ``K`` are those of :func:`_upright_gains`.

    :param b: effect of a unit of input on position and velocity of each axis, shape (6, 2)
    :param d: gravity, shape (12,)
    """
    rows, knots = stance.shape
    state = np.empty((rows, knots + 1, 12))
    gains = np.empty((knots, 3))
    for row in range(rows):
        last = steps[row]
        state[row, 0] = x0[row]
        for axis in range(6):
            p, v = axis, axis + 6
            bp, bv = b[axis]
            _upright_gains(p, v, bp, bv, d, dt, Q, R[(axis + 3) % 6], P_end, stance[row], r[row], last, gains)
            for k in range(last):
                xp, xv = state[row, k, p], state[row, k, v]
                u = gains[k, 2] - gains[k, 0] * xp - gains[k, 1] * xv
                state[row, k + 1, p] = xp + dt * xv + bp * u + d[p]
                state[row, k + 1, v] = xv + bv * u + d[v]
        for k in range(last, knots):
            state[row, k + 1] = state[row, last]
    return state


@compiled
def _upright_gains(p, v, bp, bv, d, dt, Q, R, P_end, stance, r, last, gains):  # type: ignore[no-untyped-def]
    """The Riccati recursion of :func:`~ogmp_sb3.guidance.oracles.preview` for one axis.

    Backward from ``P = P_end`` and ``v = P r_last``; ``P_end`` and ``Q`` are those of the phase of the step. In each
    step ``w = v - P d`` and ``S = R + b^T P b``, a number; ``K = b^T P A / S`` and ``f = b^T w / S``, both 0 in flight;
    then ``v = Q r + (A - b K)^T w`` and ``P = Q + A^T P (A - b K)``.

    :param p: place of the axis's position in the state
    :param v: place of its velocity
    :param gains: to write to, columns ``K`` (2) and ``f``, shape (knots, 3)
    """
    end = P_end[int(stance[last - 1])]
    P11, P12, P22 = end[p, p], end[p, v], end[v, v]
    v1 = P11 * r[last, p] + P12 * r[last, v]
    v2 = P12 * r[last, p] + P22 * r[last, v]
    for k in range(last - 1, -1, -1):
        w1, w2 = v1 - P11 * d[p] - P12 * d[v], v2 - P12 * d[p] - P22 * d[v]
        K1, K2, f = 0.0, 0.0, 0.0
        if stance[k]:
            bP1, bP2 = bp * P11 + bv * P12, bp * P12 + bv * P22
            S = R + bP1 * bp + bP2 * bv
            K1, K2, f = bP1 / S, (bP1 * dt + bP2) / S, (bp * w1 + bv * w2) / S
        gains[k, 0], gains[k, 1], gains[k, 2] = K1, K2, f
        c11, c12 = 1.0 - bp * K1, dt - bp * K2  # A - b K
        c21, c22 = 0.0 - bv * K1, 1.0 - bv * K2
        qp, qv = Q[int(stance[k]), p], Q[int(stance[k]), v]
        v1 = qp * r[k, p] + c11 * w1 + c21 * w2
        v2 = qv * r[k, v] + c12 * w1 + c22 * w2
        P11, P12, P22 = (
            qp + P11 * c11 + P12 * c21,
            P11 * c12 + P12 * c22,
            qv + (P11 * dt + P12) * c12 + (P12 * dt + P22) * c22,
        )
