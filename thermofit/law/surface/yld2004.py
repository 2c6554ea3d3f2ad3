"""Barlat's orthotropic surface Yld2004-18p: an exponent and two linear transformations of the stress deviator.

With s' = C' dev S and s'' = C'' dev S, principal values s'_i and s''_j, and in the axes of the paper

    s'_11 = -c12 s_22 - c13 s_33,   s'_22 = -c21 s_11 - c23 s_33,   s'_33 = -c31 s_11 - c32 s_22,
    s'_23 = c44 s_23,   s'_13 = c55 s_13,   s'_12 = c66 s_12.

Params are the published ones: axis 1 of the paper is the rolling direction (axis 2 of the law), axis 2 the width (axis 1 of the law), axis
3 the thickness. Those of the first transformation are called c1_12 and so on, of the second c2_12. All 1: Hosford's surface.
"""

from __future__ import annotations

from collections.abc import Mapping

from thermofit.core.parameters import Param

_PLACES = ("12", "13", "21", "23", "31", "32", "44", "55", "66")
_TURNED = ("21", "23", "12", "13", "32", "31", "55", "44", "66")
"""The same places where axes 1 and 2 change places."""
PARAMS = (
    Param("yld2004.a", "1", 8.0, 2.0, 20.0, 8.0, "exponent; 6 for bcc, 8 for fcc metals"),
    *(
        Param(f"yld2004.c{n}_{at}", "1", 1.0, -3.0, 3.0, 1.0, f"coefficient {at} of transformation {n}; 1 in an isotropic sheet")
        for n in (1, 2)
        for at in _PLACES
    ),
)
FORMULA = "phi^a = sum of |s'_i - s''_j|^a / 4 over the principal values of s' = C' dev S and s'' = C'' dev S"
SOURCE = "Barlat et al. 2005, International Journal of Plasticity 21, 1009-1039: Yld2004-18p"
MEANING = {p.name: p.meaning for p in PARAMS}


def numbers(a: float, *c: float) -> tuple[float, ...]:
    """Exponent and both transformations in the axes of the law, whose 1 and 2 are 2 and 1 of the paper."""
    places = [_PLACES.index(at) for at in _TURNED]
    return (a, *(c[k] for k in places), *(c[9 + k] for k in places))


def turned(values: Mapping[str, float]) -> dict[str, float]:
    """Axes 1 and 2 change places."""
    pairs = [(f"yld2004.c{n}_{to}", f"yld2004.c{n}_{at}") for n in (1, 2) for to, at in zip(_PLACES, _TURNED, strict=True)]
    return {to: values[at] for to, at in pairs}
