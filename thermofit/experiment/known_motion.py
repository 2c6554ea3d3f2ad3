"""Influence of effects of the heat problem that are off, on the motion of a run that is known.

Temperatures hardly act on the motion (thermal strains of 1e-5 beside plastic ones of 1e-2), so that a heat run answers for everything
that lives in the heat equation, at a tenth of the cost of a coupled one: for many values of the times and exponents of an effect at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermofit.body.heat.one_way import HeatProblem, heat_problem, heat_run_rates
from thermofit.body.solve.history import History
from thermofit.core.parameters import Parameters, bare_name
from thermofit.effects.catalogue import HEATING, Effect, effects
from thermofit.experiment.forward import MechanicalRun
from thermofit.experiment.held import thermal_names
from thermofit.experiment.instruments import Instruments
from thermofit.observe.stations import INFRARED

Direction = tuple[str, Mapping[str, float]]
"""A Param along which a derivative is taken, and values of the other Params of its effect, which is off."""


def acts_in_heat(effect: Effect) -> bool:
    """True for an effect that the heat equation alone feels."""
    return effect.slot in HEATING


def acting_on_temperatures(names: Sequence[str]) -> tuple[str, ...]:
    """Those of the named parameters that change temperatures, or what the infrared camera shows of them, on a motion that is known."""
    felt = thermal_names().union(*(e.names for e in effects(INFRARED)))
    return tuple(name for name in names if bare_name(name) in felt)


def keeping_points(run: MechanicalRun) -> MechanicalRun:
    """The same run, whose history serves heat runs on its motion."""
    return replace(run, settings=replace(run.settings, keep_points=True))


def freely_expanding(run: MechanicalRun, history: History) -> HeatProblem:
    """The heat equation on the motion of a history of `run` that kept its points, the specimen expanding freely as it warms.

    Its motion holds the thermal strain of its own temperatures only; the heat that the strain of a change takes enters the heat capacity.
    """
    return heat_problem(run.body, history, replace(run.settings, coupling="one-way"))


def along(
    instruments: Instruments, problem: HeatProblem, history: History, parameters: Parameters, directions: Sequence[Direction]
) -> np.ndarray:
    """Derivatives (n_t, n_s, 1, n) of the temperatures that the camera shows at parameters, on the motion of a history and the heat
    equation `problem` there."""
    look, names = instruments.samplers["theta"], [name for name, _ in directions]
    slopes = np.zeros((len(history.time), instruments.observations["theta"].value.shape[1], len(names)))

    def collect(n: int, _: np.ndarray, rates: np.ndarray) -> None:
        slopes[n] = look.operator.temperature(rates[:, : len(names)].T)[:, :, 0].T

    heat_run_rates(problem, parameters, names, collect, [others for _, others in directions])
    seen = instruments.observations["theta"]
    if not instruments.changes("theta", parameters):
        return seen.averaged(slopes[look.index][:, :, None, :])
    view = instruments.view("theta", history)
    shown = [instruments.shown_along("theta", view, slope, parameters) for slope in np.moveaxis(slopes, -1, 0)]
    return seen.averaged(np.stack(shown, axis=-1))
