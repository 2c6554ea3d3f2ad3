"""Effects that only coupon records can tell, against numbers worked out by hand from the formulas in their sources."""

from __future__ import annotations

from math import log, sqrt

import pytest

from thermofit.core.parameters import param
from thermofit.effects.catalogue import effect

NONE = None
"""An argument that the effect must not look at."""


def test_tension_compression() -> None:
    act = effect("tension_compression").act
    assert act(1.0, NONE, 0.25) == 1.0 and act(-1.0, NONE, 0.25) == 1.25 and act(-1.0, NONE, -0.1) == pytest.approx(0.9, rel=1e-15)


def test_softening_is_a_power_of_the_temperature_and_linear_at_one() -> None:
    """100 K above: the amount, whatever the exponent; 400 K above: 2, 4 and 8 times it at exponents 1/2, 1 and 3/2; odd below."""
    act = effect("softening_power").act
    for exponent, times in ((0.5, 2.0), (1.0, 4.0), (1.5, 8.0)):
        assert act(0.1, 1e-3, 393.15, NONE, 0.05, exponent) == pytest.approx(0.95, rel=1e-4)
        assert act(0.1, 1e-3, 693.15, NONE, 0.05, exponent) == pytest.approx(1.0 - 0.05 * times, rel=1e-4)
    assert act(0.1, 1e-3, 193.15, NONE, 0.05, 3.0) == pytest.approx(1.05, rel=1e-4)
    assert act(0.1, 1e-3, 333.15, NONE, 0.05, 1.0) == pytest.approx(0.98, rel=1e-14), "exactly linear, without any rounding"
    assert act(0.1, 1e-3, 293.15, NONE, 0.05, 0.5) == 1.0


def test_softening_of_johnson_and_cook_is_one_of_it() -> None:
    """1 - ((T - T_r) / (T_m - T_r))^m of a steel, T_m = 1793 K, m = 1.03: amount = (100 / 1500)^m."""
    m, melts = 1.03, 1793.15
    amount = (100.0 / (melts - 293.15)) ** m
    for theta in (400.0, 700.0, 1200.0):
        expected = 1.0 - ((theta - 293.15) / (melts - 293.15)) ** m
        assert effect("softening_power").act(0.0, 0.0, theta, NONE, amount, m) == pytest.approx(expected, rel=1e-5)


def test_rate_dependence_that_grows_with_temperature() -> None:
    """(1 + rate / reference) = 8 at 100 K, 50 K and 0 K above: 1 + 3 C ln 2, half of it, nothing; the other sign below."""
    act, three = effect("rate_by_temperature").act, 3.0 * log(2.0)
    for above, share in ((100.0, 1.0), (50.0, 0.5), (0.0, 0.0), (-100.0, -1.0)):
        assert act(0.2, 7e-4, 293.15 + above, NONE, 0.02, 1e-4) == pytest.approx(1.0 + 0.02 * share * three, rel=1e-12)
    assert act(0.2, 0.0, 500.0, NONE, 0.02, 1e-4) == 1.0, "none at rest"


def test_backstresses_are_tried_up_to_those_that_round_the_knee() -> None:
    """C / gamma of dX = C N dLambda - gamma X dLambda is what a fast one saturates at; it is there within a few 1e-4 of flow."""
    gamma = param("backstress_first.gamma")
    assert max(gamma.scan) == 5000.0 and gamma.upper >= 2.0 * max(gamma.scan)
    assert all(b / a <= sqrt(12.0) for a, b in zip(gamma.scan, gamma.scan[1:], strict=False)), "no gap between two that are tried"
