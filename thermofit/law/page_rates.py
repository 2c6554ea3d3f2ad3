"""Derivatives of the law page by its arguments and by the numbers of the law, made by complex step.

No derivative is written by hand: a scalar function f of the law page is called with one of its arguments or one number of the law
moved by i h; then Im f / h is the derivative to roundoff (h far below the last digit). What a function of the law page does not
depend on costs nothing: `directions` asks once which numbers it feels.

A direction is one parameter whose influence is followed, or any combination of them: `Directions.numbers` holds, for each
direction, the rates of all numbers of the law.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.parameters import Parameters, load_mode, param
from thermofit.effects.catalogue import effects
from thermofit.law.composition import (
    AMPLITUDES,
    BACKSTRESSES,
    EFFECT_NUMBERS,
    STRUCTURAL,
    asymmetry_factor,
    backstress_terms,
    modulus_factor,
    number_of,
    warm_moduli,
)
from thermofit.law.page import (
    AnySurfaceLaw,
    Law,
    hardening_variable,
    is_transformed,
    law_of,
    pressure_factor,
    released_energy,
    slots_of,
    yield_stress_at_rate,
)
from thermofit.law.surface.catalogue import NUMBERS as OF_SURFACE

LANES = 8
"""Directions that are treated side by side; their number is filled up to a multiple of it with zero directions."""

_FLAGS = ("model", "closed_form", "plastic", "effective", "per_second", "surface")
NUMBERS: tuple[str, ...] = tuple(name for name in AnySurfaceLaw._fields if name not in _FLAGS)
"""Names of the real numbers of any law, in the order of its fields; a Law of the thesis has not all of them."""
N_NUMBERS = len(NUMBERS)
MU, BULK = NUMBERS.index("mu"), NUMBERS.index("bulk")
ELASTIC = tuple(NUMBERS.index(name) for name in ("lame", "mu", "bulk"))
ALPHA_EXP, THETA_REF = NUMBERS.index("alpha_exp"), NUMBERS.index("theta_ref")
HILL = NUMBERS.index("F")
"""Place of F among the numbers; G, H, L, M, N follow."""
SURFACE = NUMBERS.index(OF_SURFACE[0])
"""Place of the first number of a transformed surface."""
WARMING = tuple(NUMBERS.index(number_of(name)) for e in effects(("elasticity",)) for name in e.names)
"""Places of the numbers of effects by which the moduli change with temperature."""

STEP = 1e-30


class Directions(NamedTuple):
    """Rates of the law's numbers and of parameters outside it, for n directions filled up to m, a multiple of LANES.

    `numbers` (N_NUMBERS, m); `in_yield`, `in_heat`, `in_pressure`: which numbers the yield stress with its hardening variable, the
    dissipation and the pressure factor depend on. `in_structure`, `in_sense`: those of the effects that change the local update itself, in
    `structure_gradients` and `sense_gradients`; `in_surface`: those of a transformed yield surface. `structured` where one of these effects
    is on or asked for, or the surface is transformed. `warms` where the moduli change with temperature, so that rates of tr C_el of every
    point take part in its heat.
    """

    numbers: np.ndarray
    in_yield: np.ndarray
    in_heat: np.ndarray
    in_pressure: np.ndarray
    in_structure: np.ndarray
    in_sense: np.ndarray
    in_surface: np.ndarray
    structured: bool
    warms: bool


def padded(n: int) -> int:
    """n filled up to a multiple of LANES."""
    return -(-n // LANES) * LANES


def number_rates(parameters: Parameters, names: Sequence[str], law: Law) -> np.ndarray:
    """d number / d parameter (N_NUMBERS, len(names)) at given parameters, by complex step of `law_of`."""
    out = np.zeros((N_NUMBERS, len(names)))
    for column, name in enumerate(names):
        if load_mode(name) >= 0:
            continue
        param(name)
        moved = Parameters({**parameters.values, name: complex(parameters[name], STEP)}, parameters.free)  # type: ignore[dict-item]
        there = law_of(moved, slots_of(law), closed_form=bool(law.closed_form), plastic=bool(law.plastic))
        out[:, column] = [np.imag(getattr(there, number, 0.0)) / STEP for number in NUMBERS]
    return out


def directions(parameters: Parameters, names: Sequence[str], law: Law) -> Directions:
    """Directions along the named parameters."""
    numbers = np.zeros((N_NUMBERS, padded(len(names))))
    numbers[:, : len(names)] = number_rates(parameters, names, law)
    moved = np.any(numbers != 0.0, axis=1)
    structured = is_structured(parameters, law, names)
    return Directions(
        numbers,
        _felt(yield_gradients, (0.031 * FLOWED, 0.017 * FLOWED, 0.007 * FLOWED, 297.3), law, moved),
        _felt(dissipation_gradients, (0.031 * FLOWED, 0.036 * FLOWED, 0.007 * FLOWED, 0.017 * FLOWED, 297.3), law, moved),
        _felt(pressure_gradients, (0.003, 297.3), law, moved),
        _felt(_structure_slopes, (0.017 * FLOWED, 0.007 * FLOWED, 297.3), law, moved & structured),
        _felt(_sense_slopes, (-0.3,), law, moved & structured),
        (SURFACE + np.flatnonzero(moved[SURFACE : SURFACE + len(OF_SURFACE)])).astype(np.int64),
        structured,
        bool(law.effective and warm_moduli.py_func(law)),
    )


def is_structured(parameters: Parameters, law: Law, names: Sequence[str] = ()) -> bool:
    """Whether the yield surface is transformed, an effect that changes the local update itself is on, or one of its Params is among
    `names`."""
    if is_transformed(law) or set(names) & set(STRUCTURAL):
        return True
    return any(parameters[name] != param(name).neutral for name in STRUCTURAL if name in AMPLITUDES)


def moved_law(law: Law, which: int) -> Law:
    """The law with all numbers complex and one of them moved by i h (none for a negative `which`).

    One of an effect is looked at although the law may have none.
    """
    moved = {name: complex(getattr(law, name)) for name in law._fields if name not in _FLAGS}
    asked = NUMBERS[which] if which >= 0 else ""
    if asked in moved:
        moved[asked] += complex(0.0, STEP)
    changes: dict[str, Any] = {**moved, "effective": 1 if asked in EFFECT_NUMBERS else law.effective}
    return law._replace(**changes)


Complex = Any
"""A complex number where the law page, written for real ones, says float."""
Gradients = Callable[[tuple[np.ndarray, ...], Law, np.ndarray], np.ndarray]


FLOWED = np.geomspace(1e-4, 1e3, 256)
"""Plastic strains over a usual one: a knot of a table, or a step of a curve, is felt between its neighbours alone."""


def generic(law: Law, theta: float) -> Law:
    """The law with a rate, and a reference temperature that is not theta: nothing vanishes by chance where it is probed."""
    return law._replace(theta_ref=law.theta_ref - 1.7 if law.theta_ref == theta else law.theta_ref, per_second=0.3)


def _felt(gradients: Gradients, arguments: tuple[Any, ...], law: Law, moved: np.ndarray) -> np.ndarray:
    """Numbers that a function of the law page depends on at any of several general points, of those that any direction moves."""
    asked = np.flatnonzero(moved)
    if not len(asked):
        return np.empty(0, dtype=np.int64)
    points = tuple(np.array(x) for x in np.broadcast_arrays(*(np.atleast_1d(x) for x in arguments)))
    found = gradients(points, generic(law, arguments[-1]), asked)
    felt = np.any(found[..., len(arguments) :, :] != 0.0, axis=(*range(found.ndim - 2), -1))
    return asked[felt].astype(np.int64)


def _moves(n: int, law: Law, active: np.ndarray) -> list[tuple[Any, Law]]:
    """Steps h of n arguments and the law: each argument moved alone, then each active number alone."""
    still, none = moved_law(law, -1), (0.0,) * n
    one = [(*none[:k], STEP, *none[k + 1 :]) for k in range(n)]
    return [*((h, still) for h in one), *((none, moved_law(law, int(which))) for which in active)]


def yield_gradients(points: tuple[np.ndarray, ...], law: Law, active: np.ndarray) -> np.ndarray:
    """Gradients of yield stress and alpha after an increment, (2, 4 + n_active, n): by alpha_n, Lambda_n, dLambda, theta, then by `active`.

    points = (alpha_n, Lambda_n, dLambda, theta), each (n,); zero where dLambda = 0.
    """
    out = np.zeros((2, 4 + len(active), 1, len(points[0])))
    set_yield_gradients(tuple(x.reshape(1, -1) for x in points), law, active, (out[0], out[1]))
    return out[:, :, 0]


def set_yield_gradients(
    points: tuple[np.ndarray, ...], law: Law, active: np.ndarray, out: tuple[Sequence[np.ndarray | None], Sequence[np.ndarray | None]]
) -> None:
    """`yield_gradients` of points (n_el, 8) into arrays (n_el, 8), one for each derivative; None for one that is not wanted."""
    unwanted = np.empty(points[0].shape)
    arguments = (points[0], points[1], points[2], points[3])
    for k, (h, moved) in enumerate(_moves(4, law, active)):
        sigma, alpha = out[0][k], out[1][k]
        if k == 3 and law.effective == 0:
            for target in (sigma, alpha):
                if target is not None:
                    target[:] = 0.0
            continue
        _yield_derivative(arguments, h, moved, unwanted if sigma is None else sigma, unwanted if alpha is None else alpha)


def pressure_gradients(points: tuple[np.ndarray, ...], law: Law, active: np.ndarray) -> np.ndarray:
    """Gradient of the pressure factor k (4.8), (2 + n_active, n): by ln J and theta (= points, each (n,)), then by `active`."""
    out = np.empty((2 + len(active), 1, len(points[0])))
    set_pressure_gradients(tuple(x.reshape(1, -1) for x in points), law, active, list(out))
    return out[:, 0]


def set_pressure_gradients(points: tuple[np.ndarray, ...], law: Law, active: np.ndarray, out: Sequence[np.ndarray]) -> None:
    """`pressure_gradients` of points (n_el, 8) into arrays (n_el, 8), one for each derivative."""
    j = np.exp(points[0])
    for k, (h, moved) in enumerate(_moves(2, law, active)):
        _pressure_derivative((points[0], j, points[1]), h, moved, out[k])


def dissipation_gradients(points: tuple[np.ndarray, ...], law: Law, active: np.ndarray) -> np.ndarray:
    """Gradient of the released energy of an increment, (5 + n_active, n): by alpha_n, alpha, dLambda, Lambda and theta at its end, then by
    `active`. points = the first five, each (n,); zero where dLambda = 0."""
    arguments = (points[0], points[1], points[2], points[3], points[4])
    out = np.zeros((5 + len(active), len(points[0])))
    for k, (h, moved) in enumerate(_moves(5, law, active)):
        _dissipation_derivative(arguments, h, moved, out[k])
    return out


N_STRUCTURE = 1 + 2 * len(BACKSTRESSES)
"""Numbers that the effects which change the local update give a point: the factor m on its moduli, then C and gamma of each backstress."""


def structure_gradients(points: tuple[np.ndarray, ...], law: Law, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """m, then C_i and gamma_i of each backstress, (N_STRUCTURE, n), and their gradients (N_STRUCTURE, 3 + n_active, n): by Lambda_n,
    dLambda, theta (= points, each (n,)), then by `active`. C is zero where a backstress is off."""
    n = len(points[0])
    values, out = np.empty((N_STRUCTURE, n)), np.empty((N_STRUCTURE, 3 + len(active), n))
    arguments = (points[0], points[1], points[2])
    for k, (h, moved) in enumerate(_moves(3, law, active)):
        _structure_derivative(arguments, h, moved, values, out[:, k])
    return values, out


def sense_gradients(sense: np.ndarray, law: Law, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factor on the yield stress at the senses of flow (n,), and its gradient (1 + n_active, n) by them, then by `active`."""
    values, out = np.empty(len(sense)), np.empty((1 + len(active), len(sense)))
    for k, (h, moved) in enumerate(_moves(1, law, active)):
        _sense_derivative(sense, h[0], moved, values, out[k])
    return values, out


