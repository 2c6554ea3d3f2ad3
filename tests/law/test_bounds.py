"""Bounds of beta against the figures of the thesis and against the dissipation itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.law.bounds import beta_warning
from thermofit.law.hardening.model2 import beta_bounds


def dissipation(beta: float, M_y0: float, M_yinf: float, b: float, alpha: np.ndarray) -> np.ndarray:
    """Dissipation per d Lambda of model 2 (4.22), MPa."""
    h = b * (M_yinf - M_y0)
    return b * h * alpha**2 + (1.0 - beta) * b * M_y0 * alpha + beta * M_y0


@pytest.mark.parametrize(("M_y0", "M_yinf", "H_exp", "upper"), [(130.38, 295.60, 10.92, 6.92), (129.28, 293.36, 10.97, 6.93)])
def test_upper_bound_is_the_printed_one(M_y0: float, M_yinf: float, H_exp: float, upper: float) -> None:
    assert beta_bounds(M_y0, M_yinf, H_exp)[1] == pytest.approx(upper, abs=0.01)


def test_nominal_bounds() -> None:
    assert beta_bounds(128.92, 292.73, 10.87) == pytest.approx((0.144, 6.94), abs=0.005)


@given(st.floats(1.0, 1e3), st.floats(1.01, 10.0), st.floats(0.1, 1e3))
def test_dissipation_just_touches_zero_at_the_bounds(M_y0: float, ratio: float, b: float) -> None:
    """Over all alpha of the real line the minimum of (4.22) is zero at beta_l and beta_u, and negative outside."""
    M_yinf = ratio * M_y0
    lower, upper = beta_bounds(M_y0, M_yinf, b)
    assert 0.0 < lower < 1.0 < upper

    def minimum(beta: float) -> float:
        alpha = (beta - 1.0) * M_y0 / (2.0 * b * (M_yinf - M_y0))
        return float(dissipation(beta, M_y0, M_yinf, b, np.array([alpha]))[0]) / M_y0

    size = 1.0 + upper
    assert minimum(lower) == pytest.approx(0.0, abs=1e-9 * size) and minimum(upper) == pytest.approx(0.0, abs=1e-9 * size)
    assert minimum(0.5 * (lower + upper)) > 0.0
    assert minimum(1.01 * upper) < 0.0 and minimum(0.99 * lower) < 0.0


@given(st.floats(0.0, 100.0))
def test_bounds_are_sufficient_not_necessary(beta: float) -> None:
    """On 0 <= alpha <= 1/b, all that the model reaches, no beta >= 0 makes the dissipation negative."""
    b = 10.87
    assert dissipation(beta, 128.92, 292.73, b, np.linspace(0.0, 1.0 / b, 200)).min() >= -1e-9


@pytest.mark.parametrize("beta", [0.0, 0.05, 0.79, 1.0, 6.9])
def test_no_warning_inside(beta: float) -> None:
    assert beta_warning(Parameters.of({"beta": beta, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87}), 2) is None


def test_warning_outside_names_value_and_bound() -> None:
    parameters = Parameters.of({"beta": 7.0, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87})
    text = beta_warning(parameters, 2)
    assert text is not None and "beta = 7" in text and "6.9" in text
    assert beta_warning(parameters, 1) is None


@pytest.mark.parametrize("values", [(130.0, 130.0, 10.0), (0.0, 130.0, 10.0), (130.0, 290.0, 0.0), (float("nan"), 290.0, 1.0)])
def test_no_bounds_without_hardening(values: tuple[float, float, float]) -> None:
    with pytest.raises(StudyError, match="expected 0 < M_y0"):
        beta_bounds(*values)
