"""What effects act on, in words: why a coupon, which has one strain, one stress and one temperature, does not feel them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermofit.effects.catalogue import BASE, HEAT, KINEMATICS, LOAD, MEASUREMENT, Effect, effect
from thermofit.observe.stations import CAMERA

DISPLACEMENT, TEMPERATURE = "the field of displacement", "the field of temperature"
FORCE, MACHINE = "the channel of force", "the machine between crosshead and specimen"
_BASE = {"hill_anisotropy": DISPLACEMENT}
"""What mechanisms of the base law act on that is not a field of temperature."""


def acts_on(e: Effect) -> str:
    """What an effect acts on, in words; of an effect of the load the record that it changes."""
    if e.slot in LOAD:
        values = (float(p.probe or p.neutral) for p in e.params)
        force, _ = e.act(np.ones(2), np.zeros(2), *values)
        return FORCE if np.any(force != 1.0) else MACHINE
    if e.slot in BASE:
        return _BASE.get(e.name, TEMPERATURE)
    if e.slot in (*KINEMATICS, *CAMERA):
        return DISPLACEMENT
    return TEMPERATURE if e.slot in (*HEAT, *MEASUREMENT) else "the material"


def acted_on(names: Sequence[str]) -> str:
    """Names of effects, each group with what it acts on: "lamp and ir_drift, which act on the field of temperature"."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(acts_on(effect(name)), []).append(name)
    return ", nor ".join(f"{' and '.join(own)}, which act{'s' if len(own) == 1 else ''} on {what}" for what, own in groups.items())
