"""Markov chains of a linearised stage, or of its full model where a run costs little."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermofit.core.errors import UntrustworthyError
from thermofit.fit.sampling import Chain, LogDensity, full_density, linear_density, sampled
from thermofit.identify.identifiability import Analysis
from thermofit.identify.intervals import LEVEL, Interval, fit_problem
from thermofit.identify.linear import Linear
from thermofit.identify.subject import Subject

FULL_STEPS = 600
"""Steps of a chain on the full model: each costs four forward runs for each parameter."""


def chain_intervals(subject: Subject, linear: Linear, analysis: Analysis, seed: int, full: bool) -> tuple[Mapping[str, Interval], Chain]:
    """Intervals and draws (n, n_p) of the parameters that are not at a bound; `full`: on the model itself, else on the linearised one.

    UntrustworthyError where the linearised model leaves a parameter open; StudyError where emcee is missing.
    """
    kept = np.flatnonzero(~linear.at_bound)
    sigma = analysis.sigma[kept]
    bounds = (linear.lower[kept], linear.upper[kept])
    if not full and not np.all(np.isfinite(sigma)):
        raise UntrustworthyError("--mcmc: the linearised model leaves a parameter open; fix one as the verdict says, or give --full-model")
    x = linear.x[kept]
    spread = np.where(np.isfinite(sigma), sigma, 0.1 * linear.size[kept])
    density = _full(subject, linear, analysis, kept) if full else _linear(linear, analysis, kept)
    chain = sampled(density, x, 0.5 * spread, bounds, seed, *((FULL_STEPS,) if full else ()))
    low, high = np.quantile(chain.x, [0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)], axis=0)
    return {linear.names[i]: Interval(float(low[k]), float(high[k]), remark=chain.remark) for k, i in enumerate(kept)}, chain


def _linear(linear: Linear, analysis: Analysis, kept: np.ndarray) -> LogDensity:
    matrix = analysis.s2 * analysis.covariance.matrix_unit[np.ix_(kept, kept)]
    return linear_density(linear.x[kept], matrix, linear.lower[kept], linear.upper[kept])


def _full(subject: Subject, linear: Linear, analysis: Analysis, kept: np.ndarray) -> LogDensity:
    """-(f - f_min)/(2 s2 v): v, what correlation adds to the variances in the mean, makes the chain as wide as the honest covariance."""
    problem, change, _ = fit_problem(subject, linear, linear.residual if linear.before else None)
    scaled = linear.jacobian[:, kept] * linear.size[kept]
    naive = -2.0 * float(np.log(np.abs(np.diag(np.asarray(np.linalg.qr(scaled, mode="r"))))).sum())
    unit = analysis.covariance.matrix_unit[np.ix_(kept, kept)] / np.outer(linear.size[kept], linear.size[kept])
    sign, honest = np.linalg.slogdet(unit)
    inflation = float(np.exp((honest - naive) / len(kept))) if sign > 0.0 and np.isfinite(honest) else 1.0
    f = 0.0 if linear.before else float(linear.residual @ linear.residual)

    def objective(at: np.ndarray) -> float:
        x = linear.x.copy()
        x[kept] = at
        residual = problem.residual(change.variables(x))
        return float(residual @ residual)

    return full_density(objective, f, analysis.s2 * inflation, (linear.lower[kept], linear.upper[kept]))
