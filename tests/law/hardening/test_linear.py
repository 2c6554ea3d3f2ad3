"""Linear hardening: the straight line, half of its rise times strain stored."""

from hardening_law import check_closed_form


def test_closed_form() -> None:
    check_closed_form(
        "linear",
        {"M_y0": 200.0, "H_lin": 500.0},
        ((0.0, 200.0, 500.0, 0.0), (0.1, 250.0, 500.0, 2.5), (0.4, 400.0, 500.0, 40.0)),
        lambda a: 200.0 + 500.0 * a,
    )
