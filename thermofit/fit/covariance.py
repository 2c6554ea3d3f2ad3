"""How well the data determine the parameters: covariance, correlations, and which combination they do not determine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

NoiseOperator = Callable[[np.ndarray], np.ndarray]

PARTICIPATION = 0.1
"""A parameter belongs to an undetermined direction if its share of the unit vector exceeds this."""


@dataclass(frozen=True)
class NullDirection:
    """A combination of parameters that the residual does not feel: `names` and `weights`, per unit of column norm.

    A single name is a parameter without any effect on the residual.
    """

    names: tuple[str, ...]
    weights: tuple[float, ...]


@dataclass(frozen=True)
class Covariance:
    """Covariance of the parameters at an optimum.

    `matrix` = s2 * `matrix_unit` (n_p, n_p): scaled with the reduced chi-square `s2` (2.38), resp. taking the whitening at its
    word (s2 = 1); zero rows for parameters at a bound, which are held there, and for undetermined ones. `sigma`, `sigma_unit` (n_p,):
    standard errors; that of a parameter at a bound is the one it would have if it alone were released; infinite exactly for
    the parameters in `null`. `correlation_sensitivity` C^S (2.34), `correlation_parameters` C^P (2.37), 0 where not defined.
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    matrix_unit: np.ndarray
    sigma: np.ndarray
    sigma_unit: np.ndarray
    s2: float
    n: int
    degrees_of_freedom: float
    correlation_sensitivity: np.ndarray
    correlation_parameters: np.ndarray
    at_bound: np.ndarray
    null: tuple[NullDirection, ...]
    condition: float

    @property
    def identifiable(self) -> bool:
        """True if the data determine every parameter."""
        return not self.null


def correlation(matrix: np.ndarray) -> np.ndarray:
    """C_ij = M_ij / sqrt(M_ii M_jj) (2.35, 2.37) of a symmetric matrix (n_p, n_p); rows with M_ii = 0 become unit rows."""
    root = np.sqrt(np.diag(matrix))
    root = np.where(root > 0.0, root, 1.0)
    result = matrix / np.outer(root, root)
    np.fill_diagonal(result, 1.0)
    return np.asarray(np.clip(result, -1.0, 1.0))
