"""Rates of a step of the heat equation and of the steady state along many directions at once (direct differentiation).

With the capacity matrix C, exchange matrix E and inflow q of a step, a stage of the scheme from theta_s solves

    (C + gamma dt E) theta = C theta_s + gamma (h + dt q),

so that its rates follow from the same matrix, whose factor the step has kept:

    (C + gamma dt E) theta' = C theta_s' + C' (theta_s - theta) + gamma [h' - dt (E' theta - q')].

E' theta - q' has a part by the numbers of the heat equation and a part by the motion of the body (`shape_rates`). Where effects of the
heat problem are on or asked for, their parts follow (`heat_effect_rates`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.body import Body, ThermalGeometry, about_middle
from thermofit.body.heat.conduction import GAMMA, HeatConditions, HeatStep, at_constant_stress, exchange, heat_conditions, steady_system
from thermofit.body.heat.effects import Loads, Moment, weighted_conduction
from thermofit.body.heat.sources import Flow
from thermofit.body.sensitivity.heat_effect_rates import (
    LOADS,
    Along,
    Moved,
    capacity_supply,
    conduction_supply,
    converged,
    felt,
    initial_rates,
    load_rates,
    moving_conduction,
    moving_flux,
    multiply_some,
    needed,
    source_rates,
    surface_loss,
)
from thermofit.body.sensitivity.shape_rates import add_conduction_rates, add_film_rates
from thermofit.body.solve.linear import Factor, multiply_symmetric
from thermofit.core.errors import NumericsError
from thermofit.core.jit import kernel
from thermofit.core.parameters import Parameters, load_mode, param
from thermofit.effects.film_exchange import FILM_UNIT
from thermofit.law.page import Law, law_of, slots_of
from thermofit.law.page_rates import STEP, padded

_STEADY_SWEEPS = 50
"""Limit of the iterations for the rates of a steady temperature under effects."""
_FAR_ABOVE = 1e3
"""Multiple of its scale above which a film is an ideal contact but for little."""
Motion = tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Displacement u (n_np, 3) mm and its rates (n_np, 3, m) at the start of a step, and both at its end."""


@dataclass(frozen=True)
class ConditionRates:
    """Rates (m,) of HeatConditions: of kappa, of c0, and per film those of its coefficient and of its medium temperature.

    `moved`: the effects along each named parameter; `middle` (n_np, m): rates of the temperature about which a step is linear.
    """

    kappa: np.ndarray
    c0: np.ndarray
    films: Mapping[str, tuple[np.ndarray, np.ndarray]]
    moved: Moved = ()
    middle: np.ndarray | None = None

    def about(self, middle: np.ndarray) -> ConditionRates:
        """The same in a step that is linear about a temperature of the given rates (n_np, m)."""
        return replace(self, middle=middle)

    def along(self, conditions: HeatConditions) -> Along:
        """What the rates of effects are taken of and along."""
        media = {name: rates[1] for name, rates in self.films.items()}
        return Along(conditions.effects, conditions.films, media, self.moved)

    def on_sets(self, names: Sequence[str], given: Sequence[str]) -> ConditionRates:
        """Rates for facet sets named after their film ("air", "clamp_lower"); the film of a set in `given` does not change."""
        none = np.zeros_like(self.kappa)
        return replace(self, films={name: (none, none) if name in given else self.films[name.partition("_")[0]] for name in names})


def condition_rates(
    parameters: Parameters, names: Sequence[str], law: Law | None = None, others: Sequence[Mapping[str, float]] = ()
) -> ConditionRates:
    """ConditionRates along the named parameters, filled up with zero directions, by complex step of `heat_conditions`.

    With the law of a one-way coupled run they are those of the conditions at constant stress. `others`: for each direction values of
    other Params of the effect that it moves, which while it is off change nothing but that direction.
    """
    there = [parameters.replace(**changed) for changed in others] if others else [parameters] * len(names)
    moved = [_moved(at, name, law) for at, name in zip(there, names, strict=True)]

    def rates(values: Sequence[complex]) -> np.ndarray:
        out = np.zeros(padded(len(names)))
        out[: len(names)] = np.imag(values) / STEP
        return out

    films = {
        film: (rates([c.films[film][0] for c in moved]), rates([c.films[film][1] for c in moved]))
        for film in heat_conditions(parameters).films
    }
    effects = tuple(felt(c.effects) for c in moved)
    return ConditionRates(rates([c.kappa for c in moved]), rates([c.c0 for c in moved]), films, effects)


