"""A source or sink of heat at a place of the specimen, from a time on: slot heat_source. Off at power = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "heat_source"
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
)
FORMULA = "r += power / (sqrt(2 pi) width) exp(-((y - place) / width)^2 / 2) (1 + tanh((t - start) / onset)) / 2"
SOURCE = "source at a place, Carslaw and Jaeger 1959, chapter X: a warm or cold body that touches the specimen, a spot of light, friction"


def heat_source(
    time: float,
    x: np.ndarray,
    y: np.ndarray,
    power: float,
    place: float,
    width: float,
    start: float,
    onset: float,
) -> np.ndarray:
    """Power per volume g(y) power (1 + tanh((t - start) / onset)) / 2, mW/mm^3, with the normal density

        g = exp(-((y - place) / width)^2 / 2) / (sqrt(2 pi) width),

    the same through width and thickness: heat levels out across a sheet within seconds, so that a test hardly shows more. Along the
    specimen it levels out as well. So the data know the whole power far better than how it is spread.
    """
    over_time = 0.5 * (1.0 + np.tanh((time - start) / onset))
    density = np.exp(-0.5 * ((y - place) / width) ** 2) / (np.sqrt(2.0 * np.pi) * width)
    return np.asarray(power * density * over_time)
