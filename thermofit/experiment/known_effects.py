"""Effects of the catalogue that a test can show at all, by what drives its law and what looks at it."""

from __future__ import annotations

import numpy as np

from thermofit.effects.catalogue import AXIAL, BASE, HEAT, HEATING, KINEMATICS, LOAD, Effect, effects
from thermofit.experiment.coupon_sensor import SENSOR
from thermofit.experiment.fields import Measured
from thermofit.law.composition import FACTORS, STRUCTURE, SUMS, capacity_effects
from thermofit.law.surface.catalogue import DEFAULT, HILL, surface
from thermofit.observe.stations import INFRARED
from thermofit.point.driver import air_effects

ON_POINT = ("linear_hardening", "thermal_expansion")
"""Effects of the base law that the point driver feels."""

BOTH_SENSES = 0.25
"""Part of the largest load that the load of the other sense has to reach for tension and compression to be told apart."""
ASYMMETRY = "asymmetry"
"""Slot of effects that tell them apart."""


def effects_of_data(data: Measured, yields: str) -> tuple[Effect, ...]:
    """Effects that the cameras of a test show, with the yield surface of that name."""
    return effects_of_fields(
        displacements=data.displacement is not None, infrared=data.temperature is not None, yields=yields, turns=load_turns(data)
    )


def load_turns(data: Measured) -> bool:
    """Whether a specimen is pulled and pushed."""
    force = data.steps["all"].force
    return bool(min(np.max(force), -np.min(force)) > BOTH_SENSES * np.max(np.abs(force)))


def effects_of_fields(*, displacements: bool = True, infrared: bool, yields: str = DEFAULT, turns: bool = True) -> tuple[Effect, ...]:
    """Effects that a specimen under cameras shows. Without an infrared one nothing is measured that the heat balance alone feels; without
    displacements nothing tells a mechanism of motion, load or DIC from one of heat, and those alone are asked that act in the heat equation
    or the infrared camera. It is not asked for what only temperatures far apart can tell, nor for Params of another yield surface than that
    of the name `yields`. Where the load never `turns` to the other sense, shear in shoulders alone would tell tension from compression, and
    the difference is a yield stress by another name."""
    if not displacements:
        return tuple(e for e in effects((*HEATING, *INFRARED)) if not e.span)
    slots = (*BASE, *SUMS, *FACTORS, *STRUCTURE, *(HEAT if infrared else ()), *LOAD, *KINEMATICS, *(INFRARED if infrared else ()), "camera")
    foreign = set(HILL) - set(surface(yields).names)
    known = [e for e in effects(slots) if not e.span and (infrared or e.slot not in HEATING) and not foreign & set(e.names)]
    return tuple(e for e in known if turns or e.slot != ASYMMETRY)


def effects_of_point(*, sensor: bool, row: bool = False) -> tuple[Effect, ...]:
    """Effects that the point driver shows; without a sensor of its temperature nothing is measured that the heat balance alone feels. A row
    of points has places."""
    base = tuple(e for e in effects(BASE) if e.name in ON_POINT)
    heat = (*air_effects(), *capacity_effects()) if sensor else ()
    return (*base, *effects((*SUMS, *FACTORS, *STRUCTURE)), *heat, *effects(SENSOR if sensor else ()), *effects(AXIAL if row else ()))
