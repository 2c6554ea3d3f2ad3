"""Derivatives of the law page by complex step: against central differences, and only where the law feels a number."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from point_tools import ANISOTROPIC, PROBES

from thermofit.core.errors import StudyError
from thermofit.effects.catalogue import Effect, effect
from thermofit.law.composition import STRUCTURE, law_effects, number_of
from thermofit.law.hardening.table import STRAINS, STRESSES
from thermofit.law.page import (
    Law,
    dissipated_energy,
    flow_stress,
    hardening_variable,
    law_in_step,
    law_of,
    pressure_factor,
    released_energy,
    yield_stress,
)
from thermofit.law.page_rates import (
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
EFFECTIVE = PARAMETERS.replace(**PROBES)
"""Every effect of the law at its probe."""


def central(f: Callable[[float], float], x: float) -> float:
    h = 1e-5 * max(abs(x), 1e-2)
    return (8.0 * (f(x + h) - f(x - h)) - (f(x + 2 * h) - f(x - 2 * h))) / (12.0 * h)


def along_numbers(f: Callable[[Law], float], law: Law) -> np.ndarray:
    """Central differences of f by every number of the law; zero for those that it does not have."""
    here = [name if name in law._fields else "" for name in NUMBERS]
    return np.array([central(lambda x, n=name: f(law._replace(**{n: x})), getattr(law, name)) if name else 0.0 for name in here])


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
    law = law_in_step(law_of(EFFECTIVE, model, closed_form=closed_form), 2.5)
    out = yield_gradients(points(alpha, accumulated, gamma, 303.0), law, EVERY)[:, :, 0]

    def both(a: float, total: float, g: float, law: Law, theta: float = 303.0) -> tuple[float, float]:
        after, _ = hardening_variable(a, g, law)
        return flow_stress(after, total + g, g, theta, law)[0], after

    for row in (0, 1):
        by_arguments = [
            central(lambda x, r=row: both(x, accumulated, gamma, law)[r], alpha),
            central(lambda x, r=row: both(alpha, x, gamma, law)[r], accumulated),
            central(lambda x, r=row: both(alpha, accumulated, x, law)[r], gamma),
            central(lambda x, r=row: both(alpha, accumulated, gamma, law, x)[r], 303.0),
        ]
        agree(out[row, :4], np.array(by_arguments))
        agree(out[row, 4:], along_numbers(lambda moved, r=row: both(alpha, accumulated, gamma, moved)[r], law))


@pytest.mark.parametrize("model", [1, 2])
@pytest.mark.parametrize("closed_form", [True, False])
def test_gradient_of_the_dissipation(model: int, closed_form: bool) -> None:
    law = law_in_step(law_of(EFFECTIVE, model, closed_form=closed_form), 2.5)
    at = (0.02, 0.027, 0.012, 0.031, 303.0)
    out = dissipation_gradients(points(*at), law, EVERY).T
    arguments = [central(lambda x, k=k: released_energy(*at[:k], x, *at[k + 1 :], law), at[k]) for k in range(5)]
    agree(out[0, :5], np.array(arguments))
    agree(out[0, 5:], along_numbers(lambda moved: released_energy(*at, moved), law))


@pytest.mark.parametrize("effect", [e for e in law_effects() if e.slot not in STRUCTURE], ids=lambda e: e.name)
def test_an_effect_at_neutral_is_off_and_its_amplitude_is_still_felt(effect: Effect) -> None:
    """Exactly the base law whatever the other Params of the effect are; the derivative by the amplitude is that of a difference."""
    others = {p.name: p.scan[-1] if p.scan else p.neutral for p in effect.params[1:]}
    off = law_in_step(law_of(PARAMETERS.replace(**others, **{effect.amplitude.name: effect.amplitude.neutral}), 2), 2.5)
    assert flow_stress(0.04, 0.05, 0.012, 303.0, off)[0] == yield_stress(0.04, 0.05, off)[0]
    assert released_energy(0.03, 0.04, 0.012, 0.05, 303.0, off) == dissipated_energy(0.03, 0.04, 0.012, off)
    number = NUMBERS.index(number_of(effect.amplitude.name))
    h = 1e-4 * effect.amplitude.scale
    on = off._replace(**{NUMBERS[number]: effect.amplitude.neutral + h}, effective=1)
    heat = dissipation_gradients(points(0.03, 0.04, 0.012, 0.05, 303.0), off, np.array([number]))[5, 0]
    expected = (released_energy(0.03, 0.04, 0.012, 0.05, 303.0, on) - released_energy(0.03, 0.04, 0.012, 0.05, 303.0, off)) / h
    assert heat == pytest.approx(expected, rel=2e-3, abs=1e-6)
    stress = yield_gradients(points(0.03, 0.038, 0.012, 303.0), off, np.array([number]))[0, 4, 0]
    alpha, _ = hardening_variable(0.03, 0.012, off)
    assert stress == pytest.approx(
        (flow_stress(alpha, 0.05, 0.012, 303.0, on)[0] - flow_stress(alpha, 0.05, 0.012, 303.0, off)[0]) / h, rel=2e-3, abs=1e-9
    )
    assert abs(stress) + abs(heat) > 0.0


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


@pytest.mark.parametrize("reach", [0.01, 0.15, 1.0])
def test_a_number_that_acts_over_few_strains_is_felt(reach: float) -> None:
    """A step of a curve acts behind its place, a knot of a table between its neighbours: no single strain shows all of them."""
    curve = effect("hardening_curve")
    steps = tuple(p.name for p in curve.amplitudes)
    here = PARAMETERS.replace(**{"hardening_curve.level": 2.0, "hardening_curve.range": reach})
    assert {NUMBERS[i] for i in directions(here, steps, law_of(here)).in_yield} == {number_of(name) for name in steps}
    strains = {name: reach * share for name, share in zip(STRAINS, (0.02, 0.1, 0.11, 0.5, 1.0), strict=True)}
    stresses = dict(zip(STRESSES, (140.0, 160.0, 162.0, 247.0, 280.0), strict=True))
    table = PARAMETERS.replace(**strains, **stresses)
    names = ("M_y0", *STRESSES)
    found = directions(table, names, law_of(table, "table"))
    rates = number_rates(table, names, law_of(table, "table"))
    assert {NUMBERS[i] for i in np.flatnonzero(np.any(rates != 0.0, axis=1))} == {NUMBERS[i] for i in found.in_yield}