def _structure_slopes(points: tuple[np.ndarray, ...], law: Law, active: np.ndarray) -> np.ndarray:
    return structure_gradients(points, law, active)[1]


def _sense_slopes(points: tuple[np.ndarray, ...], law: Law, active: np.ndarray) -> np.ndarray:
    return sense_gradients(points[0], law, active)[1]


@kernel
def _structure_derivative(
    points: tuple[np.ndarray, np.ndarray, np.ndarray], h: tuple[float, float, float], law: Law, values: np.ndarray, out: np.ndarray
) -> None:
    for i in range(len(points[0])):
        gamma: Complex = complex(points[1][i], h[1])
        total: Complex = complex(points[0][i], h[0]) + gamma
        warm: Complex = complex(points[2][i], h[2])
        stiff: Complex = modulus_factor(total, warm, law)
        values[0, i], out[0, i] = stiff.real, stiff.imag / STEP
        terms = backstress_terms(total, gamma * law.per_second, warm, law)
        for k in range(len(terms)):
            modulus: Complex = terms[k][0]
            recall: Complex = terms[k][1]
            values[1 + 2 * k, i], out[1 + 2 * k, i] = modulus.real, modulus.imag / STEP
            values[2 + 2 * k, i], out[2 + 2 * k, i] = recall.real, recall.imag / STEP


