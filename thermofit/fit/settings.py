"""What the user may choose about a fit, and the hooks through which the outside listens to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from thermofit.core.errors import StudyError

MapFunction = Callable[[Callable[[np.ndarray], Any], list[np.ndarray]], Iterable[Any]]


@dataclass(frozen=True)
class Settings:
    """`x_tolerance` is relative to the scale of each parameter; `f_tolerance` is a drop of f in units of s2 = f/(n - n_p), which
    makes it the squared distance to the minimum in standard errors (1e-3 is 0.03 sigma), whatever the number of data.

    A fit has converged when either is met, with derivatives by the full Gauss-Newton step within the bounds. `max_evaluations` counts
    every forward run, plain or linearised, those of finite differences included. `difference_step` is in units of the scale.
    `initial_step` (units of the scale) opens the simplex or the trust region of the derivative-free methods. `covariance=False` saves
    the Jacobian at the optimum where the method needs none. `worth` is a relative fall of f: a search with derivatives ends,
    not converged, where all evaluations that are left would not lower f by as much at the pace of its last steps; 0: never. `to_beat` is
    the f of an end that is known already: there it ends also where they would not lower f that much below it; infinite: there is none.
    """

    x_tolerance: float = 1e-4
    f_tolerance: float = 1e-3
    max_evaluations: int = 1000
    differences: Literal["forward", "central"] = "forward"
    difference_step: float = 1e-4
    initial_step: float = 0.1
    covariance: bool = True
    worth: float = 0.0
    to_beat: float = math.inf

    def __post_init__(self) -> None:
        for key in ("x_tolerance", "f_tolerance", "max_evaluations", "difference_step", "initial_step"):
            if not getattr(self, key) > 0:
                raise StudyError(f"fit setting '{key}' is {getattr(self, key)}, expected a positive number")
        if self.differences not in ("forward", "central"):
            raise StudyError(f"fit setting 'differences' is '{self.differences}', expected 'forward' or 'central'")


def relative_drop(settings: Settings, n: int, n_parameters: int) -> float:
    """`f_tolerance` as a fraction of f, for n residuals: f_tolerance/(n - n_p)."""
    return settings.f_tolerance / max(n - n_parameters, 1)


class Store(Protocol):
    """Memory of finished evaluations that survives a kill."""

    def get(self, x: np.ndarray) -> dict[str, np.ndarray] | None:
        """The arrays that were put for exactly this x, or None."""
        ...

    def put(self, x: np.ndarray, **arrays: np.ndarray) -> Any:
        """Keep arrays for this x."""
        ...


@dataclass(frozen=True)
class Hooks:
    """`store` resumes a killed fit; `on_evaluation(evaluation, residual or None)` follows it; `map_function(function, xs)`
    runs the columns of finite differences, in order (serial by default; a pool's map must be able to pickle the residual)."""

    store: Store | None = None
    on_evaluation: Callable[[Any, np.ndarray | None], None] | None = None
    map_function: MapFunction = map
