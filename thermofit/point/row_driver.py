"""Drive a row of material points through a history of its mean strain: histories of all sections, and derivatives by any parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import AXIAL, effects
from thermofit.law.bounds import check_beta
from thermofit.law.page_rates import STEP
from thermofit.point.driver import CHANNELS, DEFAULTS, PointHistory, PointRates, PointSettings, Programme, run_numbers
from thermofit.point.row import run_row
from thermofit.point.solve import AIR, N_ALL, START, Limits
from thermofit.point.step import N_STATE, STATE


@dataclass(frozen=True)
class RowProgramme:
    """What a row is driven by: increasing `time` s (n_t,) and `mean` (n_t,), the nominal strain of its sections weighted by `weight`
    (n_s,), whose sum is one; `place` mm (n_s,) along the axis, and `area` (n_s,), cross-sections over a common one."""

    time: np.ndarray
    mean: np.ndarray
    weight: np.ndarray
    place: np.ndarray
    area: np.ndarray


def axial_temperatures(parameters: Parameters, names: Sequence[str], place: np.ndarray, declared: float) -> tuple[np.ndarray, np.ndarray]:
    """Temperature (n_s,) K of sections at `place` mm, where `declared` K is that of the hottest, by all effects of the axis, and its
    derivatives (n_s, n_p) by the named parameters, by complex step. The jaws have theta_clamp."""
    excess = declared - parameters["theta_clamp"]
    theta, along = np.full(len(place), declared), np.zeros((len(place), len(names)))
    for e in effects(AXIAL):
        values = [parameters[name] for name in e.names]
        if e.is_on(parameters):
            theta = theta + np.real(e.act(place, excess, *values))
        for k, name in enumerate(names):
            if name in e.names:
                moved = [complex(v, STEP * (n == name)) for n, v in zip(e.names, values, strict=True)]
                along[:, k] = np.imag(e.act(place, excess, *moved)) / STEP
    return theta, along


def simulate_row(
    parameters: Parameters, names: Sequence[str], programme: RowProgramme, declared: float, settings: PointSettings = DEFAULTS
) -> tuple[list[PointHistory], list[PointRates]]:
    """Histories of all sections of a row whose hottest one is declared to have `declared` K, and their derivatives by the named parameters.

    Every section begins at its own temperature, which the heating holds: it exchanges heat with surroundings of that temperature. What
    `theta_air` says is not asked. StudyError, NumericsError as `simulate`.
    """
    names = tuple(names)
    Programme.by_strain(programme.time, programme.mean).check()
    check_beta(parameters)
    n_t, n_s, n_p = len(programme.time), len(programme.place), len(names)
    theta, warmed = axial_temperatures(parameters, names, programme.place, declared)
    numbers, along = np.zeros((n_s, N_ALL)), np.zeros((n_s, N_ALL, n_p + 1))
    numbers[:], along[:, :, :n_p], flags = run_numbers(parameters, names, Programme.by_strain(programme.time, programme.mean), settings)
    for place in (AIR, START):
        numbers[:, place], along[:, place, :n_p] = theta, warmed
    states, rates, counts = np.zeros((n_t, n_s, N_STATE)), np.zeros((n_t, n_s, N_STATE, n_p + 1)), np.zeros(2, dtype=np.int64)
    time, mean, weight, area = (
        np.ascontiguousarray(v, dtype=float) for v in (programme.time, programme.mean, programme.weight, programme.area)
    )
    limits = Limits(float(settings.max_strain), int(settings.max_cuts))
    failed = run_row(time, mean, weight, area, numbers, along, flags, limits, states, rates, counts)
    if failed >= 0:
        raise NumericsError(
            f"row of sections: the mean strain {mean[failed]:g} at {time[failed]:g} s is not reached after {settings.max_cuts} halvings of "
            "the step; check the record there, and whether these parameters can reach it"
        )
    histories, slopes = [], []
    for i in range(n_s):
        own = np.ascontiguousarray(states[:, i])
        channels = {name: np.ascontiguousarray(own[:, STATE.index(name)]) for name in CHANNELS}
        cost = {"steps": int(counts[0]), "halvings": int(counts[1]), "newton_iterations": 0}
        histories.append(PointHistory(time=time, states=own, counts=cost, **channels))
        slopes.append(PointRates(names, np.ascontiguousarray(rates[:, i, :, :n_p])))
    return histories, slopes
