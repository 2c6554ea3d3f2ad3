"""Heat of a transformation that runs over a window of plastic strain: slot heat_source. Off at heat = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "heat_source"
_CENTRES = (0.05, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95)
PARAMS = (
    Param("latent_heat.heat", "mJ/mm^3", 0.0, -1e5, 1e5, 20.0, "heat set free per unit of plastic strain", probe=50.0),
    Param("latent_heat.centre", "1", 0.02, 0.0, 2.0, 0.01, "middle of the window of Lambda", scan=_CENTRES, scan_of="strain"),
    Param("latent_heat.width", "1", 0.02, 1e-4, 2.0, 0.01, "width of the window", scan=(0.12, 0.3), scan_of="strain"),
    Param("latent_heat.rounding", "1", 0.1, 0.02, 1.0, 0.1, "how round its ends are, in widths", scan=(0.1,), follows=True),
)
FORMULA = "r += heat window(Lambda) dLambda/dt; int window dLambda = width"
SOURCE = (
    "strain-induced martensite, Olson and Cohen 1975, Metallurgical Transactions A 6; from a window with sharp ends to, at rounding 1, "
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
    """Power heat window(Lambda) dLambda/dt, mW/mm^3; heat x width in total where the window lies between 0 and the largest Lambda.

    window = [tanh((Lambda - centre + width/2) / e) - tanh((Lambda - centre - width/2) / e)] / 2 with e = rounding width.
    """
    if not np.any(rate):
        return np.asarray(heat * rate + 0.0 * accumulated)
    inside, edge = accumulated - centre, rounding * width
    window = 0.5 * (np.tanh((inside + 0.5 * width) / edge) - np.tanh((inside - 0.5 * width) / edge))
    return np.asarray(heat * window * rate)
