"""Test programmes of a coupon by name, for the comparison of what each of them can tell: paths of strain over time.

Every programme is a function of its largest strain and of its usual strain rate, made of straight legs. A leg ends at a strain, or at a
stress where the strain is not known before (to unload is to go to no stress). All are cut to about as many samples, so that none
tells more than another because it is sampled more often.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.point.driver import DEFAULTS, PointSettings, Programme, simulate

SAMPLES = 240
"""Samples of a programme."""
FASTER = 20.0
"""Jump of the strain rate in stepped rates."""
REST = 120.0
"""s; rest under no stress, in which the specimen cools."""
WARMER = 40.0
"""K; by how much the second start of `two temperatures` is above the first."""
_LEAST_SAMPLES = 8
_UNLOADING = 0.15
"""Time of an unloading, as a part of that of the largest strain at the usual rate."""


@dataclass(frozen=True)
class Leg:
    """A straight part of a programme: how long it takes in s, the value at its end, and whether that is a stress in MPa, else a nominal
    strain."""

    seconds: float
    to: float
    is_stress: bool = False


@dataclass(frozen=True)
class Named:
    """A programme by name: what it is in words, its legs for a largest strain and a rate in 1/s, and by how many kelvin its start is
    above that of the others."""

    name: str
    words: str
    legs: Callable[[float, float], tuple[Leg, ...]]
    warmer: float = 0.0


def _monotonic(peak: float, rate: float) -> tuple[Leg, ...]:
    return (Leg(peak / rate, peak),)


def _unload(peak: float, rate: float) -> Leg:
    return Leg(_UNLOADING * peak / rate, 0.0, is_stress=True)


def _load_unload(peak: float, rate: float) -> tuple[Leg, ...]:
    half = 0.5 * peak / rate
    return Leg(half, 0.5 * peak), _unload(peak, rate), Leg(half + 0.2 * half, peak), _unload(peak, rate)


def _load_unload_cool(peak: float, rate: float) -> tuple[Leg, ...]:
    return *_load_unload(peak, rate), Leg(REST, 0.0, is_stress=True)


def _stepped_rates(peak: float, rate: float) -> tuple[Leg, ...]:
    part = peak / 4.0
    slow, fast = part / rate, part / (FASTER * rate)
    return Leg(slow, part), Leg(fast, 2.0 * part), Leg(slow, 3.0 * part), Leg(fast, peak)


def _cycles(peak: float, rate: float) -> tuple[Leg, ...]:
    legs, at = [], 0.0
    for strain in (0.5 * peak, -0.5 * peak, peak, -peak, peak):
        legs.append(Leg(abs(strain - at) / rate, strain))
        at = strain
    return tuple(legs)


def _hold(peak: float, rate: float) -> tuple[Leg, ...]:
    half = 0.5 * peak / rate
    return Leg(half, 0.5 * peak), Leg(REST, 0.5 * peak), Leg(half, peak), Leg(REST, peak)


PROGRAMMES: tuple[Named, ...] = (
    Named("monotonic", "pull at one rate", _monotonic),
    Named("load-unload", "pull, unload half way and at the end", _load_unload),
    Named("load-unload-cool", f"pull, unload half way and at the end, and rest {REST:g} s without load", _load_unload_cool),
    Named("stepped-rates", f"pull, the rate {FASTER:g} times larger in every second quarter", _stepped_rates),
    Named("cycles", "two cycles of strain in tension and compression, the second twice as large", _cycles),
    Named("hold", f"pull, hold the strain for {REST:g} s half way and at the end", _hold),
    Named("warm", f"pull at one rate, {WARMER:g} K above the others", _monotonic, WARMER),
)
"""All programmes, the simplest first."""
NAMES: tuple[str, ...] = tuple(p.name for p in PROGRAMMES)


def named(name: str) -> Named:
    """The programme of that name; StudyError where there is none."""
    for p in PROGRAMMES:
        if p.name == name:
            return p
    raise StudyError(f"test programme '{name}' is not known; expected one of {', '.join(NAMES)}")


@dataclass(frozen=True)
class Usual:
    """What programmes have in common: the largest nominal strain, the usual strain rate in 1/s, and the temperature at the start in K."""

    peak: float
    rate: float
    theta_start: float

    def check(self) -> None:
        """StudyError for values that cannot be meant."""
        if not (0.0 < self.peak < 1.0) or not self.rate > 0.0:
            raise StudyError(
                f"test programmes: peak strain {self.peak:g} and rate {self.rate:g} 1/s; expected 0 < peak < 1, a rate above 0"
            )


def programme(name: str, usual: Usual, parameters: Parameters, settings: PointSettings = DEFAULTS, samples: int = SAMPLES) -> Programme:
    """The programme of that name in about `samples` samples, dealt out to its legs half by duration and half evenly.

    A leg to a stress after one to a strain, or the other way round, begins where a coupon with these parameters stands. StudyError for an
    unknown name; NumericsError where the coupon cannot be driven so.
    """
    which = named(name)
    usual.check()
    legs = which.legs(usual.peak, usual.rate)
    whole = sum(leg.seconds for leg in legs)
    made = Programme(np.zeros(1), np.zeros(1), np.zeros(1, dtype=bool), usual.theta_start + which.warmer)
    before = Leg(0.0, 0.0, legs[0].is_stress)
    for leg in legs:
        n = max(_LEAST_SAMPLES, round(samples * 0.5 * (leg.seconds / whole + 1.0 / len(legs))))
        part = np.arange(1, n + 1) / n
        start = before.to if leg.is_stress == before.is_stress else _reached(made, parameters, settings, leg.is_stress)
        made = Programme(
            np.append(made.time, made.time[-1] + part * leg.seconds),
            np.append(made.value, start + part * (leg.to - start)),
            np.append(made.by_stress, np.full(n, leg.is_stress)),
            made.theta_start,
        )
        before = leg
    return made


def _reached(made: Programme, parameters: Parameters, settings: PointSettings, stress: bool) -> float:
    """Nominal stress (MPa), else strain, at the end of what is made so far."""
    history = simulate(parameters, made, settings)
    return float((history.stress if stress else history.strain)[-1])
