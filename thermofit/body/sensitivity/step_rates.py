"""What the differentiation of a march asks for and hands on: wanted names, rates of a state, and what a converged step knew."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermofit.body.heat.conduction import HeatStep
from thermofit.body.heat.equation import PointStates
from thermofit.body.solve.linear import Factor
from thermofit.core.errors import NumericsError
from thermofit.point.state import LAMBDA


@dataclass(frozen=True)
class Sensitivities:
    """What a march differentiates: names of parameters, and `collect`, which takes what it wants of every recorded time.

    `tolerance`: relative change of theta' in a sweep over mechanics and heat at which the sweeps of a step end. A sweep lessens it some
    thousand times. At the default derivatives are within 1e-3 of the exact ones, but for those that hardly move a field.
    """

    names: tuple[str, ...]
    collect: Callable[[int, StepRates], None]
    tolerance: float = 0.02

    def of(self, places: Sequence[int]) -> Sensitivities:
        """The same by the names at these places alone; derivatives by the others are handed on as the zeros that they are."""

        def every(some: np.ndarray) -> np.ndarray:
            out = np.zeros((*some.shape[:-1], len(self.names)))
            out[..., places] = some
            return out

        def collect(n: int, at: StepRates) -> None:
            self.collect(n, StepRates(every(at.u), every(at.theta), every(at.force)))

        return replace(self, names=tuple(self.names[k] for k in places), collect=collect)


@dataclass(frozen=True)
class StepRates:
    """Derivatives at one time, last axis the parameters: u (n_np, 3, n) mm, theta (n_np, n) K, force (n,) N of the whole specimen.

    The arrays are views of buffers that the next steps overwrite: `collect` copies what it keeps.
    """

    u: np.ndarray
    theta: np.ndarray
    force: np.ndarray


@dataclass(frozen=True)
class Rates:
    """Rates of a state along m directions: u (n_np, 3, m), theta (n_np, m), points (n_el, 8, 11, m), J (n_el, 8, m), top force (m,).

    `past`: length of the step that led here and theta' at its start, and the same of the step before: for extrapolation.
    """

    u: np.ndarray
    theta: np.ndarray
    points: np.ndarray
    dilatation: np.ndarray
    top_force: np.ndarray
    past: tuple[tuple[float, np.ndarray], ...] = ()


@dataclass(frozen=True)
class LinearisedStep:
    """The mechanics of a converged step: u, theta of the mechanics, states before and after, factor of its tangent and, under displacement
    control, the stiffness (n_el, 24, 24) itself.

    `kept`: the factor was formed near the state, not at it.
    """

    u: np.ndarray
    theta: np.ndarray
    before: np.ndarray
    after: np.ndarray
    factor: Factor | None = None
    stiffness: np.ndarray | None = None
    kept: bool = False

    def solve(self, right: np.ndarray) -> np.ndarray:
        """K^-1 of nodal loads (n_eq, m)."""
        if self.factor is None:
            raise NumericsError("sensitivities: a step came without the factor of its tangent")
        return self.factor.solve(right)

    def elements(self, which: np.ndarray) -> np.ndarray:
        """Stiffness (n, 24, 24) of some elements."""
        if self.stiffness is None:
            raise NumericsError("sensitivities: a step under displacement control came without its stiffness")
        return self.stiffness[which]

    @cached_property
    def largest_increment(self) -> float:
        """Largest dLambda of the step."""
        return float(np.max(self.after[:, :, LAMBDA] - self.before[:, :, LAMBDA]))


@dataclass(frozen=True)
class StepEnds:
    """What the heat equation of a step knew: histories and u at both ends, theta in its thermoelastic term (that of the middle) and at its
    start, and its solution."""

    before: PointStates
    after: PointStates
    u: tuple[np.ndarray, np.ndarray]
    theta: tuple[np.ndarray, np.ndarray]
    step: HeatStep
