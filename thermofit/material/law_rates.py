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
from thermofit.core.parameters import Parameters, param
from thermofit.material.law import Law, dissipated_energy, hardening_variable, law_of, pressure_factor, yield_stress

LANES = 8
"""Directions that are treated side by side; their number is filled up to a multiple of it with zero directions."""

NUMBERS: tuple[str, ...] = tuple(name for name in Law._fields if name not in ("model", "closed_form", "plastic"))
"""Names of the real numbers of a Law, in the order of its fields."""
N_NUMBERS = len(NUMBERS)
MU, BULK = NUMBERS.index("mu"), NUMBERS.index("bulk")
ALPHA_EXP, THETA_REF = NUMBERS.index("alpha_exp"), NUMBERS.index("theta_ref")
HILL = NUMBERS.index("F")
"""Place of F among the numbers; G, H, L, M, N follow."""

STEP = 1e-30


class Directions(NamedTuple):
    """Rates of the law's numbers and of parameters outside it, for n directions filled up to m, a multiple of LANES.

    `numbers` (N_NUMBERS, m); `in_yield`, `in_heat`, `in_pressure`: which numbers the yield stress with its hardening variable, the
    dissipation and the pressure factor depend on; `hill` (m / LANES,) is 1 for groups of LANES directions that move a Hill parameter.
    """

    numbers: np.ndarray
    in_yield: np.ndarray
    in_heat: np.ndarray
    in_pressure: np.ndarray
    hill: np.ndarray


