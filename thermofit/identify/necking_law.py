"""Sections of a necking specimen in equilibrium: from the strain of one to the strains of all others.

Every cross-section carries the same force at the same instant. With isochoric flow F = sigma(s + e) A exp(-e), where e counts from the
first frame, A is the area there and s the strain that the section then has more (or less) than the necking one. All flow in the first
frame, sigma(s) A = F(0), so that with g(x) = ln sigma(x) - x + const:

    g(s + e) - g(s) = g(tau) - g(0),    tau: strain of the necking section (s = 0).

g grows up to the strain x_c where d ln sigma/dx = 1 (Considere, Annales des Ponts et Chaussees 9, 1885) and falls beyond; sections with
s < 0 stop straining when tau reaches it. Only differences of g enter on both sides: the areas being unknown, g times any factor does
equally well. Therefore the rate d ln sigma/dx (0) is prescribed; x_c and the exponent are felt, the size of hardening is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from thermofit.law.hardening.catalogue import hardening

_LAW = hardening("voce")
_GRID = 400
_NEWTON = 8


@dataclass(frozen=True)
class HardeningLaw:
    """sigma/sigma(0) = 1 + R g(x) + H x, hardening law voce with g = 1 - exp(-h x), and linear (M_yinf/M_y0 - 1 = R, H_exp = h,
    H_lin/M_y0 = H), told by the Considere strain `considere`, `exponent` h and the `rate` R h + H > 1/(1 - considere) at x = 0."""

    considere: float
    exponent: float
    rate: float

    @property
    def voce(self) -> float:
        """R = M_yinf/M_y0 - 1."""
        return float(_voce(self.considere, self.exponent, self.rate).real)

    @property
    def linear(self) -> float:
        """H = H_lin/M_y0."""
        return float(self.rate - self.voce * _shape(0.0, self.exponent)[1])

    def stress(self, x: np.ndarray) -> np.ndarray:
        """sigma/sigma(0) at strains (any shape)."""
        return np.asarray(_stress(x, self.considere, self.exponent, self.rate).real)

    def excess(self, x: np.ndarray) -> np.ndarray:
        """g = ln(sigma/sigma(0)) - x."""
        return np.asarray(np.log(self.stress(x)) - x)

    def slope(self, x: np.ndarray) -> np.ndarray:
        """g' = d ln sigma/dx - 1."""
        return np.asarray((self.voce * _shape(x, self.exponent)[1] + self.linear) / self.stress(x) - 1.0)

    def parameter_slopes(self, x: np.ndarray) -> np.ndarray:
        """dg/d(considere, exponent) (2, ...) by complex steps."""
        tiny = 1e-30
        first = np.log(_stress(x, self.considere + 1j * tiny, self.exponent, self.rate)).imag / tiny
        second = np.log(_stress(x, self.considere, self.exponent + 1j * tiny, self.rate)).imag / tiny
        return np.stack([first, second])

    def holds(self, lowest: float) -> bool:
        """Whether the law hardens at the first frame and its stress is positive from the strain `lowest` on."""
        if not (self.considere < 1.0 and self.rate * (1.0 - self.considere) > 1.0):
            return False
        x = np.linspace(min(lowest, 0.0), self.considere, 32)
        return bool(np.all(self.stress(x) > 0.0) and np.all(self.slope(x[:-1]) > 0.0))


def _shape(x: Any, exponent: complex) -> tuple[Any, Any]:
    """g, the hardening law between limits 0 and 1, and its derivative at strains x (any shape)."""
    found: tuple[Any, Any] = _LAW.file.yield_stress(x, *_LAW.number_values({"M_y0": 0.0, "M_yinf": 1.0, "H_exp": exponent}))
    return found


def _voce(considere: complex, exponent: complex, rate: float) -> complex:
    """R such that d sigma/dx = sigma at x = considere, with R g'(0) + H = rate."""
    g, slope = _shape(considere, exponent)
    return complex((1.0 - rate * (1.0 - considere)) / (slope - g - _shape(0.0, exponent)[1] * (1.0 - considere)))


def _stress(x: np.ndarray, considere: complex, exponent: complex, rate: float) -> np.ndarray:
    voce = _voce(considere, exponent, rate)
    linear = rate - voce * _shape(0.0, exponent)[1]
    return np.asarray(1.0 + voce * _shape(x, exponent)[0] + linear * x)


def section_states(law: HardeningLaw, offset: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """x = s + e (n_f, n_s) of sections whose strain in the first frame is `offset` s (n_s,) < 0, while the necking one has tau (n_f,)."""
    target = law.excess(np.minimum(tau, law.considere))[:, None] + law.excess(offset)[None, :]
    grid = np.linspace(min(float(offset.min()), float(tau.min()), 0.0) - 0.02, law.considere, _GRID)
    grid = grid[law.stress(grid) > 0.0]
    values = law.excess(grid)
    # From the grid point below, Newton steps on a concave rising curve come from below and never pass the solution.
    x = grid[np.clip(np.searchsorted(values, target) - 1, 0, len(grid) - 1)]
    for _ in range(_NEWTON):
        slope = np.maximum(law.slope(x), 1e-9)
        x = np.minimum(x + (target - law.excess(x)) / slope, law.considere)
    return x


def held_strain(law: HardeningLaw, offset: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """e (n_f, n_s) with unloading: a section keeps its largest strain once the force has passed its maximum (elastic strain left out)."""
    largest = np.maximum.accumulate(tau)
    return np.asarray(section_states(law, offset, largest) - offset)
