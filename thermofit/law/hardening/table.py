"""A table: yield stresses at given plastic strains, with monotone cubic interpolation; associated, alpha = Lambda.

Between the knots (0, M_y0), (strain_1, stress_1), ... the cubic of Hermite with the slopes of Fritsch and Butland (PCHIP): where the values
rise, the curve rises, and it bends without overshoot. Beyond the last knot it goes on straight.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from thermofit.core.parameters import Param

N = 5
"""Knots beside that of first yield."""
_STRAINS = (0.005, 0.02, 0.05, 0.12, 0.25)
_STRESSES = (140.0, 160.0, 200.0, 247.0, 280.0)
PARAMS = (
    "M_y0",
    *(
        Param(f"table.strain{k}", "1", _STRAINS[k - 1], 1e-6, 10.0, _STRAINS[k - 1], f"plastic strain Lambda of knot {k}, given")
        for k in range(1, N + 1)
    ),
    *(Param(f"table.stress{k}", "MPa", _STRESSES[k - 1], 1e-3, 1e5, 1e2, f"yield stress at knot {k}") for k in range(1, N + 1)),
)
STRAINS = tuple(f"table.strain{k}" for k in range(1, N + 1))
STRESSES = tuple(f"table.stress{k}" for k in range(1, N + 1))
FITTED = ("M_y0", *STRESSES)
NUMBERS = (*STRAINS, *STRESSES, *(f"table.slope{k}" for k in range(N + 1)))
FORMULA = "sigma_y = monotone cubic through (0, M_y0) and (strain_k, stress_k)"
SOURCE = "Fritsch and Butland 1984, SIAM Journal on Scientific and Statistical Computing 5"
ASCENDING = (STRAINS, ("M_y0", *STRESSES))
WHY = "strains and yield stresses of the table must rise"
RAISES = ("M_y0", *STRESSES)
METALS = {"M_y0": (2e2, 1.0, 1e4), **{name: (2e2 + 50.0 * k, 1.0, 2e4) for k, name in enumerate(STRESSES, start=1)}}
MEANING = dict.fromkeys(METALS, "MPa")
_SPREAD = (0.03, 0.1, 0.25, 0.55, 1.0)
"""Shares of the largest strain at which a first guess has its knots."""


def numbers(M_y0: float, *given: float) -> tuple[float, ...]:
    """What the kernels take beside M_y0: strains and stresses as given, and the slopes at all knots in MPa."""
    x, y = (0.0, *given[:N]), (M_y0, *given[N:])
    h = [b - a for a, b in pairwise(x)]
    s = [(b - a) / step for (a, b), step in zip(pairwise(y), h, strict=True)]
    inner = [_between(h[k - 1], h[k], s[k - 1], s[k]) for k in range(1, N)]
    return (*given, _at_end(h[0], h[1], s[0], s[1]), *inner, _at_end(h[-1], h[-2], s[-1], s[-2]))


def _between(h0: float, h1: float, s0: float, s1: float) -> float:
    """Slope at a knot between intervals h0, h1 with secants s0, s1: their weighted harmonic mean, none at a turning point."""
    if s0.real * s1.real <= 0.0:
        return 0.0 * s0
    w0, w1 = 2.0 * h1 + h0, h1 + 2.0 * h0
    return (w0 + w1) / (w0 / s0 + w1 / s1)


def _at_end(h0: float, h1: float, s0: float, s1: float) -> float:
    """Slope at the first or last knot by the parabola through three knots, bounded so that the curve stays monotone."""
    slope = ((2.0 * h0 + h1) * s0 - h0 * s1) / (h0 + h1)
    if slope.real * s0.real <= 0.0:
        return 0.0 * s0
    if s0.real * s1.real <= 0.0 and abs(slope.real) > 3.0 * abs(s0.real):
        return 3.0 * s0
    return slope


def yield_stress(
    alpha: float, M_y0: float,
    x1: float, x2: float, x3: float, x4: float, x5: float,
    y1: float, y2: float, y3: float, y4: float, y5: float,
    d0: float, d1: float, d2: float, d3: float, d4: float, d5: float,
) -> tuple[float, float]:  # fmt: skip
    """Yield stress in MPa and its derivative by alpha: each interval adds what it rises up to alpha, so that nothing is chosen."""
    x, y, d = (0.0 * x1, x1, x2, x3, x4, x5), (M_y0, y1, y2, y3, y4, y5), (d0, d1, d2, d3, d4, d5)
    beyond = alpha - x5
    beyond = 0.5 * (beyond + np.sqrt(beyond * beyond))
    value, slope = M_y0 + d5 * beyond, d0 + 0.0 * alpha
    for k in range(N):
        h = x[k + 1] - x[k]
        s = (y[k + 1] - y[k]) / h
        t = (alpha - x[k]) / h
        t = 0.5 * (t + np.sqrt(t * t))
        t = 0.5 * (t + 1.0 - np.sqrt((t - 1.0) * (t - 1.0)))  # between 0 and 1
        b, c = 3.0 * s - 2.0 * d[k] - d[k + 1], d[k] + d[k + 1] - 2.0 * s
        value = value + h * t * (d[k] + t * (b + t * c))
        slope = slope + t * (2.0 * b + 3.0 * t * c)
    return value, slope


def stored_energy(
    alpha: float, M_y0: float,
    x1: float, x2: float, x3: float, x4: float, x5: float,
    y1: float, y2: float, y3: float, y4: float, y5: float,
    d0: float, d1: float, d2: float, d3: float, d4: float, d5: float,
) -> float:  # fmt: skip
    """Integral of sigma_y - M_y0 in mJ/mm^3: of every interval the quartic up to alpha, then its rise times what lies behind it."""
    x, y, d = (0.0 * x1, x1, x2, x3, x4, x5), (M_y0, y1, y2, y3, y4, y5), (d0, d1, d2, d3, d4, d5)
    beyond = alpha - x5
    beyond = 0.5 * (beyond + np.sqrt(beyond * beyond))
    energy = 0.5 * d5 * beyond * beyond
    for k in range(N):
        h = x[k + 1] - x[k]
        s = (y[k + 1] - y[k]) / h
        t = (alpha - x[k]) / h
        t = 0.5 * (t + np.sqrt(t * t))
        behind = 0.5 * (t - 1.0 + np.sqrt((t - 1.0) * (t - 1.0)))
        t = t - behind
        b, c = 3.0 * s - 2.0 * d[k] - d[k + 1], d[k] + d[k + 1] - 2.0 * s
        energy = energy + h * h * (t * t * (0.5 * d[k] + t * (b / 3.0 + 0.25 * t * c)) + behind * s)
    return energy


def search(stress: float, strain: float) -> dict[str, tuple[float, float, float]]:
    """Start and bounds by the largest stress of a test in MPa and its largest strain; the knots stay where they are."""
    rise = {name: ((0.7 + 0.1 * k) * stress, 0.02 * stress, 20.0 * stress) for k, name in enumerate(STRESSES, start=1)}
    return {"M_y0": (0.7 * stress, 0.02 * stress, 5.0 * stress), **rise}


def first_guess(accumulated: np.ndarray, stress: np.ndarray) -> dict[str, float]:
    """The curve itself at knots that are denser near first yield, made to rise."""
    end, least = float(accumulated[-1]), 1e-4 * float(np.max(stress))
    knots = [share * end for share in _SPREAD]
    values = [float(stress[0]), *np.interp(knots, accumulated, stress).tolist()]
    for k in range(1, N + 1):
        values[k] = max(values[k], values[k - 1] + least)
    return {"M_y0": values[0], **dict(zip(STRAINS, knots, strict=True)), **dict(zip(STRESSES, values[1:], strict=True))}
