"""The linear least-squares step inside bounds: the core of every Gauss-Newton method and the test of a minimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

TINY_DAMPING = 1e-12
"""Relative damping of an undamped step: keeps exactly dependent columns from giving a wild one."""


@dataclass(frozen=True)
class Reduced:
    """Triangular form with the same |J d + r|^2 for all d: `R` (m, n_p), `c` (m,), m <= n_p + 1; `norms` (n_p,) of columns."""

    R: np.ndarray
    c: np.ndarray
    norms: np.ndarray


@dataclass(frozen=True)
class Step:
    """Step d (n_p,) in scaled variables and the drop of f that the linear model predicts for it."""

    d: np.ndarray
    drop: float


def reduce(jacobian: np.ndarray, residual: np.ndarray) -> Reduced:
    """QR of [J r]; jacobian (n, n_p) with respect to the scaled variables, residual (n,)."""
    triangle = np.asarray(np.linalg.qr(np.column_stack([jacobian, residual]), mode="r"))
    R, c = triangle[:, :-1], triangle[:, -1]
    return Reduced(R, c, np.linalg.norm(R, axis=0))


def bounded_step(reduced: Reduced, room: tuple[np.ndarray, np.ndarray]) -> Step:
    """Minimise |J d + r|^2 within room = (lowest d, highest d), each (n_p,), which must hold 0; d in scaled variables.

    Bounded-variable least squares is exact for the few parameters at hand, so that a step ends on a bound, not near it.
    """
    # A column of zeros says nothing about its parameter: any positive weight makes it stay where it is.
    weights = np.where(reduced.norms > 0.0, reduced.norms, 1.0)
    matrix = np.vstack([reduced.R, np.sqrt(TINY_DAMPING) * np.diag(weights)]) / weights
    right = -np.concatenate([reduced.c, np.zeros(weights.size)])
    lower, upper = np.minimum(room[0], 0.0) * weights, np.maximum(room[1], 0.0) * weights
    solution = lsq_linear(matrix, right, bounds=(lower, upper), method="bvls", tol=1e-14, max_iter=20 * weights.size)
    d = np.clip(solution.x / weights, room[0], room[1])
    # Exactly on the bound, which the division by the weights may miss by one bit.
    d = np.where(solution.active_mask < 0, room[0], np.where(solution.active_mask > 0, room[1], d))
    model = reduced.R @ d + reduced.c
    return Step(d, max(0.0, float(reduced.c @ reduced.c - model @ model)))
