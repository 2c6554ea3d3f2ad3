"""The variables in which parameters are fitted: those in which the residual is nearly linear, so that a Gauss-Newton step goes far.

The contact coefficient is fitted as a contact resistance: temperatures are nearly linear in 1/alpha, and hardly feel alpha itself. From a
start at isothermal contact (4e5 W/(m^2 K), Table 5.18) the temperatures do not respond to alpha at all; to 1/alpha they respond at once and
almost linearly, so that a Gauss-Newton step lands near the answer.

A Param that is known by its order of magnitude (`logarithmic`: a reference rate, the exponent of a power law of the rate) is fitted by its
logarithm. So is the amplitude of its effect beside it, where that has one sign. Of K ((1 + z)^m - 1) with a small m data tell little more
than the product K m. The valley K m = const is bent, and a straight step in K and m leaves it at once; in ln K and ln m it is straight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import Parameters, bare_name, param
from thermofit.effects.catalogue import effect_of_param, is_of_effect
from thermofit.fit.result import FitResult

RECIPROCAL = ("alpha_clamp",)
_LEAST = 1e-3
"""W/(m^2 K): a lower bound of zero is a contact that conducts this little."""
_NOTHING = 1e-6
"""Part of its usual size that a parameter fitted by its logarithm has where its lower bound is zero."""


@dataclass(frozen=True)
class FitVariables:
    """Map between parameters x (n_p,) and fit variables y: y = 1/x where `is_reciprocal` (n_p,), y = ln x where `is_log`, else y = x.
    `least` (n_p,): the smallest value of which a logarithm is taken."""

    is_reciprocal: np.ndarray
    is_log: np.ndarray
    least: np.ndarray

    def variables(self, x: np.ndarray) -> np.ndarray:
        """y of x."""
        y = np.where(self.is_reciprocal, 1.0 / np.where(self.is_reciprocal, np.maximum(x, _LEAST), 1.0), x)
        return np.where(self.is_log, np.log(np.where(self.is_log, np.maximum(x, self.least), 1.0)), y)

    def parameters(self, y: np.ndarray) -> np.ndarray:
        """x of y (..., n_p)."""
        x = np.where(self.is_reciprocal, 1.0 / np.where(self.is_reciprocal, y, 1.0), y)
        return np.where(self.is_log, np.exp(np.where(self.is_log, y, 0.0)), x)

    def bounds(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of y; the reciprocal swaps them."""
        low, up = self.variables(lower), self.variables(upper)
        return np.where(self.is_reciprocal, up, low), np.where(self.is_reciprocal, low, up)

    def scales(self, scale: np.ndarray) -> np.ndarray:
        """Scale of y: a usual coefficient is a usual resistance; of a logarithm, one."""
        return np.where(self.is_log, 1.0, np.where(self.is_reciprocal, 1.0 / scale, scale))

    def slope(self, x: np.ndarray) -> np.ndarray:
        """dy/dx (n_p,)."""
        slope = np.where(self.is_reciprocal, -1.0 / np.where(self.is_reciprocal, x, 1.0) ** 2, 1.0)
        return np.where(self.is_log, 1.0 / np.where(self.is_log, x, 1.0), slope)

    def by_variables(self, jacobian: np.ndarray, x: np.ndarray) -> np.ndarray:
        """dr/dy = dr/dx dx/dy of dr/dx (n, n_p) at x."""
        return np.asarray(jacobian / self.slope(x))

    def curvature_by_variables(self, curvature: np.ndarray, x: np.ndarray) -> np.ndarray:
        """What second derivatives add to J^T J (n_p, n_p) with respect to y, of that with respect to x; at an optimum, where the gradient
        that dx/dy bends is zero."""
        return np.asarray(curvature / np.outer(self.slope(x), self.slope(x)))

    def converted(self, fit: FitResult) -> FitResult:
        """The fit in terms of x: values, log, dr/dx = dr/dy dy/dx and curvature; its own covariance is dropped, because it is of y."""
        if not (self.is_reciprocal.any() or self.is_log.any()):
            return fit
        x = self.parameters(fit.x)
        slope = self.slope(x)
        jacobian = None if fit.jacobian is None else fit.jacobian * slope
        log = tuple(replace(entry, x=self.parameters(entry.x)) for entry in fit.log)
        curvature = None if fit.curvature is None else fit.curvature * np.outer(slope, slope)
        return replace(fit, x=x, jacobian=jacobian, covariance=None, sigma=None, log=log, curvature=curvature)


def fit_variables(names: tuple[str, ...], at: Parameters) -> FitVariables:
    """The map for free parameters of these names in a fit that begins at the given values."""
    reciprocal = np.array([bare_name(name) in RECIPROCAL for name in names])
    return FitVariables(
        reciprocal, np.array([_by_logarithm(n, names, at) for n in names]), np.array([_NOTHING * param(n).scale for n in names])
    )


def _by_logarithm(name: str, names: tuple[str, ...], at: Parameters) -> bool:
    """Whether a parameter is fitted by its logarithm: one of a size, and the amplitude of one sign beside such an exponent; none that
    begins at nothing, where its logarithm would not be felt."""
    p = param(name)
    if not at[name] > _NOTHING * p.scale:
        return False
    if p.logarithmic or not is_of_effect(name):
        return p.logarithmic
    own = effect_of_param(name)
    of_size = any(q.logarithmic and q.name in names and at[q.name] > _NOTHING * q.scale for q in own.exponents)
    return of_size and name in {q.name for q in own.amplitudes} and p.lower == p.neutral == 0.0
