"""Markov chain Monte Carlo of the parameters (emcee, an optional package): what Laplace's ellipse cannot show, bounds and bent valleys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import NumericsError, StudyError

LEAST_TIMES = 50
"""Steps of a chain in units of its correlation time that its quantiles need (emcee's own rule)."""
MOST_PARAMETERS = 12


@dataclass(frozen=True)
class Chain:
    """`x` (n, n_p): draws after burn-in; `correlation_time` in steps, `acceptance` share, `steps` per walker; `remark`: too short."""

    x: np.ndarray
    correlation_time: float
    acceptance: float
    steps: int
    remark: str


LogDensity = Callable[[np.ndarray], float]


def linear_density(x: np.ndarray, covariance: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> LogDensity:
    """ln p of the linearised model: a normal distribution of that covariance (n_p, n_p) about x, cut off at the bounds."""
    root = np.linalg.cholesky(covariance)

    def log_density(at: np.ndarray) -> float:
        if np.any(at < lower) or np.any(at > upper):
            return -np.inf
        z = np.linalg.solve(root, at - x)
        return -0.5 * float(z @ z)

    return log_density


def full_density(objective: Callable[[np.ndarray], float], f: float, variance: float, bounds: tuple[np.ndarray, np.ndarray]) -> LogDensity:
    """ln p of the full model, -(f(x) - f)/(2 variance) within the bounds; a run that fails has no probability."""

    def log_density(at: np.ndarray) -> float:
        if np.any(at < bounds[0]) or np.any(at > bounds[1]):
            return -np.inf
        try:
            return -0.5 * (objective(at) - f) / variance
        except NumericsError:
            return -np.inf

    return log_density


def sampled(
    log_density: LogDensity, x: np.ndarray, spread: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], seed: int, steps: int = 2000
) -> Chain:
    """Draws of `steps` steps of 4 n_p walkers that begin within `spread` (n_p,) of x. StudyError where emcee is not installed."""
    try:
        import emcee
    except ImportError:
        raise StudyError("--mcmc needs the package emcee, which is not installed: `pip install 'thermofit[mcmc]'`") from None
    p = x.size
    if p > MOST_PARAMETERS:
        raise StudyError(f"--mcmc: {p} parameters are free, {MOST_PARAMETERS} at most can be sampled: fix some, or take --profile")
    rng = np.random.default_rng(seed)
    walkers = max(4 * p, 8)
    lower, upper = bounds
    width = np.minimum(spread, 0.5 * (upper - lower))
    start = np.clip(x + width * rng.standard_normal((walkers, p)), lower, upper)
    sampler = emcee.EnsembleSampler(walkers, p, log_density)
    # The old generator is the only one that emcee takes; the seed makes the chain repeatable.
    sampler.random_state = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(start, steps)
    time = float(np.max(sampler.get_autocorr_time(quiet=True, tol=0)))
    time = time if np.isfinite(time) else float(steps)
    burn = min(int(np.ceil(5.0 * time)), steps // 2)
    remark = "" if steps >= LEAST_TIMES * time else f"the chain is {steps / time:.3g} correlation times long, {LEAST_TIMES} are wanted"
    draws = np.asarray(sampler.get_chain(discard=burn, flat=True))
    return Chain(draws, time, float(np.mean(sampler.acceptance_fraction)), steps, remark)