def _moved(parameters: Parameters, name: str, law: Law | None) -> HeatConditions:
    """The conditions with one parameter moved by i h."""
    if load_mode(name) >= 0:
        conditions = heat_conditions(parameters)
        return conditions if law is None else at_constant_stress(conditions, law)
    param(name)
    values = {**parameters.values, name: complex(parameters[name], STEP)}
    there = Parameters(values, parameters.free)  # type: ignore[arg-type]
    conditions = heat_conditions(there)
    if law is None:
        return conditions
    return at_constant_stress(conditions, law_of(there, slots_of(law), closed_form=bool(law.closed_form), plastic=bool(law.plastic)))


def heat_step_rates(
    body: Body, step: HeatStep, start_rates: np.ndarray, heat_rates: np.ndarray, rates: ConditionRates, motion: Motion | None
) -> np.ndarray:
    """Rates (n_np, m) of the temperature at the end of a step, for those at its start and of its nodal heat (n_np, m).

    `motion` moves the body at both ends of the step; None where it stays as it is.
    """
    gamma = GAMMA if len(step.stages) == 2 else 1.0
    p, theta = body.thermal, np.stack([step.stages[0], step.theta], axis=1)
    starts = np.stack([step.start, step.start + (1.0 - gamma) / gamma * (step.stages[0] - step.start)], axis=1)
    geometry = replace(step.geometry, conduction=step.conduction)
    losses, lanes = _losses(body, geometry, (step.conditions, step.loads), theta, rates)
    lanes = -gamma * step.length * lanes
    if np.any(rates.c0):
        change = _multiply_both(p.row, p.column, step.capacity, starts - theta)
        losses, lanes = np.concatenate([change.T[:, :, None], losses], axis=2), np.vstack([rates.c0, lanes])
    supply = gamma * heat_rates
    shape = None if motion is None else _shape_rates(body, step, theta, motion)
    supplies, effects = [], _effect_supplies(body, step, (starts, theta), rates)
    for k in range(len(step.stages)):
        supplies.append(losses[k] @ lanes + supply)
        if effects is not None:
            columns, owed = effects
            supplies[k][:, columns] += owed[k][:, : len(columns)]
        if shape is not None:
            supplies[k] -= gamma * step.length * shape[k]
    return through_stages(body, step, start_rates, supplies)


def _effect_supplies(
    body: Body, step: HeatStep, states: tuple[np.ndarray, np.ndarray], rates: ConditionRates
) -> tuple[np.ndarray, list[np.ndarray]] | None:
    """What effects add to the supplies of the stages: the directions that they act on (k,), and the supplies (n_np, k) of both, filled up;
    states = theta at start and end of the stages, each (n_np, 2)."""
    along, moment = rates.along(step.conditions), step.conditions.moment
    if along.nothing or moment is None:
        return None
    columns = along.felt_by(LOADS)
    if not len(columns):
        return None
    along = along.only(columns)
    gamma, ends = (GAMMA, (GAMMA, 1.0)) if len(step.stages) == 2 else (1.0, (1.0, 1.0))
    linear = step.loads is not None and step.loads.linearised
    found = load_rates(body, along, (moment, step.length, ends), needed(rates.middle) if linear else None)
    films = {name: (FILM_UNIT * alpha, medium) for name, (alpha, medium) in step.conditions.films.items()}
    out = []
    for k in range(len(step.stages)):
        start, theta = (np.ascontiguousarray(state[:, k]) for state in states)
        loss = surface_loss(body, step.geometry, films, found, k, theta - moment.middle)
        if "conductivity" in found.factors:
            loss = loss + step.conditions.kappa * conduction_supply(body, step.geometry.conduction, found.factors["conductivity"], theta)
        supply = -gamma * step.length * loss
        if "capacity" in found.factors:
            supply = supply + step.conditions.c0 * capacity_supply(body, found.factors["capacity"], start - theta)
        out.append(supply)
    return columns, out


def usual_change(parameters: Parameters, name: str) -> float:
    """Usual change of a parameter: its scale; of a film coefficient far above it, that of its reciprocal is 1 / scale."""
    if load_mode(name) >= 0:
        return 1.0  # of a mode of unit variance
    scale, value = param(name).scale, parameters[name]
    return value * value / scale if name in ("alpha_air", "alpha_clamp") and value > _FAR_ABOVE * scale else scale


