"""A fit whose parameters are less known than its noise alone makes them, for it holds numbers that nobody knows.

With J the columns of the fitted parameters, S those of the numbers that are held, s what of S is beyond J, and C the correlation of the
noise, the data would move these numbers from where they are held by

    a = -(s^T s)^-1 s^T r,   P = s^T s (s^T C s)^-1 s^T s = (var a)^-1.

Before the data speak they are off by no more than errors u. So the data have them at m, known to V,

    V = (P + diag u^-2)^-1,   m = V P a,   and held where they are, they are off by V + m m^T (mean square).

To the first order, with m = 0, it is as if they were fitted beside a prior of standard error u.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.fit.covariance import correlation
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult


def known_to(model: LinearModel, columns: np.ndarray, before: np.ndarray) -> np.ndarray:
    """V + m m^T (k, k) of numbers that are held, whose columns are (n, k), and whose standard errors (k,) are `before` by themselves. What
    no datum tells beyond the model's parameters is known as before."""
    s = model.projected(columns * before)
    gram, inner = s.T @ s, np.linalg.pinv(model.meat(s), rcond=1e-12, hermitian=True)
    spread = np.linalg.inv(gram @ inner @ gram + np.eye(len(gram)))
    mean = -spread @ gram @ inner @ (s.T @ model.left)
    return np.asarray((spread + np.outer(mean, mean)) * np.outer(before, before))


def widened(fit: FitResult, added: np.ndarray) -> FitResult:
    """The fit with `added` (n_p, n_p) in its covariance; parameters of which nothing is known stay so."""
    old = fit.covariance
    assert old is not None
    known = np.isfinite(old.sigma)
    added = np.where(known[:, None] & known, added, 0.0)
    matrix, unit = old.matrix + added, old.matrix_unit + added
    sigma, sigma_unit = (np.sqrt(v**2 + np.diag(added)) for v in (old.sigma, old.sigma_unit))
    wider = replace(old, matrix=matrix, matrix_unit=unit, sigma=sigma, sigma_unit=sigma_unit, correlation_parameters=correlation(unit))
    return replace(fit, covariance=wider, sigma=sigma)


def with_covariance(fit: FitResult, matrix: np.ndarray, sigma: np.ndarray) -> FitResult:
    """The fit with another covariance (n_p, n_p) and other standard errors (n_p,), which parameters held at a bound have too."""
    assert fit.covariance is not None
    spread = replace(fit.covariance, matrix=matrix, matrix_unit=matrix, sigma=sigma, sigma_unit=sigma)
    return replace(fit, covariance=replace(spread, correlation_parameters=correlation(matrix)), sigma=sigma)


def most_widened(before: FitResult, after: FitResult) -> str:
    """The intervals that grew most, in words; empty where none does in the two digits that are shown."""
    assert before.sigma is not None and after.sigma is not None
    told = [(name, float(old), float(new)) for name, old, new in zip(before.names, before.sigma, after.sigma, strict=True)]
    moved = sorted((one for one in told if np.isfinite(one[1]) and f"{one[1]:.2g}" != f"{one[2]:.2g}"), key=lambda one: one[1] / one[2])
    return ", ".join(f"{name} +- {new:.2g} (else {old:.2g})" for name, old, new in moved[:3])
