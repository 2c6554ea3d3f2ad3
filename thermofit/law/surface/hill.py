"""Hill's quadratic surface of 1948: orthotropic, six constants; the surface of the thesis and of a study that names none.

Uniaxial tension along axis 2 yields at sigma_y / sqrt(F + H); the width-to-thickness ratio of its plastic strains is r = F / H.
"""

from __future__ import annotations

from collections.abc import Mapping

PARAMS = ("F", "G", "H", "L", "M", "N")
FITTED = ("F",)
FORMULA = "phi^2 = F (S11 - S22)^2 + G (S33 - S11)^2 + H (S22 - S33)^2 + 2 L S12^2 + 2 M S23^2 + 2 N S13^2"
SOURCE = "Hill 1948, Proceedings of the Royal Society A 193; thesis (4.19)"
MEANING = {"F": "Hill parameter; load along y: width-to-thickness ratio r = F/H"}


def turned(values: Mapping[str, float]) -> dict[str, float]:
    """Axes 1 and 2 change places: G with H, M with N (4.19)."""
    return {"G": values["H"], "H": values["G"], "M": values["N"], "N": values["M"]}
