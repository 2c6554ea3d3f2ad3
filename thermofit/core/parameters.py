"""Param and Parameters: one number of the law, and the named vector of all of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import StudyError


@dataclass(frozen=True)
class Param:
    """One number of the law: `neutral` switches it off where that is possible, `scale` is its usual size.

    `lower` and `upper` are the physical bounds: a study may narrow them, never widen them.
    """

    name: str
    unit: str
    neutral: float
    lower: float
    upper: float
    scale: float
    meaning: str


_INF = float("inf")

LAW: tuple[Param, ...] = (
    Param("E", "MPa", 69000.0, 1.0, 1e7, 7e4, "Young's modulus"),
    Param("nu", "1", 0.33, 0.0, 0.499, 0.3, "Poisson's ratio"),
    Param("M_y0", "MPa", 130.0, 1e-3, 1e5, 1e2, "initial yield limit (4.19)"),
    Param("M_yinf", "MPa", 290.0, 1e-3, 1e5, 3e2, "exponential hardening limit (4.6), (4.28)"),
    Param("H_exp", "1", 11.0, 1e-3, 1e4, 1e1, "exponential saturation speed (4.6), (4.27)"),
    Param("H_lin", "MPa", 0.0, 0.0, 1e5, 1e2, "linear hardening modulus (4.6)"),
    Param("F", "1", 0.5, 1e-3, 1e2, 0.5, "Hill parameter of (M11 - M22)^2 (4.19)"),
    Param("G", "1", 0.5, 1e-3, 1e2, 0.5, "Hill parameter of (M33 - M11)^2 (4.19)"),
    Param("H", "1", 0.5, 1e-3, 1e2, 0.5, "Hill parameter of (M22 - M33)^2 (4.19)"),
    Param("L", "1", 1.5, 1e-3, 1e2, 1.5, "Hill parameter of M12 (4.19)"),
    Param("M", "1", 1.5, 1e-3, 1e2, 1.5, "Hill parameter of M23 (4.19)"),
    Param("N", "1", 1.5, 1e-3, 1e2, 1.5, "Hill parameter of M13 (4.19)"),
    Param("alpha_exp", "1/K", 0.0, 0.0, 1e-3, 2e-5, "thermal expansion coefficient (4.4)"),
    Param("kappa", "mW/(mm K)", 150.0, 1e-3, 1e5, 1.5e2, "thermal conductivity (4.12)"),
    Param("c0", "mJ/(mm^3 K)", 2.4, 1e-3, 1e2, 2.0, "heat capacity at constant elastic deformation (4.3)"),
    Param("beta", "1", 1.0, 0.0, 1e2, 1.0, "dissipation factor (4.5), not a Taylor-Quinney factor"),
    Param("alpha_air", "W/(m^2 K)", 0.0, 0.0, 1e5, 1e1, "film coefficient to the air (4.13)"),
    Param("alpha_clamp", "W/(m^2 K)", 1e8, 0.0, 1e9, 1e2, "contact coefficient to the jaws (4.13)"),
    Param("theta_air", "K", 297.0, 200.0, 1000.0, 1.0, "air temperature (4.13)"),
    Param("theta_clamp", "K", 297.0, 200.0, 1000.0, 1.0, "jaw temperature (4.13)"),
    Param("theta_ref", "K", 297.0, 200.0, 1000.0, 1.0, "stress-free reference temperature theta_0 (4.3)"),
    Param("tau", "s", 1e12, 1e-3, 1e12, 1e2, "time constant of the heat loss of a coupon"),
    Param("lag", "s", 0.0, 0.0, 1e3, 1.0, "time constant of the temperature sensor on a coupon"),
)

NAMES: tuple[str, ...] = tuple(param.name for param in LAW)
_BY_NAME = {param.name: param for param in LAW}


def param(name: str) -> Param:
    """The Param of that name; StudyError where there is none."""
    try:
        return _BY_NAME[name]
    except KeyError:
        raise StudyError(f"parameter '{name}' is not known; known are {', '.join(NAMES)}") from None


@dataclass(frozen=True)
class Parameters:
    """Named vector of all Params and which are free. Immutable: `replace` returns a new one."""

    values: Mapping[str, float]
    free: tuple[str, ...] = ()

    @staticmethod
    def of(values: Mapping[str, float], free: Iterable[str] = ()) -> Parameters:
        """Parameters from given values; what is not given is neutral. StudyError for an unknown name."""
        for name in (*values, *free):
            param(name)
        full = {p.name: float(values.get(p.name, p.neutral)) for p in LAW}
        return Parameters(full, tuple(free))

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def replace(self, **changes: float) -> Parameters:
        """A copy with some values changed."""
        return Parameters.of({**self.values, **changes}, self.free)

    def with_free(self, free: Iterable[str]) -> Parameters:
        """A copy with other free names."""
        return Parameters.of(self.values, free)

    def vector(self) -> np.ndarray:
        """Values of the free parameters, in the order of `free`, shape (n_free,)."""
        return np.array([self.values[name] for name in self.free])

    def with_vector(self, x: np.ndarray) -> Parameters:
        """A copy with the free values taken from x, shape (n_free,)."""
        return self.replace(**{name: float(v) for name, v in zip(self.free, x, strict=True)})
