"""Units of native files: exact factors, spellings, and refusal of what is not known."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.units import known_unit, to_fixed

EXACT = [
    (1.0, "mm", 1.0, "mm"),
    (1.0, "\u00b5m", 1e-3, "mm"),
    (2.0, "m", 2000.0, "mm"),
    (1.0, "in", 25.4, "mm"),
    (1.0, "1e-3 in", 0.0254, "mm"),
    (3.0, "Pixel", 3.0, "px"),
    (250.0, "ms", 0.25, "s"),
    (2.0, "min", 120.0, "s"),
    (1.0, "h", 3600.0, "s"),
    (3.0, "(kN)", 3000.0, "N"),
    (1.0, "lbf", 4.4482216152605, "N"),
    (1.0, "GPa", 1000.0, "MPa"),
    (1e6, "Pa", 1.0, "MPa"),
    (1.0, "psi", 4.4482216152605 / 645.16, "MPa"),
    (1.0, "ksi", 4448.2216152605 / 645.16, "MPa"),
    (1.0, "N/mm\u00b2", 1.0, "MPa"),
    (20.0, "\u00b0C", 293.15, "K"),
    (212.0, "degF", 373.15, "K"),
    (491.67, "degR", 273.15, "K"),
    (1500.0, "mK", 1.5, "K"),
    (5.0, "%", 0.05, "1"),
    (5.0, "[-]", 5.0, "1"),
    (7.0, "\u00b5m/m", 7e-6, "1"),
    (7.0, "microstrain", 7e-6, "1"),
]


@pytest.mark.parametrize(("value", "unit", "expected", "fixed"), EXACT)
def test_factor_is_exact(value: float, unit: str, expected: float, fixed: str) -> None:
    converted, name = to_fixed(np.array([value, np.nan]), unit)
    assert name == fixed
    np.testing.assert_allclose(converted, [expected, np.nan], rtol=1e-15)


def test_case_decides_where_units_differ_by_it() -> None:
    assert known_unit("mPa") is None
    assert known_unit("MK") is None
    assert known_unit("SEC") == known_unit("s")
    assert known_unit("Kn") is None


@pytest.mark.parametrize("unit", ["", " ", "furlong", "V", "n", "k"])
def test_unknown_unit_is_refused(unit: str) -> None:
    with pytest.raises(ValueError, match="is not known, expected one of mm"):
        to_fixed(1.0, unit)
