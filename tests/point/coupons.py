"""Parameters and programmes of coupons for the tests of the point driver."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointSettings, Programme

SHEET = Parameters.of(
    {
        **{"E": 68396.66, "nu": 0.34, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "F": 0.35},
        **{"alpha_exp": 20.21e-6, "kappa": 133.45, "c0": 2.22, "beta": 0.79},
        **{"theta_air": 296.7, "theta_clamp": 296.7, "theta_ref": 296.7},
    }
)
"""The sheet of the reference solution; adiabatic, since tau is neutral."""
LOSSY = SHEET.replace(tau=70.0, lag=0.8, H_lin=40.0, theta_air=297.3, F=0.42, G=0.55, H=0.47)
WHOLE = PointSettings(max_strain=1.0)
"""Every interval in one step."""


def corners(*points: tuple[float, float], steps: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Time and value along straight lines between corners (time, value), each line in the same number of steps."""
    time, value = np.array(points).T
    at = np.linspace(0.0, len(points) - 1.0, steps * (len(points) - 1) + 1)
    index = np.arange(len(points), dtype=float)
    return np.interp(at, index, time), np.interp(at, index, value)


CYCLES = ((0.0, 0.0), (30.0, 0.012), (32.0, 0.006), (50.0, -0.011), (60.0, 0.018), (90.0, 0.018), (95.0, -0.02), (140.0, 0.03))


def cycles(steps: int = 12, theta_start: float | None = None) -> Programme:
    """Strain cycles of growing amplitude with partial unloading, a change of rate and a hold."""
    return Programme.by_strain(*corners(*CYCLES, steps=steps), theta_start)