def add_effect_sources(
    body: Body, step: HeatStep, rates: ConditionRates, accumulated: Flow, accumulated_rates: Flow | None, out: np.ndarray
) -> None:
    """out (n_np, m) += rates in mJ of the heat that sources among the effects set free in a step.

    `accumulated`: Lambda at the points at both ends of the step, each (n_el, 8), and its rates (n_el, 8, m); None where they have none.
    """
    along, moment = rates.along(step.conditions), step.conditions.moment
    if along.nothing or moment is None:
        return
    flow = (accumulated[0], accumulated[1] - accumulated[0])
    flow_rates = None if accumulated_rates is None else (accumulated_rates[0], accumulated_rates[1] - accumulated_rates[0])
    found = source_rates(body, along, flow, flow_rates, (moment, step.length), needed(rates.middle))
    if found is not None:
        out += found


def heat_answer(body: Body, step: HeatStep, heat_rates: np.ndarray) -> np.ndarray:
    """What `heat_step_rates` owes to the nodal heat (n_np, m) alone: R h, also of one nodal heat (n_np,) mJ."""
    gamma = GAMMA if len(step.stages) == 2 else 1.0
    return through_stages(body, step, np.zeros_like(heat_rates), [gamma * heat_rates] * len(step.stages))


def through_stages(body: Body, step: HeatStep, start_rates: np.ndarray, supplies: Sequence[np.ndarray]) -> np.ndarray:
    """Rates (n_np, m), or of one direction (n_np,), at the end of a step whose stages get the supplies, of the same shape, beside the heat
    stored at their start; of a step that is linear in its sources also the temperatures that they make."""
    capacity = step.conditions.c0 * step.capacity
    gamma, from_rates = GAMMA if len(step.stages) == 2 else 1.0, start_rates
    for supply in supplies:
        right = _multiply(body, capacity, from_rates)
        right += supply
        theta_rates = np.ascontiguousarray(step.factor.solve(right))
        from_rates = start_rates + (1.0 - gamma) / gamma * (theta_rates - start_rates)
    return theta_rates


def _multiply(body: Body, data: np.ndarray, x: np.ndarray) -> np.ndarray:
    """K x for one vector (n_np,) or any number of them (n_np, m) of a symmetric matrix with the non-zeros `data` (n_slots,)."""
    p = body.thermal
    return np.asarray(multiply_symmetric(p.row, p.column, data, x)) if x.ndim == 1 else multiply_some(body, data, x)


def _losses(
    body: Body, geometry: ThermalGeometry, given: tuple[HeatConditions, Loads | None], theta: np.ndarray, rates: ConditionRates
) -> tuple[np.ndarray, np.ndarray]:
    """E' theta - q' in mW by conductivity and films for two theta (n_np, 2): the products (2, n_np, n) of nodal terms and lanes (n, m).

    Terms that no direction moves are left out.
    """
    p, (conditions, loads) = body.thermal, given
    nodal, lanes = [], []
    if np.any(rates.kappa):
        nodal, lanes = [_multiply_both(p.row, p.column, geometry.conduction, theta)], [rates.kappa]
    for name, (alpha, medium) in conditions.films.items():
        alpha_rates, medium_rates = rates.films[name]
        area, over = geometry.film_area[name][:, None], theta
        if loads is not None and name in loads.media:
            over = theta - loads.media[name].T
        if np.any(alpha_rates):
            nodal.append(_multiply_both(p.row, p.column, geometry.film[name], over) - medium * area)
            lanes.append(FILM_UNIT * alpha_rates)
        if np.any(medium_rates):
            nodal.append(np.repeat(area, 2, axis=1))
            lanes.append(-FILM_UNIT * alpha * medium_rates)
    if not nodal:
        return np.zeros((2, len(theta), 0)), np.zeros((0, len(rates.kappa)))
    return np.stack(nodal).transpose(2, 1, 0), np.stack(lanes)


@kernel
def _multiply_both(row: np.ndarray, column: np.ndarray, data: np.ndarray, x: np.ndarray) -> np.ndarray:
    """K x for two vectors x (n, 2) of a symmetric matrix kept by its lower triangle, of which most may be zero."""
    y = np.zeros(x.shape)
    for s in range(row.shape[0]):
        d = data[s]
        if d != 0.0:
            i, j = row[s], column[s]
            y[i, 0] += d * x[j, 0]
            y[i, 1] += d * x[j, 1]
            if i != j:
                y[j, 0] += d * x[i, 0]
                y[j, 1] += d * x[i, 1]
    return y


