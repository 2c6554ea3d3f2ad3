"""What the thermal sensor of a coupon shows of the temperature that the model gives it: effects of slot sensor, record by record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import Effect
from thermofit.effects.scene import Scene
from thermofit.experiment.coupon_records import CouponTest
from thermofit.observe.stations import chain, scene_of, seen, seen_along

SENSOR = ("sensor",)


def sensor_scene(test: CouponTest) -> Scene:
    """The one point that a sensor on a coupon looks at."""
    n = len(test.time)
    scene = scene_of(test.time, np.zeros((1, 2)), np.zeros((n, 1, 2)), test.stress, test.theta_air)
    return replace(scene, name=test.name)


def shown(theta: np.ndarray, test: CouponTest, parameters: Parameters) -> np.ndarray:
    """What is shown (n,) of a temperature history (n,), K."""
    links = chain(SENSOR, parameters)
    return theta if not links else seen(theta[:, None], sensor_scene(test), links, parameters)[:, 0]


def shown_rates(
    theta: np.ndarray, rates: np.ndarray, test: CouponTest, parameters: Parameters, names: tuple[str, ...], of_sensor: Sequence[Effect]
) -> np.ndarray:
    """Derivatives (n, n_p) of what is shown by names; `rates` (n, n_body) are those of theta by the names that are not of `of_sensor`,
    the effects of the sensor, in order."""
    links = chain(SENSOR, parameters)
    scene, field, out = sensor_scene(test), theta[:, None], np.zeros((len(theta), len(names)))
    at = 0
    for k, name in enumerate(names):
        own = [e for e in of_sensor if name in e.names]
        if not own:
            slope = rates[:, at]
            at += 1
            out[:, k] = slope if not links else seen_along(field, slope[:, None], scene, links, parameters)[:, 0]
        else:
            here = tuple(e for e in of_sensor if e in links or e in own)
            out[:, k] = seen_along(field, np.zeros_like(field), scene, here, parameters, name)[:, 0]
    return out
