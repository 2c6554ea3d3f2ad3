"""Rates of the sources of the heat equation along many directions at once (direct differentiation).

A rate, written x', is the derivative of x along a direction. The heat of an increment at a point, D(theta) + c theta (g - g_n) with
c = -3 alpha K and g = ln J / J, changes with the temperature, the point states at both ends of the increment and the numbers of the law.
Derivatives of the law page are made by complex step, as in `law.page_rates`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from thermofit.body.element.hex8 import ElementData
from thermofit.body.heat.equation import Increment, PointStates, at_points, increment_between
from thermofit.body.heat.structure import StructureSlopes, add_structure_rates, felt_by_heat, structure_slopes
from thermofit.body.sensitivity.lanes import add_lanes, copy_lanes
from thermofit.core.jit import kernel
from thermofit.law.composition import restructured
from thermofit.law.page import Law, is_transformed, law_in_step, released_energy, thermoelastic_heat
from thermofit.law.page_rates import HILL, LANES, STEP, SURFACE, Directions, moved_law
from thermofit.law.surface.catalogue import NUMBERS as OF_SURFACE
from thermofit.point.lanes_memory import prefetch_rows
from thermofit.point.state import ALPHA, LAMBDA

_ALPHA_N, _ALPHA, _D_LAMBDA, _ACCUMULATED, WARM = range(5)
"""Arguments of the dissipation of an increment, in the order of their derivatives; the numbers of the law follow."""
_released: Any = released_energy
_thermoelastic: Any = thermoelastic_heat
"""The law page is written for real numbers; here it takes complex ones."""


class PointStateRates(NamedTuple):
    """Rates of the points at one time: of J (n_el, 8, m) and of the state (n_el, 8, n, m)."""

    dilatation: np.ndarray
    state: np.ndarray


@dataclass(frozen=True)
class SourceLaw:
    """A law with the rates that the heat sources need, made once for many steps.

    `moved` is the law with no number moved by i h, then with each of the numbers that the dissipation feels, whose rates are `numbers`
    (n, m); `c_rates` (m,) are those of c = -3 alpha K. `structure` and `structure_numbers`, those of the yield surface first, are the same
    for the heat of effects that change the local update itself, empty where none is on or asked for; `structure_arguments`: what else that
    heat depends on (`Felt`); `of_surface`: the numbers of the surface, by their places among its own.
    """

    law: Law
    moved: tuple[Law, ...]
    numbers: np.ndarray
    c_rates: np.ndarray
    structure: tuple[Law, ...] = ()
    structure_numbers: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    structure_arguments: tuple[int, ...] = ()
    of_surface: tuple[int, ...] = ()

    def in_step(self, dt: float) -> SourceLaw:
        """The same in a step of dt s."""
        laws = (tuple(law_in_step(law, dt) for law in some) for some in (self.moved, self.structure))
        moved, structure = laws
        return replace(self, law=law_in_step(self.law, dt), moved=moved, structure=structure)

    @property
    def on(self) -> bool:
        """Whether an effect that changes the local update itself is on."""
        return bool(self.law.effective and restructured(self.law))


def source_law(law: Law, directions: Directions) -> SourceLaw:
    """SourceLaw of a law and its rates along the directions."""
    c_rates = np.zeros(directions.numbers.shape[1])
    for which in np.flatnonzero(np.any(directions.numbers != 0.0, axis=1)):
        c = _thermoelastic.py_func(1.0, 0.0, 1.0, moved_law(law, int(which)))
        c_rates += np.imag(c) / STEP * directions.numbers[which]
    moved = tuple(moved_law(law, int(which)) for which in (-1, *directions.in_heat))
    found = SourceLaw(law, moved, np.ascontiguousarray(directions.numbers[directions.in_heat]), c_rates)
    if not directions.structured:
        return found
    any_rate = np.flatnonzero(np.any(directions.numbers != 0.0, axis=1))
    first, count = (SURFACE, len(OF_SURFACE)) if is_transformed(law) else (HILL, 6)
    own = [int(k) for k in any_rate if first <= k < first + count]
    asked = any_rate if found.on else sorted({*directions.in_structure, *directions.in_sense})
    active = [int(k) for k in asked if not first <= k < first + count]
    structure = tuple(moved_law(law, which) for which in (-1, *active))
    felt = felt_by_heat(structure)
    structure = (structure[0], *(there for there, heats in zip(structure[1:], felt.numbers, strict=True) if heats))
    numbers = np.ascontiguousarray(directions.numbers[[*own, *np.array(active, dtype=int)[felt.numbers]]])
    return replace(
        found,
        structure=structure,
        structure_numbers=numbers,
        structure_arguments=felt.arguments,
        of_surface=tuple(k - first for k in own),
    )


class SourceSlopes(NamedTuple):
    """Derivatives of the heat of an increment that all directions share: by J at both ends, each (n_el, 8), and of the dissipation
    (5 + n, n_el, 8). `structure`: those of the heat of effects that change the local update itself."""

    increment: Increment
    by_j: tuple[np.ndarray, np.ndarray]
    dissipation: np.ndarray
    structure: StructureSlopes | None


Temperatures = tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""theta (n_np,) K and its rates (n_np, m), of the thermoelastic term (the middle of the increment) and at the start of the increment."""


