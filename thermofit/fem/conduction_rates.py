"""Rates of a step of the heat equation and of the steady state along many directions at once (direct differentiation).

With the capacity matrix C, exchange matrix E and inflow q of a step, a stage of the scheme from theta_s solves

    (C + gamma dt E) theta = C theta_s + gamma (h + dt q),

so that its rates follow from the same matrix, whose factor the step has kept:

    (C + gamma dt E) theta' = C theta_s' + C' (theta_s - theta) + gamma [h' - dt (E' theta - q')].

E' theta - q' has a part by the numbers of the heat equation and a part by the motion of the body (`shape_rates`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.jit import kernel
from thermofit.core.parameters import Parameters, param
from thermofit.effects.film_exchange import FILM_UNIT
from thermofit.fem.body import Body, ThermalGeometry
from thermofit.fem.conduction import GAMMA, HeatConditions, HeatStep, at_constant_stress, exchange, heat_conditions
from thermofit.fem.lanes import multiply_directions
from thermofit.fem.linear import Factor
from thermofit.fem.shape_rates import add_conduction_rates, add_film_rates
from thermofit.material.law import Law, law_of
from thermofit.material.law_rates import STEP, padded

Motion = tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Displacement u (n_np, 3) mm and its rates (n_np, 3, m) at the start of a step, and both at its end."""


@dataclass(frozen=True)
class ConditionRates:
    """Rates (m,) of HeatConditions: of kappa, of c0, and per film those of its coefficient and of its medium temperature."""

    kappa: np.ndarray
    c0: np.ndarray
    films: Mapping[str, tuple[np.ndarray, np.ndarray]]

    def on_sets(self, names: Sequence[str], given: Sequence[str]) -> ConditionRates:
        """Rates for facet sets named after their film ("air", "clamp_lower"); the film of a set in `given` does not change."""
        none = np.zeros_like(self.kappa)
        return replace(self, films={name: (none, none) if name in given else self.films[name.partition("_")[0]] for name in names})


def condition_rates(parameters: Parameters, names: Sequence[str], law: Law | None = None) -> ConditionRates:
    """ConditionRates along the named parameters, filled up with zero directions, by complex step of `heat_conditions`.

    With the law of a one-way coupled run they are those of the conditions at constant stress.
    """
    moved = [_moved(parameters, name, law) for name in names]

    def rates(values: Sequence[complex]) -> np.ndarray:
        out = np.zeros(padded(len(names)))
        out[: len(names)] = np.imag(values) / STEP
        return out

    films = {
        film: (rates([c.films[film][0] for c in moved]), rates([c.films[film][1] for c in moved]))
        for film in heat_conditions(parameters).films
    }
    return ConditionRates(rates([c.kappa for c in moved]), rates([c.c0 for c in moved]), films)


def _moved(parameters: Parameters, name: str, law: Law | None) -> HeatConditions:
    """The conditions with one parameter moved by i h."""
    param(name)
    values = {**parameters.values, name: complex(parameters[name], STEP)}
    there = Parameters(values, parameters.free)  # type: ignore[arg-type]
    conditions = heat_conditions(there)
    if law is None:
        return conditions
    return at_constant_stress(conditions, law_of(there, law.model, closed_form=bool(law.closed_form), plastic=bool(law.plastic)))


def heat_step_rates(
    body: Body, step: HeatStep, start_rates: np.ndarray, heat_rates: np.ndarray, rates: ConditionRates, motion: Motion | None
) -> np.ndarray:
    """Rates (n_np, m) of the temperature at the end of a step, for those at its start and of its nodal heat (n_np, m).

    `motion` moves the body at both ends of the step; None where it stays as it is.
    """
    gamma = GAMMA if len(step.stages) == 2 else 1.0
    p, theta = body.thermal, np.stack([step.stages[0], step.theta], axis=1)
    starts = np.stack([step.start, step.start + (1.0 - gamma) / gamma * (step.stages[0] - step.start)], axis=1)
    losses, lanes = _losses(body, step.geometry, step.conditions, theta, rates)
    change = _multiply_both(p.row, p.column, body.capacity, starts - theta)
    lanes = np.vstack([rates.c0, -gamma * step.length * lanes])
    supply = gamma * heat_rates
    shape = None if motion is None else _shape_rates(body, step, theta, motion)
    supplies = []
    for k in range(len(step.stages)):
        supplies.append(np.column_stack([change[:, k], losses[k]]) @ lanes)
        supplies[k] += supply
        if shape is not None:
            supplies[k] -= gamma * step.length * shape[k]
    return _through_stages(body, step, start_rates, supplies)


