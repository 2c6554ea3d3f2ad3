"""Heat of a transformation that runs over a window of plastic strain: slot heat_source. Off at heat = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "heat_source"
_CENTRES = (0.05, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95)
PARAMS = (
    Param("latent_heat.heat", "mJ/mm^3", 0.0, -1e5, 1e5, 20.0, "heat per unit of plastic strain in the middle of the window", probe=50.0),
    Param("latent_heat.centre", "1", 0.02, 0.0, 2.0, 0.01, "middle of the window of Lambda", scan=_CENTRES, scan_of="strain"),
    Param("latent_heat.width", "1", 0.02, 1e-4, 2.0, 0.01, "width of the window at half its height", scan=(0.12, 0.3), scan_of="strain"),
    Param("latent_heat.rounding", "1", 0.1, 0.02, 0.56, 0.1, "how round its ends are, in widths", scan=(0.1,), follows=True, limiting=True),
)
FORMULA = "r += heat window(Lambda) dLambda/dt; window(centre) = 1, window(centre +- width / 2) = 1/2"
SOURCE = (
    "strain-induced martensite, Olson and Cohen 1975, Metallurgical Transactions A 6; from a window with sharp ends to, at rounding 0.56, "
    "the rate of a logistic transformation"
)


def heat_source(
    theta: np.ndarray,
    accumulated: np.ndarray,
    rate: np.ndarray,
    time: float,
    x: np.ndarray,
    y: np.ndarray,
    heat: float,
    centre: float,
    width: float,
    rounding: float,
) -> np.ndarray:
    """Power heat window(Lambda) dLambda/dt, mW/mm^3, with e = rounding width and cosh(2 s / e) = cosh(1 / rounding) - 2:

        window = [tanh((Lambda - centre + s) / e) - tanh((Lambda - centre - s) / e)] / (2 tanh(s / e)).

    In total heat 2 s / tanh(s / e) where the window lies between 0 and the largest Lambda: heat width with sharp ends.
    """
    if not np.any(rate):
        return np.asarray(heat * rate + 0.0 * accumulated)
    inside, edge = accumulated - centre, rounding * width
    half = 0.5 * edge * np.arccosh(np.cosh(1.0 / rounding) - 2.0)
    window = 0.5 * (np.tanh((inside + half) / edge) - np.tanh((inside - half) / edge)) / np.tanh(half / edge)
    return np.asarray(heat * window * rate)