def source_slopes(
    data: ElementData, ends: tuple[PointStates, PointStates], theta: tuple[np.ndarray, np.ndarray], law: SourceLaw
) -> SourceSlopes:
    """SourceSlopes of an increment from the points at its ends, and theta (n_np,) K of the thermoelastic term and at its start."""
    increment = increment_between(*ends)
    j_n, j = ends[0].dilatation, ends[1].dilatation
    by_j = ((increment.g_n - 1.0 / j_n) / j_n, (1.0 / j - increment.g) / j)
    warm, warm_n = (at_points(data, t) for t in theta)
    structure = _structure_slopes(ends, (warm, warm_n), law, moving=True) if law.structure else None
    return SourceSlopes(increment, by_j, _dissipation_derivatives(increment, warm, law, range(5)), structure)


def _structure_slopes(
    ends: tuple[PointStates, PointStates], theta: tuple[np.ndarray, np.ndarray], law: SourceLaw, *, moving: bool
) -> StructureSlopes:
    return structure_slopes(*ends, *theta, law.law, law.structure, law.of_surface, law.structure_arguments, moving)


def heat_source_rates(
    data: ElementData,
    slopes: SourceSlopes,
    end_rates: tuple[PointStateRates, PointStateRates],
    temperatures: Temperatures,
    law: SourceLaw,
    out: np.ndarray,
) -> None:
    """Rates of `heat.heat_of_increment` along the directions added to out (n_np, m), mJ.

    `end_rates` are those of the points at start and end of the increment; `temperatures` are those with which the slopes were made. A point
    that does not flow dissipates nothing.
    """
    temperature, (_, rates_n) = temperatures
    _add_source_rates(data, slopes.increment, slopes.dissipation, (law.law, law.numbers, law.c_rates), temperature, out)
    states = (end_rates[0].state.reshape(-1), end_rates[1].state.reshape(-1))
    dilatations = (end_rates[0].dilatation.reshape(-1), end_rates[1].dilatation.reshape(-1))
    n_state = end_rates[0].state.shape[2]
    _add_state_rates(data, slopes.by_j, slopes.dissipation, law.law, temperature[0], dilatations, states, n_state, out)
    if slopes.structure is not None:
        ends = ((end_rates[0].dilatation, end_rates[0].state), (end_rates[1].dilatation, end_rates[1].state))
        add_structure_rates(data, slopes.structure, ends, (temperature[1], rates_n), law.structure_numbers, out)


def frozen_source_rates(
    data: ElementData,
    increment: Increment,
    temperatures: Temperatures,
    law: SourceLaw,
    out: np.ndarray,
    ends: tuple[PointStates, PointStates] | None = None,
) -> None:
    """`heat_source_rates` where the mechanics stays as it is: temperature and law alone have rates. `ends`: the points at both ends of the
    increment, where they hold the state of effects that change the local update itself."""
    temperature, (theta_n, rates_n) = temperatures
    warm, warm_n = at_points(data, temperature[0]), at_points(data, theta_n)
    dissipation = _dissipation_derivatives(increment, warm, law, range(WARM, 5))
    _add_source_rates(data, increment, dissipation, (law.law, law.numbers, law.c_rates), temperature, out)
    if ends is not None and law.structure:
        slopes = _structure_slopes(ends, (warm, warm_n), law, moving=False)
        add_structure_rates(data, slopes, None, (temperature[1], rates_n), law.structure_numbers, out)


