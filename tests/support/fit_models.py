"""Small models with known answers for the tests of the fit."""

from __future__ import annotations

import dataclasses

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.fit.problem import Problem


def problem(residual, start, lower=None, upper=None, scale=None, names=None, jacobian=None) -> Problem:
    """Problem with defaults; with `jacobian` its derivatives are exact."""
    start = np.array(start, dtype=float)
    full = np.full(start.size, np.inf)
    return Problem(
        residual,
        start,
        -full if lower is None else np.array(lower, dtype=float),
        full if upper is None else np.array(upper, dtype=float),
        np.ones(start.size) if scale is None else np.array(scale, dtype=float),
        tuple(names or (f"p{i}" for i in range(start.size))),
        None if jacobian is None else lambda x: (residual(x), jacobian(x)),
    )


def complex_step(residual, x, step=1e-30):
    """dr/dx exact to rounding of a residual that takes complex arguments."""
    return np.column_stack([np.imag(residual(x + 1j * step * e)) / step for e in np.eye(x.size)])


def exact(base: Problem) -> Problem:
    """The same problem with exact derivatives by complex step."""
    return dataclasses.replace(base, linearise=lambda x: (base.residual(x), complex_step(base.residual, x)))


def rosenbrock(x):
    """Residual with minimum 0 at (1, 1)."""
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def rosenbrock_jacobian(x):
    """dr/dx of rosenbrock."""
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


TIMES = np.linspace(0.0, 4.0, 80)


def decay(seed=1, sigma=0.01):
    """Whitened residual of 2 exp(-1.5 t) + exp(-0.3 t) with noise of standard deviation sigma."""
    data = 2.0 * np.exp(-1.5 * TIMES) + np.exp(-0.3 * TIMES) + sigma * np.random.default_rng(seed).standard_normal(TIMES.size)

    def residual(p):
        return (p[0] * np.exp(-p[1] * TIMES) + p[2] * np.exp(-p[3] * TIMES) - data) / sigma

    return residual


def decay_problem(seed=1, sigma=0.01) -> Problem:
    """Four parameters of two exponentials."""
    return problem(decay(seed, sigma), [1.0, 2.0, 2.0, 0.1], [0.0] * 4, [10.0] * 4)


BAR_TRUE = np.array([70000.0, 130.0, 300.0, 11.0, 0.33, 0.45])
BAR_NAMES = ("E", "M_y0", "M_yinf", "H_exp", "nu", "r")
BAR_SCALE = np.array([7e4, 1e2, 3e2, 1e1, 0.3, 0.5])
BAR_LOWER = np.array([1e4, 10.0, 200.0, 1.0, 0.0, 0.1])
BAR_UPPER = np.array([1e6, 400.0, 800.0, 100.0, 0.499, 2.0])


def bar(seed=3, noise=2e-5):
    """Whitened axial and lateral strain of a bar under a prescribed stress history, exponential hardening (4.6).

    Fails, as an FE model does, where the load is above the hardening limit.
    """
    stress = np.concatenate([np.linspace(0.0, 285.0, 120), np.linspace(285.0, 100.0, 20)])
    highest = np.maximum.accumulate(stress)

    def strain(p):
        young, first, limit, speed, poisson, ratio = p
        if highest[-1] >= limit.real or first.real >= limit.real:
            raise NumericsError("no convergence: load above the hardening limit")
        over = np.where(highest > np.real(first), highest - first, 0.0) / (limit - first)
        plastic = -np.log1p(-over) / speed
        return np.concatenate([stress / young + plastic, -poisson * stress / young - ratio * plastic])

    clean = strain(BAR_TRUE)
    data = clean + noise * np.random.default_rng(seed).standard_normal(clean.size)
    return lambda p: (strain(p) - data) / noise


def bar_problem(start, seed=3, lower=BAR_LOWER) -> Problem:
    """Six parameters between 0.3 and 7e4."""
    return problem(bar(seed), start, lower, BAR_UPPER, BAR_SCALE, BAR_NAMES)


class DictStore:
    """Store in memory: what records.checkpoint does on disk."""

    def __init__(self):
        self.entries = {}

    def get(self, x):
        return self.entries.get(x.tobytes())

    def put(self, x, **arrays):
        self.entries[x.tobytes()] = {key: np.array(value) for key, value in arrays.items()}
