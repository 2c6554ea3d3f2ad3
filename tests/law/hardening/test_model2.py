"""Model 2 of the thesis: linear in alpha, h = 10 x 160 MPa, and alpha saturates at 1 / 10."""

from math import log

import pytest
from hardening_law import check_closed_form

from thermofit.core.parameters import Parameters
from thermofit.law.page import dissipated_energy, hardening_variable, law_of

VALUES = {"M_y0": 130.0, "M_yinf": 290.0, "H_exp": 10.0}


def test_closed_form() -> None:
    check_closed_form(
        "model2", VALUES, ((0.0, 130.0, 1600.0, 0.0), (0.05, 210.0, 1600.0, 2.0), (0.1, 290.0, 1600.0, 8.0)), lambda a: 130.0 + 1600.0 * a
    )


def test_alpha_saturates() -> None:
    """From 0 half of 1/b after ln 2 / b; from there half of the rest; backward Euler (alpha_n + dLambda) / (1 + b dLambda)."""
    law = law_of(Parameters.of({"theta_ref": 297.0, **VALUES}), "model2")
    assert hardening_variable(0.0, log(2.0) / 10.0, law) == pytest.approx((0.05, 0.5))
    assert hardening_variable(0.05, log(2.0) / 10.0, law) == pytest.approx((0.075, 0.25))
    euler = law_of(Parameters.of({"theta_ref": 297.0, **VALUES}), "model2", closed_form=False)
    assert hardening_variable(0.05, 0.1, euler) == pytest.approx((0.075, 0.125))


def test_dissipation_by_hand() -> None:
    """(4.22) with beta = 1: b h alpha^2 + M_y0, integrated from 0 over ln 2 / b with alpha = (1 - exp(-b Lambda)) / b."""
    law = law_of(Parameters.of({"theta_ref": 297.0, "beta": 1.0, **VALUES}), "model2")
    x = log(2.0)
    assert dissipated_energy(0.0, 0.05, x / 10.0, law) == pytest.approx(16.0 * (x - 1.0 + 0.375) + 13.0 * x)
