"""The contact coefficient is fitted as a contact resistance: temperatures are nearly linear in 1/alpha, and hardly feel alpha itself.

From a start at isothermal contact (4e5 W/(m^2 K), Table 5.18) the temperatures do not respond to alpha at all; to 1/alpha they
respond at once and almost linearly, so that a Gauss-Newton step lands near the answer. A Param that is known by its order of magnitude
(`logarithmic`: a reference rate) is fitted by its logarithm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import bare_name, param
from thermofit.fit.result import FitResult

RECIPROCAL = ("alpha_clamp",)
_LEAST = 1e-3
"""W/(m^2 K): a lower bound of zero is a contact that conducts this little."""


@dataclass(frozen=True)
class Reciprocal:
    """Map between parameters x (n_p,) and fit variables y: y = 1/x where `is_reciprocal` (n_p,), y = ln x where `is_log`, else y = x."""

    is_reciprocal: np.ndarray
    is_log: np.ndarray

    def variables(self, x: np.ndarray) -> np.ndarray:
        """y of x."""
        y = np.where(self.is_reciprocal, 1.0 / np.where(self.is_reciprocal, np.maximum(x, _LEAST), 1.0), x)
        return np.where(self.is_log, np.log(np.where(self.is_log, x, 1.0)), y)

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

    def converted(self, fit: FitResult) -> FitResult:
        """The fit in terms of x: values, log and dr/dx = dr/dy dy/dx; its own covariance is dropped, because it is of y."""
        if not (self.is_reciprocal.any() or self.is_log.any()):
            return fit
        x = self.parameters(fit.x)
        jacobian = None if fit.jacobian is None else fit.jacobian * self.slope(x)
        log = tuple(replace(entry, x=self.parameters(entry.x)) for entry in fit.log)
        return replace(fit, x=x, jacobian=jacobian, covariance=None, sigma=None, log=log)


def reciprocal_of(names: tuple[str, ...]) -> Reciprocal:
    """The map for free parameters of these names."""
    return Reciprocal(np.array([bare_name(name) in RECIPROCAL for name in names]), np.array([param(name).logarithmic for name in names]))