@kernel
def _sense_derivative(sense: np.ndarray, h: float, law: Law, values: np.ndarray, out: np.ndarray) -> None:
    for i in range(len(sense)):
        there: Complex = complex(sense[i], h)
        factor: Complex = asymmetry_factor(there, law)
        values[i], out[i] = factor.real, factor.imag / STEP


@kernel
def set_pressure(log_j: np.ndarray, theta: np.ndarray, law: Law, out: np.ndarray) -> None:
    """k (4.8) of points (n_el, 8) into out (n_el, 8)."""
    for e in range(log_j.shape[0]):
        for q in range(log_j.shape[1]):
            out[e, q] = pressure_factor(log_j[e, q], np.exp(log_j[e, q]), theta[e, q], law)[0]


@kernel
def _yield_derivative(
    points: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    h: tuple[float, float, float, float],
    law: Law,
    sigma: np.ndarray,
    alpha: np.ndarray,
) -> None:
    alpha_n, lambda_n, d_lambda, theta = points
    for e in range(d_lambda.shape[0]):
        for q in range(d_lambda.shape[1]):
            sigma[e, q] = alpha[e, q] = 0.0
            if d_lambda[e, q] > 0.0:
                gamma: Complex = complex(d_lambda[e, q], h[2])
                start: Complex = complex(alpha_n[e, q], h[0])
                total: Complex = complex(lambda_n[e, q], h[1]) + gamma
                after: Complex = hardening_variable(start, gamma, law)[0]
                warm: Complex = complex(theta[e, q], h[3])
                value: Complex = yield_stress_at_rate(after, total, gamma * law.per_second, warm, law)
                sigma[e, q], alpha[e, q] = value.imag / STEP, after.imag / STEP


