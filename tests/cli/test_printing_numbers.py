"""Numbers as a human reads them."""

from __future__ import annotations

import pytest

from thermofit.cli.printing import bounds, number, percent, seconds, with_error


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (68721.2292, 1421.4091, ("68721", "1421")),
        (0.346789, 0.0112, ("0.347", "0.011")),
        (128.916, 0.04321, ("128.916", "0.043")),
        (2.02134e-5, 3.14e-8, ("2.0213e-05", "3.1e-08")),
        (1.0e8, 2.0e6, ("1.000e+08", "2.0e+06")),
        (0.0, 0.5, ("0.00", "0.50")),
        (-3.14159, 0.02, ("-3.142", "0.020")),
        (0.79, None, ("0.79", "-")),
        (0.79, float("inf"), ("0.79", "-")),
        (0.79, 0.0, ("0.79", "-")),
        (2.0, 30.0, ("2", "30")),
    ],
)
def test_value_has_the_digits_of_its_error(value: float, sigma: float | None, expected: tuple[str, str]) -> None:
    assert with_error(value, sigma) == expected


def test_small_pieces() -> None:
    assert [number(x) for x in (None, True, False, 3, "text", 0.123456789)] == ["-", "yes", "no", "3", "text", "0.12346"]
    assert bounds(30000.0, 150000.0) == "30000 .. 150000"
    assert (percent(None), percent(-0.01234)) == ("-", "-1.23 %")
    assert (seconds(2.345), seconds(62.9), seconds(3600.0)) == ("2.3 s", "1 min 02 s", "60 min 00 s")
