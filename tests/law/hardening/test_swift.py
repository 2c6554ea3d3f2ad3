"""Swift's law where 1 + Lambda / e0 is a square and a fourth power, and against the form as published."""

from hardening_law import check_closed_form


def test_closed_form() -> None:
    """100 MPa (1 + Lambda / 0.01)^(1/2): twice at three e0, three times at eight; stored 100 [e0 (r^3 - 1) / 1.5 - Lambda] for r = 2, 3."""
    check_closed_form(
        "swift",
        {"M_y0": 100.0, "swift.e0": 0.01, "swift.n": 0.5},
        ((0.0, 100.0, 5000.0, 0.0), (0.03, 200.0, 2500.0, 14.0 / 3.0 - 3.0), (0.08, 300.0, 5000.0 / 3.0, 52.0 / 3.0 - 8.0)),
        lambda alpha: 100.0 * (1.0 + alpha / 0.01) ** 0.5,
    )


def test_as_published() -> None:
    """K (e0 + Lambda)^n with K = M_y0 / e0^n: 500 MPa (0.0016 + Lambda)^0.25 begins at 100 MPa and doubles at 0.0256."""
    values = {"M_y0": 100.0, "swift.e0": 0.0016, "swift.n": 0.25}
    check_closed_form("swift", values, ((0.0240, 200.0, 1953.125, 1.568),), lambda alpha: 500.0 * (0.0016 + alpha) ** 0.25)


def test_without_exponent_nothing_hardens() -> None:
    check_closed_form("swift", {"M_y0": 150.0, "swift.e0": 0.01, "swift.n": 0.0}, ((0.2, 150.0, 0.0, 0.0),), lambda alpha: 150.0)
