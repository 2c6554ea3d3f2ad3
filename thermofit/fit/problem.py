"""The problem that an optimiser sees: a whitened residual r(x), bounds, scales, names. No FE, no files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import StudyError

ResidualFunction = Callable[[np.ndarray], np.ndarray]
LineariseFunction = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

QUANTUM = 1e-11
"""Grid of the scaled variables: last-bit noise of BLAS must not make a resumed run miss a finished evaluation."""


@dataclass(frozen=True)
class Problem:
    """Minimise f(x) = r(x).r(x) (2.24, 2.27) within bounds; r is whitened, sqrt(W) times prediction minus observation.

    `start`, `lower`, `upper`, `scale` (n_p,) are in the units of the parameters, `scale` is the usual size of a change; bounds
    may be infinite. `residual(x)` gives (n,) or raises NumericsError; `linearise(x)` gives the same residual and the exact dr/dx
    (n, n_p) from one forward run, or is None: then derivatives are finite differences. StudyError names the parameter whose start,
    bounds or scale do not fit together.
    """

    residual: ResidualFunction
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray
    names: tuple[str, ...]
    linearise: LineariseFunction | None = None
    first_jacobian: np.ndarray | None = None
    """dr/dx (n, n_p) near the start, for example of a coarser model: least-squares makes its first step with it, and computes its own at
    the end."""
    first_curvature: np.ndarray | None = None
    """What second derivatives add to J^T J (n_p, n_p) near the start, with respect to x (`FitResult.curvature`): least-squares bases its
    steps on it while it predicts them better than J^T J alone."""

    def __post_init__(self) -> None:
        if not self.names:
            raise StudyError("no parameter is free, at least one is expected: list the free parameters of the stage")
        for key in ("start", "lower", "upper", "scale"):
            value = np.array(getattr(self, key), dtype=float)
            if value.shape != (len(self.names),):
                raise StudyError(f"'{key}' has shape {value.shape}, expected one number for each of {', '.join(self.names)}")
            value.setflags(write=False)
            object.__setattr__(self, key, value)
        for name, x, low, up, scale in zip(self.names, self.start, self.lower, self.upper, self.scale, strict=True):
            _check(name, float(x), float(low), float(up), float(scale))


def _check(name: str, x: float, low: float, up: float, scale: float) -> None:
    if not low < up:
        raise StudyError(f"bounds of '{name}' are [{low:g}, {up:g}], expected lower < upper: widen them or fix the parameter")
    if not (np.isfinite(x) and low <= x <= up):
        raise StudyError(f"start of '{name}' is {x:g}, expected a number in its bounds [{low:g}, {up:g}]: move the start or the bound")
    if not (np.isfinite(scale) and scale > 0.0):
        raise StudyError(f"scale of '{name}' is {scale:g}, expected a positive number of the size of a usual change")


def to_scaled(problem: Problem, x: np.ndarray) -> np.ndarray:
    """z = 1 + (x - start)/scale, dimensionless. The 1 makes a step relative to |z| a step relative to the scale."""
    return np.asarray(1.0 + (x - problem.start) / problem.scale)


def from_scaled(problem: Problem, z: np.ndarray) -> np.ndarray:
    """x = start + scale (z - 1), with z on the grid QUANTUM and x inside its bounds; exact at the start."""
    rounded = np.round((z - 1.0) / QUANTUM) * QUANTUM
    return np.asarray(np.clip(problem.start + problem.scale * rounded, problem.lower, problem.upper))


def scaled_bounds(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of z, each (n_p,)."""
    return to_scaled(problem, problem.lower), to_scaled(problem, problem.upper)