def _shape_rates(body: Body, step: HeatStep, theta: np.ndarray, motion: Motion) -> np.ndarray:
    """E' theta - q' (2, n_np, m) in mW for two theta (n_np, 2) by the motion of the body at both ends of a step, whose E is the mean."""
    out = np.zeros((2, len(theta), motion[0][1].shape[2]))
    theta, conditions, loads = np.ascontiguousarray(theta.T), step.conditions, step.loads
    for u, u_rates in motion:
        if loads is not None and loads.conductivity is not None:
            moving_conduction(body.data, (u, u_rates), theta, (0.5 * conditions.kappa, loads.conductivity), out)
        else:
            add_conduction_rates(body.data, u, u_rates, theta, 0.5 * conditions.kappa, out)
        for name, (alpha, medium) in conditions.films.items():
            excess = theta - medium
            if loads is not None and name in loads.media:
                excess = excess - loads.media[name]
            add_film_rates(body.films[name], body.mesh.nodes + u, u_rates, excess, 0.5 * FILM_UNIT * alpha, out)
            if loads is not None and name in loads.flux:
                moving_flux(body, name, (u, u_rates), np.stack([loads.flux_at(name, t) for t in theta]), 0.5, out)
    return out


def steady_rates(body: Body, geometry: ThermalGeometry, conditions: HeatConditions, theta: np.ndarray, rates: ConditionRates) -> np.ndarray:
    """Rates (n_np, m) of `steady_temperature` theta of the undeformed body: E theta' = q' - E' theta.

    NumericsError where there is no exchange and a film coefficient is among the directions: the temperature jumps there. A step of
    a search may end there, which is an evaluation that failed.
    """
    along = rates.along(conditions)
    initial = initial_rates(body, along)
    if all(alpha <= 0.0 for alpha, _ in conditions.films.values()):
        for name, (alpha_rates, _) in rates.films.items():
            if np.any(alpha_rates):
                raise NumericsError(
                    f"alpha_{name}: all film coefficients are zero, where it cannot be identified; start from a positive one"
                )
        return np.tile(rates.films["clamp"][1], (body.mesh.n_nodes, 1)) + initial
    if not along.nothing:
        return _steady_with_effects(body, geometry, conditions, theta, rates) + initial
    matrix, _ = exchange(geometry, conditions)
    losses, lanes = _losses(body, geometry, (conditions, None), np.stack([theta, theta], axis=1), rates)
    return np.ascontiguousarray(Factor(body.thermal, matrix).solve(-losses[0] @ lanes))


def _steady_with_effects(
    body: Body, geometry: ThermalGeometry, conditions: HeatConditions, theta: np.ndarray, rates: ConditionRates
) -> np.ndarray:
    """`steady_rates` before effects of slot initial_temperature; theta holds their excess.

    What the conductivity owes to theta' is iterated.
    """
    along, x_y = rates.along(conditions), about_middle(body)
    if conditions.effects is not None:
        theta = theta - conditions.effects.initial(*x_y)
    first = 0.0 if conditions.moment is None else conditions.moment.first
    loads, conduction = None, geometry.conduction
    matrix, _ = exchange(geometry, conditions)
    if conditions.effects is not None:
        loads, matrix = steady_system(body, geometry, conditions, theta)
        conduction = conduction if loads.conductivity is None else weighted_conduction(body, conduction, loads.conductivity)
    there = replace(geometry, conduction=conduction)
    losses, lanes = _losses(body, there, (conditions, loads), np.stack([theta, theta], axis=1), rates)
    factor, fixed, out = Factor(body.thermal, matrix), -losses[0] @ lanes, np.zeros((len(theta), along.m))
    films = {name: (FILM_UNIT * alpha, medium) for name, (alpha, medium) in conditions.films.items()}
    for _ in range(_STEADY_SWEEPS):
        found, before = load_rates(body, along, (Moment(first, first, theta), 0.0, (0.0, 0.0)), out), out
        right = fixed - surface_loss(body, geometry, films, found, 0, np.zeros_like(theta))
        if "conductivity" in found.factors:
            right = right - conditions.kappa * conduction_supply(body, geometry.conduction, found.factors["conductivity"], theta)
        out = np.ascontiguousarray(factor.solve(right))
        if loads is None or loads.conductivity is None or converged(out - before, out):
            return out
    raise NumericsError("sensitivities: the steady temperature under effects has no derivative that stands still; check the conductivity")