def heat_answer(body: Body, step: HeatStep, heat_rates: np.ndarray) -> np.ndarray:
    """What `heat_step_rates` owes to the nodal heat (n_np, m) alone."""
    gamma = GAMMA if len(step.stages) == 2 else 1.0
    return _through_stages(body, step, np.zeros_like(heat_rates), [gamma * heat_rates] * len(step.stages))


def _through_stages(body: Body, step: HeatStep, start_rates: np.ndarray, supplies: Sequence[np.ndarray]) -> np.ndarray:
    """Rates (n_np, m) at the end of a step whose stages get the supplies (n_np, m) beside the heat stored at their start."""
    p, capacity = body.thermal, step.conditions.c0 * body.capacity
    gamma, from_rates = GAMMA if len(step.stages) == 2 else 1.0, start_rates
    for supply in supplies:
        right = multiply_directions(p.row, p.column, capacity, from_rates)
        right += supply
        theta_rates = np.ascontiguousarray(step.factor.solve(right))
        from_rates = start_rates + (1.0 - gamma) / gamma * (theta_rates - start_rates)
    return theta_rates


def _losses(
    body: Body, geometry: ThermalGeometry, conditions: HeatConditions, theta: np.ndarray, rates: ConditionRates
) -> tuple[np.ndarray, np.ndarray]:
    """E' theta - q' in mW by conductivity and films for two theta (n_np, 2): the products (2, n_np, n) of nodal terms and lanes (n, m)."""
    p = body.thermal
    nodal, lanes = [_multiply_both(p.row, p.column, geometry.conduction, theta)], [rates.kappa]
    for name, (alpha, medium) in conditions.films.items():
        alpha_rates, medium_rates = rates.films[name]
        area = geometry.film_area[name][:, None]
        nodal += [_multiply_both(p.row, p.column, geometry.film[name], theta) - medium * area, np.repeat(area, 2, axis=1)]
        lanes += [FILM_UNIT * alpha_rates, -FILM_UNIT * alpha * medium_rates]
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
    theta, conditions = np.ascontiguousarray(theta.T), step.conditions
    for u, u_rates in motion:
        add_conduction_rates(body.data, u, u_rates, theta, 0.5 * conditions.kappa, out)
        for name, (alpha, medium) in conditions.films.items():
            add_film_rates(body.films[name], body.mesh.nodes + u, u_rates, theta - medium, 0.5 * FILM_UNIT * alpha, out)
    return out


def steady_rates(body: Body, geometry: ThermalGeometry, conditions: HeatConditions, theta: np.ndarray, rates: ConditionRates) -> np.ndarray:
    """Rates (n_np, m) of `steady_temperature` theta of the undeformed body: E theta' = q' - E' theta.

    StudyError where there is no exchange and a film coefficient is among the directions: the temperature jumps there.
    """
    if all(alpha <= 0.0 for alpha, _ in conditions.films.values()):
        for name, (alpha_rates, _) in rates.films.items():
            if np.any(alpha_rates):
                raise StudyError(f"alpha_{name}: all film coefficients are zero, where it cannot be identified; start from a positive one")
        return np.tile(rates.films["clamp"][1], (body.mesh.n_nodes, 1))
    matrix, _ = exchange(geometry, conditions)
    losses, lanes = _losses(body, geometry, conditions, np.stack([theta, theta], axis=1), rates)
    return np.ascontiguousarray(Factor(body.thermal, matrix).solve(-losses[0] @ lanes))
