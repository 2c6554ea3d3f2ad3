"""Hockett and Sherby's law: Voce's at exponent 1, by hand at exponent 2, and what little the shifted begin changes at exponent 1/2."""

from math import exp, log, sqrt

import pytest
from hardening_law import check_closed_form, curve_of
from scipy.special import erf

LIMITS = {"M_y0": 100.0, "M_yinf": 300.0, "H_exp": 5.0}
BEGIN = 1e-4


def by_hand(exponent: float, alpha: float) -> float:
    """300 - 200 exp(b^p - (5 alpha + b)^p), b = 1e-4."""
    return 300.0 - 200.0 * exp(BEGIN**exponent - (5.0 * alpha + BEGIN) ** exponent)


def test_exponent_one_is_voce() -> None:
    half = log(2.0) / 5.0
    check_closed_form(
        "hockett_sherby",
        {**LIMITS, "hockett_sherby.exponent": 1.0},
        ((0.0, 100.0, 1000.0, 0.0), (half, 200.0, 500.0, 40.0 * (log(2.0) - 0.5))),
        lambda a: 300.0 - 200.0 * exp(-5.0 * a),
    )


def test_exponent_two_is_a_bell() -> None:
    """1 - exp(-z^2), whose integral is an error function; the shift of the begin is told exactly."""
    root = sqrt(log(2.0)) - BEGIN
    alpha = root / 5.0
    rest = 0.5 * exp(BEGIN**2)
    energy = 200.0 * (alpha - exp(BEGIN**2) * 0.5 * sqrt(3.141592653589793) * (erf(root + BEGIN) - erf(BEGIN)) / 5.0)
    slope = 200.0 * rest * 2.0 * sqrt(log(2.0)) * 5.0
    check_closed_form(
        "hockett_sherby",
        {**LIMITS, "hockett_sherby.exponent": 2.0},
        ((alpha, 300.0 - 200.0 * rest, slope, energy),),
        lambda a: by_hand(2.0, a),
    )


@pytest.mark.parametrize("exponent", [0.3, 0.5, 0.8])
def test_below_one(exponent: float) -> None:
    """The stored energy by its series against quadrature; the shift changes the published curve by 200 MPa b^p at most."""
    values = {**LIMITS, "hockett_sherby.exponent": exponent}
    check_closed_form("hockett_sherby", values, (), lambda a: by_hand(exponent, a))
    for alpha in (0.01, 0.1, 0.5):
        published = 300.0 - 200.0 * exp(-((5.0 * alpha) ** exponent))
        assert abs(curve_of("hockett_sherby", values)(alpha) - published) < 200.0 * BEGIN**exponent
