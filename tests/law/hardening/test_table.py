"""The table: its knots, scipy's monotone cubic between them, straight beyond, and what it refuses."""

import numpy as np
import pytest
from hardening_law import check_closed_form, curve_of
from scipy.interpolate import PchipInterpolator

from thermofit.law.hardening.catalogue import hardening
from thermofit.law.hardening.table import STRAINS, STRESSES

X = (0.004, 0.02, 0.07, 0.15, 0.4)
RISING = (120.0, 170.0, 230.0, 231.0, 290.0)
WITH_DROP = (120.0, 118.0, 118.0, 160.0, 150.0)


def values(y: tuple[float, ...]) -> dict[str, float]:
    return {"M_y0": 100.0, **dict(zip(STRAINS, X, strict=True)), **dict(zip(STRESSES, y, strict=True))}


def by_scipy(y: tuple[float, ...], alpha: float) -> float:
    cubic = PchipInterpolator((0.0, *X), (100.0, *y))
    return float(cubic(min(alpha, X[-1])) + cubic(X[-1], 1) * max(alpha - X[-1], 0.0))


@pytest.mark.parametrize("y", [RISING, WITH_DROP], ids=["rising", "with a drop"])
def test_closed_form(y: tuple[float, ...]) -> None:
    """At the knots the table, between them the cubic of Fritsch and Butland, its slope and its integral."""
    cubic = PchipInterpolator((0.0, *X), (100.0, *y))
    points = tuple((x, value, float(cubic(x, 1)), float(cubic.integrate(0.0, x)) - 100.0 * x) for x, value in zip(X, y, strict=True))
    check_closed_form("table", values(y), points, lambda a: by_scipy(y, a))


def test_a_straight_line_stays_one() -> None:
    straight = tuple(100.0 + 500.0 * x for x in X)
    check_closed_form("table", values(straight), ((0.07, 135.0, 500.0, 1.225), (0.6, 400.0, 500.0, 90.0)), lambda a: 100.0 + 500.0 * a)


def test_rising_values_make_a_rising_curve() -> None:
    found = curve_of("table", values(RISING))(np.linspace(0.0, 0.6, 4001))
    assert (np.diff(found) >= -1e-12).all() and found.max() < 1.4 * RISING[-1]


def test_what_must_rise() -> None:
    table = hardening("table")
    assert table.error(values(RISING)) is None
    assert table.error(values((*RISING[:4], 200.0))) == (
        "table.stress5",
        "is 200 MPa; expected more than table.stress4 = 231 MPa (strains and yield stresses of the table must rise)",
    )
    name, text = table.error({**values(RISING), "table.strain2": 0.003}) or ("", "")
    assert name == "table.strain2" and "is 0.003; expected more than table.strain1 = 0.004 (" in text