def _dissipation_derivatives(increment: Increment, theta: np.ndarray, law: SourceLaw, arguments: range) -> np.ndarray:
    """Derivatives of D (5 + n, n_el, 8) by the given of its arguments (others stay zero) and by the numbers of the law that it feels.

    Lambda at the end and the temperature take part through effects alone.
    """
    out = np.zeros((4 + len(law.moved), *increment.g.shape))
    if np.any(increment.d_lambda > 0.0):
        for argument in arguments:
            if argument < _ACCUMULATED or law.law.effective == 1:
                _differentiate_dissipation(increment, theta, argument, law.moved[0], out[argument])
        for n, moved in enumerate(law.moved[1:], start=5):
            _differentiate_dissipation(increment, theta, -1, moved, out[n])
    return out


@kernel
def _differentiate_dissipation(increment: Increment, theta: np.ndarray, argument: int, law: Law, out: np.ndarray) -> None:
    h = np.zeros(5)
    if argument >= 0:
        h[argument] = STEP
    for e in range(out.shape[0]):
        for q in range(8):
            if increment.d_lambda[e, q] > 0.0:
                alpha_n, alpha = complex(increment.alpha_n[e, q], h[_ALPHA_N]), complex(increment.alpha[e, q], h[_ALPHA])
                d_lambda, warm = complex(increment.d_lambda[e, q], h[_D_LAMBDA]), complex(theta[e, q], h[WARM])
                accumulated = complex(increment.accumulated[e, q], h[_ACCUMULATED])
                out[e, q] = _released(alpha_n, alpha, d_lambda, accumulated, warm, law).imag / STEP


# Workspace of both kernels, LANES numbers each: theta' and heat' of the nodes, theta' and heat' of the point.
_THETA, _NODAL, _POINT, _HEAT, _END = 0, 8 * LANES, 16 * LANES, 17 * LANES, 18 * LANES


@kernel
def _add_source_rates(
    data: ElementData,
    increment: Increment,
    dissipation: np.ndarray,
    law_and_rates: tuple[Law, np.ndarray, np.ndarray],
    temperature: tuple[np.ndarray, np.ndarray],
    out: np.ndarray,
) -> None:
    """Nodal heat' by theta' and by the numbers of the law."""
    law, numbers, c_rates = law_and_rates[0], law_and_rates[1].reshape(-1), law_and_rates[2]
    theta, theta_rates = temperature[0], temperature[1].reshape(-1)
    m, result, active = out.shape[1], out.reshape(-1), dissipation.shape[0] - 5
    c = thermoelastic_heat(1.0, 0.0, 1.0, law)
    w, zero, corner, by_c = np.zeros(_END), np.zeros(LANES), np.empty(8), np.empty(8)
    for e in range(data.hexes.shape[0]):
        for a in range(8):
            corner[a] = theta[data.hexes[e, a]]
        for q in range(8):
            t = 0.0
            for a in range(8):
                t += data.shape[q, a] * corner[a]
            by_c[q] = data.volume[e, q] * t * (increment.g[e, q] - increment.g_n[e, q])
        for b in range(0, m, LANES):
            for a in range(8):
                copy_lanes(w, _THETA + a * LANES, theta_rates, data.hexes[e, a] * m + b)
                copy_lanes(w, _NODAL + a * LANES, zero, 0)
            for q in range(8):
                volume = data.volume[e, q]
                copy_lanes(w, _POINT, zero, 0)
                for a in range(8):
                    add_lanes(w, _POINT, data.shape[q, a], w, _THETA + a * LANES)
                copy_lanes(w, _HEAT, zero, 0)
                by_theta = c * (increment.g[e, q] - increment.g_n[e, q]) + dissipation[WARM, e, q]
                add_lanes(w, _HEAT, volume * by_theta, w, _POINT)
                add_lanes(w, _HEAT, by_c[q], c_rates, b)
                if increment.d_lambda[e, q] > 0.0:
                    for k in range(active):
                        add_lanes(w, _HEAT, volume * dissipation[5 + k, e, q], numbers, k * m + b)
                for a in range(8):
                    add_lanes(w, _NODAL + a * LANES, data.shape[q, a], w, _HEAT)
            for a in range(8):
                add_lanes(result, data.hexes[e, a] * m + b, 1.0, w, _NODAL + a * LANES)


