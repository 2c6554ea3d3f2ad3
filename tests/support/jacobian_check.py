"""Are the exact derivatives right? Taylor test of `Problem.linearise` along every parameter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.fit.evaluate import Evaluations
from thermofit.fit.problem import Problem
from thermofit.fit.settings import Hooks


@dataclass(frozen=True)
class JacobianCheck:
    """Taylor test of the columns of a Jacobian, arrays (n_p,).

    `order`: with which power of the step h the remainder |r(x + h e) - r(x) - h J e| falls between h and h/2; 2 where J is the
    derivative, 1 where it is not (and anything where r is linear, so that the remainder is rounding). `error`: |D - J|/|J| with D
    extrapolated from both differences, which takes the second-order term out; it decides: a column passes within `tolerance`.
    """

    names: tuple[str, ...]
    order: np.ndarray
    error: np.ndarray
    tolerance: float

    @property
    def passed(self) -> np.ndarray:
        """True (n_p,) where the derivative is right."""
        return np.asarray(self.error <= self.tolerance)

    def text(self) -> str:
        """One line: the columns that fail with their orders and errors, or the worst error of all."""
        wrong = [
            f"{name} (order {order:.2f}, error {error:.1e})"
            for name, order, error, right in zip(self.names, self.order, self.error, self.passed, strict=True)
            if not right
        ]
        if wrong:
            return f"derivatives with respect to {', '.join(wrong)} are wrong"
        return f"derivatives are right, largest relative error {float(self.error.max()):.1e}"


def check_jacobian(
    problem: Problem, x: np.ndarray | None = None, step: float = 1e-3, tolerance: float = 1e-5, hooks: Hooks | None = None
) -> JacobianCheck:
    """Taylor test at x (n_p,), the start where None, with steps `step` and step/2 in units of the scale: 1 + 2 n_p forward runs.

    Steps turn inward at a bound. StudyError where the problem has no exact derivatives; NumericsError where a run fails.
    """
    if problem.linearise is None:
        raise StudyError("the problem has no exact derivatives to check; its derivatives are finite differences")
    x = np.array(problem.start if x is None else x, dtype=float)
    evaluations = Evaluations(problem, hooks)
    base, jacobian = evaluations.linearised(x)
    order, error = np.empty(x.size), np.empty(x.size)
    for i in range(x.size):
        h = step * float(problem.scale[i]) * (1.0 if problem.upper[i] - x[i] >= step * problem.scale[i] else -1.0)
        whole, half = (_remainder(evaluations, (x, base, jacobian[:, i]), i, h * share) for share in (1.0, 0.5))
        size = float(np.linalg.norm(jacobian[:, i]))
        wrong = float(np.linalg.norm(2.0 * half[1] - whole[1]))
        order[i] = 1.0 + np.log2(max(whole[0], np.finfo(float).tiny) / max(half[0], np.finfo(float).tiny))
        error[i] = wrong / size if size > 0.0 else wrong * float(problem.scale[i])
    return JacobianCheck(problem.names, order, error, tolerance)


def _remainder(evaluations: Evaluations, point: tuple[np.ndarray, np.ndarray, np.ndarray], i: int, h: float) -> tuple[float, np.ndarray]:
    """(r(x + h e_i) - r(x))/h - J e_i (n,), its norm first."""
    x, base, column = point
    shifted = x.copy()
    shifted[i] += h
    made = float(shifted[i] - x[i])
    remainder = (evaluations.residual(shifted) - base) / made - column
    return float(np.linalg.norm(remainder)), remainder