@kernel
def _pressure_derivative(points: tuple[np.ndarray, np.ndarray, np.ndarray], h: tuple[float, float], law: Law, out: np.ndarray) -> None:
    """points = (ln J, J, theta), each (n_el, 8)."""
    log_j, j, theta = points
    for e in range(log_j.shape[0]):
        for q in range(log_j.shape[1]):
            log_j_moved: Complex = complex(log_j[e, q], h[0])
            j_moved: Complex = complex(j[e, q], j[e, q] * h[0])
            theta_moved: Complex = complex(theta[e, q], h[1])
            value: Complex = pressure_factor(log_j_moved, j_moved, theta_moved, law)[0]
            out[e, q] = value.imag / STEP


@kernel
def _dissipation_derivative(
    points: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    h: tuple[float, float, float, float, float],
    law: Law,
    out: np.ndarray,
) -> None:
    for i in range(len(points[0])):
        if points[2][i] > 0.0:
            start: Complex = complex(points[0][i], h[0])
            end: Complex = complex(points[1][i], h[1])
            gamma: Complex = complex(points[2][i], h[2])
            total: Complex = complex(points[3][i], h[3])
            warm: Complex = complex(points[4][i], h[4])
            value: Complex = released_energy(start, end, gamma, total, warm, law)
            out[i] = value.imag / STEP
