"""A source or sink of heat at a place of the specimen, from a time on: slot heat_source. Off at power = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "heat_source"
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)
_FROM_MIDDLE, _SHARES = 0.5 * (1.0 + _NODES), 0.5 * _WEIGHTS
"""Shares of half a width and their weights, for means across it."""
RAMP = 1.0
"""s; half of the time in which one usually reaches its power, from 12 to 88 per cent."""
_PLACES = (0.05, 0.23, 0.41, 0.59, 0.77, 0.95)
_STARTS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85)
PARAMS = (
    Param("local_source.power", "mW/mm^2", 0.0, -1e3, 1e3, 0.2, "power once it is on, per area of the cross-section", probe=0.5),
    Param("local_source.place", "mm", 0.0, -1e3, 1e3, 2.0, "height y of its middle", scan=_PLACES, scan_of="place"),
    Param("local_source.width", "mm", 3.0, 0.5, 1e3, 1.0, "standard deviation along y", scan=(0.06, 0.2), scan_of="length"),
    Param("local_source.start", "s", 30.0, -1e5, 1e5, 5.0, "time of the test from which it is on", scan=_STARTS, scan_of="time"),
    Param(
        "local_source.onset",
        "s",
        RAMP,
        0.05,
        1e4,
        1.0,
        "half of the time in which it comes on",
        scan=(RAMP,),
        follows=True,
        logarithmic=True,
    ),
    Param(
        "local_source.concentration",
        "1",
        0.0,
        -20.0,
        400.0,
        1.0,
        "how it is spread across: square of half the width of the specimen over the standard deviation; 0 evenly, below 0 towards edges",
        scan=(0.0,),
        follows=True,
    ),
)
FORMULA = (
    "r += power / (sqrt(2 pi) width) exp(-((y - place) / width)^2 / 2) h(x) (1 + tanh((t - start) / onset)) / 2, "
    "h = exp(-concentration (x / half width)^2 / 2), over its mean across"
)
SOURCE = "source at a place, Carslaw and Jaeger 1959, chapter X: a warm or cold body that touches the specimen, a spot of light, friction"


def heat_source(
    time: float,
    x: np.ndarray,
    y: np.ndarray,
    across: np.ndarray,
    power: float,
    place: float,
    width: float,
    start: float,
    onset: float,
    concentration: float,
) -> np.ndarray:
    """Power per volume g(y) h(xi) power (1 + tanh((t - start) / onset)) / 2, mW/mm^3, with the normal density along the load and, at
    xi = x over half the width (`across`), the distribution across

        g = exp(-((y - place) / width)^2 / 2) / (sqrt(2 pi) width),   h = exp(-c xi^2 / 2) / int_0^1 exp(-c s^2 / 2) ds,

    c the concentration; the same through the thickness. So `power` is that of the whole section, however it is spread. A band across the
    specimen has c = 0. What a spot in the middle makes falls off across the width by power over (conductivity times thickness), which
    is more than a camera's noise. The body is symmetric: of a spot beside the middle h holds the mean of both sides, and c may be below 0.
    Heat levels out along the specimen. So the data know the whole power far better than how it is spread.
    """
    over_time = 0.5 * (1.0 + np.tanh((time - start) / onset))
    density = np.exp(-0.5 * ((y - place) / width) ** 2) / (np.sqrt(2.0 * np.pi) * width)
    spread = np.exp(-0.5 * concentration * across**2) / np.sum(_SHARES * np.exp(-0.5 * concentration * _FROM_MIDDLE**2))
    return np.asarray(power * density * spread * over_time)
