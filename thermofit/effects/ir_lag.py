"""First-order lag of a temperature sensor: slot sensor. Off at time = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param, Parameters
from thermofit.effects.scene import Scene

SLOT = "sensor"
PARAMS = (Param("ir_lag.time", "s", 0.0, 0.0, 60.0, 0.2, "time constant of the sensor", probe=1.0),)
FORMULA = "time d(theta_sensor)/dt = theta - theta_sensor"
SOURCE = "thermal sensor (bolometer, contact sensor) of first order"


def sensor(theta: np.ndarray, scene: Scene, time: float) -> np.ndarray:
    """Response of the sensor to theta (n_t, n_s), K; at rest at the first time."""
    return scene.lagged(theta, time)


def twin(at: Parameters) -> dict[str, float]:
    """The lag that the sensor of a coupon has anyway, in the stead of this one: two in series commute."""
    return {"ir_lag.time": at["lag"], "lag": at["ir_lag.time"]}