def padded(n: int) -> int:
    """n filled up to a multiple of LANES."""
    return -(-n // LANES) * LANES


def number_rates(parameters: Parameters, names: Sequence[str], law: Law) -> np.ndarray:
    """d number / d parameter (N_NUMBERS, len(names)) at given parameters, by complex step of `law_of`."""
    out = np.zeros((N_NUMBERS, len(names)))
    for column, name in enumerate(names):
        param(name)
        moved = Parameters({**parameters.values, name: complex(parameters[name], STEP)}, parameters.free)  # type: ignore[dict-item]
        there = law_of(moved, law.model, closed_form=bool(law.closed_form), plastic=bool(law.plastic))
        out[:, column] = [np.imag(getattr(there, number)) / STEP for number in NUMBERS]
    return out


def directions(parameters: Parameters, names: Sequence[str], law: Law) -> Directions:
    """Directions along the named parameters."""
    numbers = np.zeros((N_NUMBERS, padded(len(names))))
    numbers[:, : len(names)] = number_rates(parameters, names, law)
    moved = np.any(numbers != 0.0, axis=1)
    hill = np.any(numbers[HILL : HILL + 6].reshape(6, -1, LANES) != 0.0, axis=(0, 2))
    return Directions(
        numbers,
        _felt(yield_gradient, (0.031, 0.017, 0.007), 2, law, moved),
        _felt(dissipation_gradient, (0.031, 0.036, 0.007), 1, law, moved),
        _felt(pressure_gradient, (0.003, 297.3), 1, law, moved),
        hill.astype(np.int64),
    )


def _felt(gradient: Callable[..., None], arguments: tuple[float, ...], rows: int, law: Law, moved: np.ndarray) -> np.ndarray:
    """Numbers that a function of the law page depends on at a general point, of those that any direction moves."""
    out = np.zeros((rows, len(arguments) + N_NUMBERS))
    generic = law._replace(theta_ref=law.theta_ref - 1.7) if law.theta_ref == arguments[-1] else law
    gradient(*arguments, generic, np.arange(N_NUMBERS), out)
    return np.flatnonzero(moved & np.any(out[:, len(arguments) :] != 0.0, axis=0)).astype(np.int64)


Complex = Any
"""A complex number where the law page, written for real ones, says float."""


@kernel(forceinline=True)
def _number(value: float, moved: bool) -> Complex:
    return complex(value, STEP if moved else 0.0)


@kernel(forceinline=True)
def _moved(law: Law, which: int) -> Law:
    """The law with one of its numbers moved by i h (none for a negative `which`)."""
    return Law(
        _number(law.lame, which == 0),
        _number(law.mu, which == 1),
        _number(law.bulk, which == 2),
        _number(law.M_y0, which == 3),
        _number(law.M_yinf, which == 4),
        _number(law.H_exp, which == 5),
        _number(law.H_lin, which == 6),
        _number(law.F, which == 7),
        _number(law.G, which == 8),
        _number(law.H, which == 9),
        _number(law.L, which == 10),
        _number(law.M, which == 11),
        _number(law.N, which == 12),
        _number(law.alpha_exp, which == 13),
        _number(law.kappa, which == 14),
        _number(law.c0, which == 15),
        _number(law.beta, which == 16),
        _number(law.theta_ref, which == 17),
        law.model,
        law.closed_form,
        law.plastic,
    )


@kernel
def _yield_and_alpha(alpha_n: Complex, lambda_n: Complex, d_lambda: Complex, law: Law) -> tuple[Complex, Complex]:
    alpha, _ = hardening_variable(alpha_n, d_lambda, law)
    value, _, _ = yield_stress(alpha, lambda_n + d_lambda, law)
    return value, alpha


@kernel
def yield_gradient(alpha_n: float, lambda_n: float, d_lambda: float, law: Law, active: np.ndarray, out: np.ndarray) -> None:
    """Gradients of the yield stress (row 0 of out) and of alpha (row 1) after an increment, (2, 3 + N_NUMBERS).

    Columns: by alpha_n, Lambda_n, dLambda, then by the numbers listed in `active` (others are left as they are).
    """
    still = _moved(law, -1)
    value, alpha = _yield_and_alpha(complex(alpha_n, STEP), complex(lambda_n, 0.0), complex(d_lambda, 0.0), still)
    out[0, 0], out[1, 0] = value.imag / STEP, alpha.imag / STEP
    value, alpha = _yield_and_alpha(complex(alpha_n, 0.0), complex(lambda_n, STEP), complex(d_lambda, 0.0), still)
    out[0, 1], out[1, 1] = value.imag / STEP, alpha.imag / STEP
    value, alpha = _yield_and_alpha(complex(alpha_n, 0.0), complex(lambda_n, 0.0), complex(d_lambda, STEP), still)
    out[0, 2], out[1, 2] = value.imag / STEP, alpha.imag / STEP
    for which in active:
        value, alpha = _yield_and_alpha(complex(alpha_n, 0.0), complex(lambda_n, 0.0), complex(d_lambda, 0.0), _moved(law, which))
        out[0, 3 + which], out[1, 3 + which] = value.imag / STEP, alpha.imag / STEP


@kernel
def _dissipated(alpha_n: Complex, alpha: Complex, d_lambda: Complex, law: Law) -> Complex:
    return dissipated_energy(alpha_n, alpha, d_lambda, law)


@kernel
def dissipation_gradient(alpha_n: float, alpha: float, d_lambda: float, law: Law, active: np.ndarray, out: np.ndarray) -> None:
    """Gradient of the dissipated energy of an increment into out (1, 3 + N_NUMBERS): by alpha_n, alpha, dLambda, then by `active`."""
    still = _moved(law, -1)
    out[0, 0] = _dissipated(complex(alpha_n, STEP), complex(alpha, 0.0), complex(d_lambda, 0.0), still).imag / STEP
    out[0, 1] = _dissipated(complex(alpha_n, 0.0), complex(alpha, STEP), complex(d_lambda, 0.0), still).imag / STEP
    out[0, 2] = _dissipated(complex(alpha_n, 0.0), complex(alpha, 0.0), complex(d_lambda, STEP), still).imag / STEP
    for which in active:
        moved = _moved(law, which)
        out[0, 3 + which] = _dissipated(complex(alpha_n, 0.0), complex(alpha, 0.0), complex(d_lambda, 0.0), moved).imag / STEP


@kernel
def _pressure(log_j: Complex, theta: Complex, law: Law) -> Complex:
    value, _ = pressure_factor(log_j, np.exp(log_j), theta, law)
    return value


@kernel
def pressure_gradient(log_j: float, theta: float, law: Law, active: np.ndarray, out: np.ndarray) -> None:
    """Gradient of k (4.8) into out (1, 2 + N_NUMBERS): by ln J and theta, then by the numbers in `active`."""
    still = _moved(law, -1)
    out[0, 0] = _pressure(complex(log_j, STEP), complex(theta, 0.0), still).imag / STEP
    out[0, 1] = _pressure(complex(log_j, 0.0), complex(theta, STEP), still).imag / STEP
    for which in active:
        out[0, 2 + which] = _pressure(complex(log_j, 0.0), complex(theta, 0.0), _moved(law, which)).imag / STEP
