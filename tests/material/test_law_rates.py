"""Derivatives of the law page by complex step: against central differences, and only where the law feels a number."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from point_tools import ANISOTROPIC

from thermofit.core.errors import StudyError
from thermofit.material.law import Law, dissipated_energy, hardening_variable, law_of, pressure_factor, yield_stress
from thermofit.material.law_rates import (
    N_NUMBERS,
    NUMBERS,
    directions,
    dissipation_gradients,
    number_rates,
    padded,
    pressure_gradients,
    yield_gradients,
)

EVERY = np.arange(N_NUMBERS)
PARAMETERS = ANISOTROPIC.replace(H_lin=35.0, alpha_exp=2e-5, theta_ref=296.7)


def central(f: Callable[[float], float], x: float) -> float:
    h = 1e-5 * max(abs(x), 1e-2)
    return (8.0 * (f(x + h) - f(x - h)) - (f(x + 2 * h) - f(x - 2 * h))) / (12.0 * h)


def along_numbers(f: Callable[[Law], float], law: Law) -> np.ndarray:
    """Central differences of f by every number of the law."""
    return np.array([central(lambda x, n=name: f(law._replace(**{n: x})), getattr(law, name)) for name in NUMBERS])


def points(*values: float) -> tuple[np.ndarray, ...]:
    return tuple(np.array([x]) for x in values)


def agree(found: np.ndarray, expected: np.ndarray) -> None:
    assert found == pytest.approx(expected, rel=2e-8, abs=1e-7 * max(np.abs(expected).max(), 1e-12))


@pytest.mark.parametrize("model", [1, 2])
@pytest.mark.parametrize("closed_form", [True, False])
@given(alpha=st.sampled_from([0.0, 0.004, 0.031, 0.06]), accumulated=st.floats(0.0, 0.3), gamma=st.floats(1e-3, 0.05))
def test_gradient_of_yield_stress_and_hardening_variable(
    model: int, closed_form: bool, alpha: float, accumulated: float, gamma: float
) -> None:
    law = law_of(PARAMETERS, model, closed_form=closed_form)
    out = yield_gradients(points(alpha, accumulated, gamma), law, EVERY)[:, :, 0]

    def both(a: float, total: float, g: float, law: Law) -> tuple[float, float]:
        after, _ = hardening_variable(a, g, law)
        return yield_stress(after, total + g, law)[0], after

    for row in (0, 1):
        by_arguments = [
            central(lambda x, r=row: both(x, accumulated, gamma, law)[r], alpha),
            central(lambda x, r=row: both(alpha, x, gamma, law)[r], accumulated),
            central(lambda x, r=row: both(alpha, accumulated, x, law)[r], gamma),
        ]
        agree(out[row, :3], np.array(by_arguments))
        agree(out[row, 3:], along_numbers(lambda moved, r=row: both(alpha, accumulated, gamma, moved)[r], law))


@pytest.mark.parametrize("model", [1, 2])
@pytest.mark.parametrize("closed_form", [True, False])
def test_gradient_of_the_dissipation(model: int, closed_form: bool) -> None:
    law = law_of(PARAMETERS, model, closed_form=closed_form)
    out = dissipation_gradients(points(0.02, 0.027, 0.012), law, EVERY).T
    arguments = [
        central(lambda x: dissipated_energy(x, 0.027, 0.012, law), 0.02),
        central(lambda x: dissipated_energy(0.02, x, 0.012, law), 0.027),
        central(lambda x: dissipated_energy(0.02, 0.027, x, law), 0.012),
    ]
    agree(out[0, :3], np.array(arguments))
    agree(out[0, 3:], along_numbers(lambda moved: dissipated_energy(0.02, 0.027, 0.012, moved), law))


def test_gradient_of_the_pressure_factor() -> None:
    law = law_of(PARAMETERS)
    out = pressure_gradients(points(0.004, 303.0), law, EVERY).T
    arguments = [
        central(lambda x: pressure_factor(x, float(np.exp(x)), 303.0, law)[0], 0.004),
        central(lambda x: pressure_factor(0.004, float(np.exp(0.004)), x, law)[0], 303.0),
    ]
    agree(out[0, :2], np.array(arguments))
    agree(out[0, 2:], along_numbers(lambda moved: pressure_factor(0.004, float(np.exp(0.004)), 303.0, moved)[0], law))
    assert out[0, 0] == pytest.approx(pressure_factor(0.004, float(np.exp(0.004)), 303.0, law)[1], rel=1e-13)


def test_numbers_follow_the_parameters_by_their_chain_rule() -> None:
    """K = E / 3 (1 - 2 nu): dK/dE = K/E, dK/dnu = 2 K / (1 - 2 nu); a parameter outside the law moves no number."""
    law = law_of(PARAMETERS)
    rates = number_rates(PARAMETERS, ("E", "nu", "M_y0", "alpha_air"), law)
    bulk = rates[NUMBERS.index("bulk")]
    assert bulk[0] == pytest.approx(law.bulk / PARAMETERS["E"], rel=1e-14)
    assert bulk[1] == pytest.approx(2.0 * law.bulk / (1.0 - 2.0 * PARAMETERS["nu"]), rel=1e-13)
    assert np.flatnonzero(rates[:, 2]).tolist() == [NUMBERS.index("M_y0")] and rates[NUMBERS.index("M_y0"), 2] == 1.0
    assert not rates[:, 3].any()
    with pytest.raises(StudyError, match="not known"):
        number_rates(PARAMETERS, ("Emodul",), law)


@pytest.mark.parametrize(("model", "heat"), [(1, ["M_y0", "beta"]), (2, ["M_y0", "M_yinf", "H_exp", "beta"])])
def test_only_what_the_law_feels_is_differentiated(model: int, heat: list[str]) -> None:
    names = tuple(p for p in PARAMETERS.values if p not in ("alpha_air", "alpha_clamp", "theta_air", "theta_clamp"))
    along = directions(PARAMETERS, names, law_of(PARAMETERS, model))
    assert [NUMBERS[i] for i in along.in_yield] == ["M_y0", "M_yinf", "H_exp", "H_lin"]
    assert [NUMBERS[i] for i in along.in_heat] == heat
    assert [NUMBERS[i] for i in along.in_pressure] == ["lame", "mu", "bulk", "alpha_exp", "theta_ref"]
    assert along.numbers.shape == (N_NUMBERS, padded(len(names))) and not along.numbers[:, len(names) :].any()
