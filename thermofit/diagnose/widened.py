"""A fit whose parameters are less known than its noise alone makes them, and which of its intervals that widens most."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.fit.covariance import correlation
from thermofit.fit.result import FitResult


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
