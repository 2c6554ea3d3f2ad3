"""Voce's law where H_exp alpha = ln 2: half of the way to saturation."""

from math import exp, log

from hardening_law import check_closed_form

HALF = log(2.0) / 10.0


def test_closed_form() -> None:
    """Of 160 MPa half are reached at ln 2 / 10; stored 160 (ln 2 - 1/2) / 10 mJ/mm^3."""
    check_closed_form(
        "voce",
        {"M_y0": 130.0, "M_yinf": 290.0, "H_exp": 10.0, "H_lin": 0.0},
        ((0.0, 130.0, 1600.0, 0.0), (HALF, 210.0, 800.0, 16.0 * (log(2.0) - 0.5)), (2 * HALF, 250.0, 400.0, 16.0 * (log(4.0) - 0.75))),
        lambda alpha: 290.0 - 160.0 * exp(-10.0 * alpha),
    )


def test_with_linear_hardening() -> None:
    check_closed_form(
        "voce",
        {"M_y0": 130.0, "M_yinf": 290.0, "H_exp": 10.0, "H_lin": 200.0},
        ((HALF, 210.0 + 200.0 * HALF, 1000.0, 16.0 * (log(2.0) - 0.5) + 100.0 * HALF**2),),
        lambda alpha: 290.0 - 160.0 * exp(-10.0 * alpha) + 200.0 * alpha,
    )
