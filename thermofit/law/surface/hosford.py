"""Hosford's isotropic surface with an exponent: a = 2 and a = 4 are von Mises, a = 6 is usual for bcc and a = 8 for fcc metals.

Between a = 4 and large exponents, which go to Tresca, it is flatter where two principal stresses are equal in size, and sharper between.
"""

from __future__ import annotations

from thermofit.core.parameters import Param

PARAMS = (Param("hosford.a", "1", 2.0, 2.0, 20.0, 8.0, "exponent; 6 for bcc, 8 for fcc metals"),)
FITTED = ("hosford.a",)
LITERATURE = {"hosford.a": 8.0}
FORMULA = "phi^a = (|S1 - S2|^a + |S2 - S3|^a + |S3 - S1|^a) / 2 of the principal stresses"
SOURCE = "Hosford 1972, Journal of Applied Mechanics 39"
MEANING = {"hosford.a": "exponent: 6 for bcc, 8 for fcc metals"}


def numbers(a: float) -> tuple[float, ...]:
    """Exponent, and no transformation."""
    return (a, *(1.0,) * 18)