@kernel
def _add_state_rates(
    data: ElementData,
    by_j: tuple[np.ndarray, np.ndarray],
    dissipation: np.ndarray,
    law: Law,
    theta: np.ndarray,
    dilatations: tuple[np.ndarray, np.ndarray],
    states: tuple[np.ndarray, np.ndarray],
    n_state: int,
    out: np.ndarray,
) -> None:
    """Nodal heat' by J', alpha', Lambda' at both ends; a state has n_state numbers."""
    m, result = out.shape[1], out.reshape(-1)
    c = thermoelastic_heat(1.0, 0.0, 1.0, law)
    w, zero = np.zeros(_END), np.zeros(LANES)
    for e in range(data.hexes.shape[0]):
        dissipates = np.any(dissipation[:3, e] != 0.0)
        for b in range(0, m, LANES):
            for a in range(8):
                copy_lanes(w, _NODAL + a * LANES, zero, 0)
            for q in range(8):
                point, volume, t = e * 8 + q, data.volume[e, q], 0.0
                for a in range(8):
                    t += data.shape[q, a] * theta[data.hexes[e, a]]
                copy_lanes(w, _HEAT, zero, 0)
                for k in range(2):
                    if dissipates:
                        prefetch_rows(states[k], (((point + 8) * n_state + ALPHA) * m + b) // LANES, 2, m // LANES)
                    by_lambda = volume * (dissipation[_D_LAMBDA, e, q] * (2 * k - 1) + dissipation[_ACCUMULATED, e, q] * k)
                    add_lanes(w, _HEAT, volume * c * t * by_j[k][e, q], dilatations[k], point * m + b)
                    if dissipates:
                        add_lanes(w, _HEAT, volume * dissipation[_ALPHA_N + k, e, q], states[k], (point * n_state + ALPHA) * m + b)
                        add_lanes(w, _HEAT, by_lambda, states[k], (point * n_state + LAMBDA) * m + b)
                for a in range(8):
                    add_lanes(w, _NODAL + a * LANES, data.shape[q, a], w, _HEAT)
            for a in range(8):
                add_lanes(result, data.hexes[e, a] * m + b, 1.0, w, _NODAL + a * LANES)


@kernel
def add_dilatation_heat(
    data: ElementData,
    dilatation: np.ndarray,
    stiff: np.ndarray,
    theta: np.ndarray,
    law: Law,
    dilatation_rates: np.ndarray,
    out: np.ndarray,
) -> None:
    """The part of `heat_source_rates` that the rates of J (n_el, 8, m) at the end of the increment make alone; `dilatation` is J there and
    `stiff` the factor on the moduli. (What J makes of the energy of changed moduli is left out: it is smaller by the elastic strain.)"""
    m, result, rates = out.shape[1], out.reshape(-1), dilatation_rates.reshape(-1)
    c = thermoelastic_heat(1.0, 0.0, 1.0, law)
    w, zero, by_j = np.zeros(_END), np.zeros(LANES), np.empty(8)
    for e in range(data.hexes.shape[0]):
        for q in range(8):
            t, j = 0.0, dilatation[e, q]
            for a in range(8):
                t += data.shape[q, a] * theta[data.hexes[e, a]]
            by_j[q] = data.volume[e, q] * c * t * (1.0 - np.log(j)) / (j * j) * stiff[e, q]
        for b in range(0, m, LANES):
            for a in range(8):
                copy_lanes(w, _NODAL + a * LANES, zero, 0)
            for q in range(8):
                copy_lanes(w, _HEAT, zero, 0)
                add_lanes(w, _HEAT, by_j[q], rates, (e * 8 + q) * m + b)
                for a in range(8):
                    add_lanes(w, _NODAL + a * LANES, data.shape[q, a], w, _HEAT)
            for a in range(8):
                add_lanes(result, data.hexes[e, a] * m + b, 1.0, w, _NODAL + a * LANES)
