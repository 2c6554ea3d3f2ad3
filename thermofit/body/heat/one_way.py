"""One-way heat run: the heat equation on a mechanical history that is known, and its derivatives.

Everything that depends on the deformation alone is formed once and serves every set of thermal parameters: the matrices of every
step, of films their non-zeros only, and the changes of the points. Sources and steps are those of the coupled march.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from thermofit.body.body import Body, ThermalGeometry, thermal_geometry
from thermofit.body.heat.conduction import HeatConditions, HeatStep, at_constant_stress, heat_step, steady_temperature
from thermofit.body.heat.equation import Increment, PointStates, add_released_heat
from thermofit.body.heat.films import conditions_of
from thermofit.body.heat.sources import source_heat
from thermofit.body.heat.structure import structure_heat
from thermofit.body.sensitivity.conduction_rates import add_effect_sources, condition_rates, heat_step_rates, steady_rates
from thermofit.body.sensitivity.heat_rates import frozen_source_rates, source_law
from thermofit.body.solve.march import History, MarchSettings
from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.law.page import Law, law_in_step, law_of
from thermofit.law.page_rates import directions


@dataclass(frozen=True)
class HeatProblem:
    """A mechanical history prepared for many heat runs; entry n of the arrays of steps is of the step from time n to n + 1.

    `conduction` (n_steps, n_slots) and per film set `film` (n_steps, n) at the slots `film_slots` (n,) and `film_area`
    (n_steps, n_np) are ThermalGeometry's; `increments` the changes of the points.
    """

    body: Body
    time: np.ndarray
    rest: ThermalGeometry
    conduction: np.ndarray
    film_slots: Mapping[str, np.ndarray]
    film: Mapping[str, np.ndarray]
    film_area: Mapping[str, np.ndarray]
    increments: tuple[Increment, ...]
    settings: MarchSettings
    points: tuple[PointStates, ...] = ()
    """Those at all times, where effects change the local update itself."""

    def ends(self, n: int) -> tuple[PointStates, PointStates] | None:
        """Points at both ends of the step from time n to n + 1, where effects change the local update itself."""
        return (self.points[n], self.points[n + 1]) if self.points else None

    def geometry(self, n: int) -> ThermalGeometry:
        """Geometry of the step from time n to n + 1."""
        film = {}
        for name, slots in self.film_slots.items():
            film[name] = np.zeros(self.body.thermal.n_slots)
            film[name][slots] = self.film[name][n]
        return ThermalGeometry(self.conduction[n], film, {name: area[n] for name, area in self.film_area.items()})


def heat_problem(body: Body, history: History, settings: MarchSettings) -> HeatProblem:
    """HeatProblem of a march that kept its points, with its settings; StudyError where it did not."""
    if len(history.points) != len(history.time):
        raise StudyError("one-way heat run: the mechanical history holds no point histories; run the march with keep_points")
    n_steps, n_nodes = len(history.time) - 1, body.mesh.n_nodes
    film_slots = {name: np.unique(slot[slot >= 0]) for name, slot in body.film_slot.items()}
    conduction = np.empty((n_steps, body.thermal.n_slots))
    film = {name: np.empty((n_steps, len(slots))) for name, slots in film_slots.items()}
    area = {name: np.empty((n_steps, n_nodes)) for name in film_slots}
    for n, (before, after) in enumerate(pairwise(thermal_geometry(body, u) for u in history.u)):
        mean = before.mean_with(after)
        conduction[n] = mean.conduction
        for name, slots in film_slots.items():
            film[name][n], area[name][n] = mean.film[name][slots], mean.film_area[name]
    rest = thermal_geometry(body, np.zeros_like(history.u[0]))
    kept = history.points if history.points[0].structure.size else ()
    return HeatProblem(body, history.time, rest, conduction, film_slots, film, area, _increments(history.points), settings, kept)


def _increments(points: tuple[PointStates, ...]) -> tuple[Increment, ...]:
    """Changes between all times; ln J / J of a time is kept once."""
    g = [np.log(p.dilatation) / p.dilatation for p in points]
    return tuple(
        Increment(g[n], g[n + 1], before.alpha, after.alpha, after.accumulated - before.accumulated, after.accumulated)
        for n, (before, after) in enumerate(pairwise(points))
    )


def _law_and_conditions(problem: HeatProblem, parameters: Parameters) -> tuple[Law, HeatConditions]:
    settings = problem.settings
    law = law_of(parameters, settings.model, closed_form=settings.closed_form, plastic=settings.plastic)
    first = float(problem.time[0])
    conditions = conditions_of(problem.body, parameters, settings.films).at(first, first, np.empty(0))
    return law, at_constant_stress(conditions, law) if settings.coupling == "one-way" else conditions


@dataclass(frozen=True)
class _Solved:
    """A step of a heat run: its number, what it gave, the temperature of its thermoelastic term and at its start, and the extrapolation in
    time that made the former."""

    number: int
    step: HeatStep
    middle: np.ndarray
    theta_n: np.ndarray
    reach: float


def _steps(problem: HeatProblem, law: Law, conditions: HeatConditions, theta: np.ndarray) -> Iterator[_Solved]:
    """All steps from the temperature theta (n_np,) K on.

    The thermoelastic term takes the temperature at the start of the step, extrapolated to its middle.
    """
    body, scheme, before, first = problem.body, problem.settings.heat_scheme, theta, float(problem.time[0])
    dt = np.diff(problem.time)
    for n, increment in enumerate(problem.increments):
        reach = 0.5 * float(dt[n] / dt[max(n - 1, 0)])
        middle = theta + reach * (theta - before)
        heat = np.zeros(body.mesh.n_nodes)
        in_step, ends = law_in_step(law, float(dt[n])), problem.ends(n)
        add_released_heat(body.data, increment, middle, in_step, heat)
        if ends is not None:
            structure_heat(body.data, *ends, middle, theta, in_step, heat)
        here, flow = conditions.at(first, float(problem.time[n]), middle), (increment.accumulated - increment.d_lambda, increment.d_lambda)
        source = source_heat(body, here.effects, flow, here.moment, float(dt[n]))
        step = heat_step(body, problem.geometry(n), here, theta, heat if source is None else heat + source, (float(dt[n]), scheme))
        before, theta = theta, step.theta
        yield _Solved(n, step, middle, before, reach)


def heat_run(problem: HeatProblem, parameters: Parameters) -> np.ndarray:
    """Temperature K (n_t, n_np) at all times of the history for given parameters; the mechanics stays as it was."""
    law, conditions = _law_and_conditions(problem, parameters)
    theta = np.empty((len(problem.time), problem.body.mesh.n_nodes))
    theta[0] = steady_temperature(problem.body, problem.rest, conditions)
    for solved in _steps(problem, law, conditions, theta[0]):
        theta[solved.number + 1] = solved.step.theta
    return theta


Collect = Callable[[int, np.ndarray, np.ndarray], None]


def heat_run_rates(
    problem: HeatProblem, parameters: Parameters, names: Sequence[str], collect: Collect, others: Sequence[Mapping[str, float]] = ()
) -> None:
    """`heat_run` with its exact derivatives by the named parameters, the mechanics staying as it was.

    `collect(n, theta, rates)` takes temperature (n_np,) K and its rates (n_np, m) at time n, m the number of names filled up to a
    multiple of LANES; it must copy what it keeps. `others`: see `condition_rates`.
    """
    body, settings = problem.body, problem.settings
    law, conditions = _law_and_conditions(problem, parameters)
    along = source_law(law, directions(parameters, names, law))
    rates = condition_rates(parameters, names, law if settings.coupling == "one-way" else None, others)
    rates = rates.on_sets(tuple(conditions.films), tuple(settings.films))
    theta = steady_temperature(body, problem.rest, conditions)
    theta_rates = steady_rates(body, problem.rest, conditions, theta, rates)
    collect(0, theta, theta_rates)
    before_rates = theta_rates
    for solved in _steps(problem, law, conditions, theta):
        middle_rates = theta_rates + solved.reach * (theta_rates - before_rates)
        heat_rates = np.zeros_like(theta_rates)
        sources = along.in_step(float(problem.time[solved.number + 1] - problem.time[solved.number]))
        temperature, ends = ((solved.middle, middle_rates), (solved.theta_n, theta_rates)), problem.ends(solved.number)
        frozen_source_rates(body.data, problem.increments[solved.number], temperature, sources, heat_rates, ends)
        here = rates.about(middle_rates)
        increment = problem.increments[solved.number]
        flow = (increment.accumulated - increment.d_lambda, increment.accumulated)
        add_effect_sources(body, solved.step, here, flow, None, heat_rates)
        before_rates, theta_rates = theta_rates, heat_step_rates(body, solved.step, theta_rates, heat_rates, here, None)
        collect(solved.number + 1, solved.step.theta, theta_rates)
