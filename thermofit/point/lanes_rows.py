"""Workspace of eight points in an update: its rows, tolerances, and the small operations on them."""

from __future__ import annotations

import math

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes, where
from thermofit.law.page import Law, hill
from thermofit.law.tensor import Symmetric, double_contraction, scaled
from thermofit.point.lanes_memory import row, set_row
from thermofit.point.lanes_tensor import outer_gram, tensor_rows
from thermofit.point.state import N_BACK

F_ELASTIC, F_TRIAL = 0, 9
"""F_el and F_tr, nine each."""
STATE = 18
"""The first eleven numbers of the state: before the update the old, then the new ones."""
C_TRIAL, FLOW, INCREMENT, EXPONENTIAL = 29, 35, 41, 47
"""C_tr, N, D and exp(-D), six each."""
GAMMA, NORM, SLOPE, K_FACTOR, K_SLOPE = 53, 54, 55, 56, 57
"""dLambda, |C_el|_G (in `lanes_relative` |T|_G), slope of the yield stress over dLambda, k and k'."""
STIFFNESS = 58
"""c, 36: row by row over 11, 22, 33, 12, 23, 13."""
EQUATIONS, PUSHED, ALONG_S, ALONG_E = 94, 154, 184, 189
"""Scratch of the plastic tangent: equations (5, 12), F_tr dZ F_tr^T (5, 6), N : S (5), N : E_kl (6)."""
SHEAR, STIFFENING = 195, 196
"""Shear modulus of the point, and d ln m / d Lambda of the factor m on its moduli."""
RELATIVE, BY_INCREMENT, NORMAL = 197, 203, 209
"""Of `lanes_relative`: T, dT/d dLambda at a fixed C_el, and the normal of its yield condition, six each."""
BACK_N = 215
"""Y of all backstresses at the start of the step, six each."""
CURVATURE, N_CURVATURE = BACK_N + 6 * N_BACK, 25
"""Curvature of a yield surface that is not quadratic (lanes_surface): components 11, 22, 12, 23, 13 of what a tensor becomes, over the same
of a traceless one."""
POINT_ROWS = CURVATURE + N_CURVATURE

MAX_ITERATIONS = 60
STRESS_TOLERANCE = 1e-11
"""Distance from the yield surface, relative to the yield stress, at which the return map has converged."""
FLOW_TOLERANCE, FLOW_ACCURACY = 1e-14, 1e-12
"""Error of D at which it has: absolute and relative to dLambda."""


@kernel(forceinline=True)
def add_to_row(w: np.ndarray, n: int, value: Lanes) -> None:
    """Row n += value."""
    set_row(w, n, row(w, n) + value)


@kernel(forceinline=True)
def stress_of_rows(w: np.ndarray) -> Symmetric:
    """tau = mu F_el F_el^T + k 1 in MPa."""
    b, k = scaled(outer_gram(tensor_rows(w, F_ELASTIC)), row(w, SHEAR)), row(w, K_FACTOR)
    return (b[0] + k, b[1] + k, b[2] + k, b[3], b[4], b[5])


@kernel(forceinline=True)
def flow_direction(c_elastic: Symmetric, law: Law) -> tuple[Symmetric, Lanes]:
    """N = G : C_el / |C_el|_G and |C_el|_G (4.14), (4.19)."""
    g = hill(c_elastic, law)
    squared = double_contraction(g, c_elastic)
    norm = math.sqrt(where(squared > 0.0, squared, 0.0))
    return scaled(g, where(norm > 0.0, 1.0 / norm, 0.0)), norm


@kernel(forceinline=True)
def set_equation_column(w: np.ndarray, n: int, s: Symmetric) -> None:
    """Components 11, 22, 12, 23, 13 of a traceless tensor as column n of the equations."""
    set_row(w, EQUATIONS + n, s[0])
    set_row(w, EQUATIONS + 12 + n, s[1])
    set_row(w, EQUATIONS + 24 + n, s[3])
    set_row(w, EQUATIONS + 36 + n, s[4])
    set_row(w, EQUATIONS + 48 + n, s[5])


@kernel(forceinline=True)
def eliminate(w: np.ndarray, columns: int) -> None:
    """Gauss-Jordan elimination of the five equations in so many columns; without pivoting, since 1 + r G : S is 1 + 2 r G up to the
    elastic strain."""
    for k in range(5):
        pivot = EQUATIONS + 12 * k
        r = 1.0 / row(w, pivot + k)
        for j in range(k + 1, columns):
            set_row(w, pivot + j, r * row(w, pivot + j))
        for i in range(5):
            if i != k:
                other = EQUATIONS + 12 * i
                factor = row(w, other + k)
                for j in range(k + 1, columns):
                    set_row(w, other + j, row(w, other + j) - factor * row(w, pivot + j))
