"""Free expansion takes heat: what is left of a change of temperature once the body has swelled with it (fixed-stress split).

At constant stress a change dtheta swells the body by d(ln J) = 3 alpha dtheta, which takes the heat 9 K alpha^2 theta_0 dtheta. With R the
answer of the temperature at the end of a step to heat that is released evenly over it, and S the matrix of unit capacity per swelling
volume (`swelling_matrices`),

    (1 + 9 K alpha^2 theta_0 R S) x = dtheta.

Where all is even x = c0 / (c0 + 9 K alpha^2 theta_0) dtheta. Mechanics and heat that alternate with x in place of dtheta agree
after one sweep where the body expands freely (J. Kim, H. Tchelepi and R. Juanes, 2011, Computer Methods in Applied Mechanics and
Engineering 200: the fixed-stress split of poromechanics, whose pressure is the temperature here).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from thermofit.body.body import Body
from thermofit.body.heat.conduction import HeatStep
from thermofit.body.sensitivity.conduction_rates import heat_answer
from thermofit.body.solve.linear import multiply_symmetric
from thermofit.core.errors import NumericsError

STRONG = 0.08
"""Ratio 9 K alpha^2 theta_0 / c0 from which conduction is taken into account; that of metals and polymers is less."""
_EXACT = 1e-3
RESTART, CYCLES = 40, 5


def left_of(body: Body, step: HeatStep, more: float, change: np.ndarray) -> np.ndarray:
    """x (n_np,) or (n_np, m) of a change of temperature in a step, where swelling takes the heat `more` mJ/(mm^3 K).

    NumericsError where the linear equations are not solved.
    """
    columns = change.reshape(len(change), -1)
    out = np.zeros_like(columns)
    n, p = len(columns), body.thermal

    def felt(x: np.ndarray) -> np.ndarray:
        return x + heat_answer(body, step, more * multiply_symmetric(p.row, p.column, body.swelling, np.ravel(x)))

    for k in np.flatnonzero(np.any(columns, axis=0)):
        right = np.ascontiguousarray(columns[:, k])
        out[:, k], failed = gmres(LinearOperator((n, n), felt, dtype=float), right, rtol=_EXACT, restart=RESTART, maxiter=CYCLES)
        if failed:
            raise NumericsError(
                f"coupling: expansion takes {more / step.conditions.c0:.3g} times the heat that warms the body, and the temperature that "
                "is left is not found; check alpha_exp and c0"
            )
    return out.reshape(change.shape)
