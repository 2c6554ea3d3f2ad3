"""Classes of metals: starts and bounds of what a first look at a test does not show. Wide enough for the alloys of a class."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """`words` by which a class is recognised in a note, and start, lower and upper bound of its parameters."""

    words: str
    values: Mapping[str, tuple[float, float, float]]


def _of(
    e: tuple[float, float, float],
    nu: float,
    alpha: tuple[float, float, float],
    kappa: tuple[float, float, float],
    c0: tuple[float, float, float],
) -> Mapping[str, tuple[float, float, float]]:
    return {"E": e, "nu": (nu, 0.15, 0.45), "alpha_exp": alpha, "kappa": kappa, "c0": c0}


MATERIALS: Mapping[str, Material] = {
    "steel": Material(
        r"steel|stahl|acier|\bDC0\d|\bDP\d|\bS\d{3}|\b304L?\b|\b316L?\b|iron",
        _of((2.05e5, 1e5, 3e5), 0.29, (12e-6, 4e-6, 30e-6), (40.0, 8.0, 120.0), (3.7, 2.0, 6.0)),
    ),
    "aluminium": Material(
        r"alumini?um|\bA[AW][- ]?\d{4}|\bAl[MSZC][gincu]|\b[1-8]0\d\d-?T\d",
        _of((7e4, 3.5e4, 1.2e5), 0.33, (23e-6, 8e-6, 50e-6), (150.0, 40.0, 350.0), (2.4, 1.2, 4.5)),
    ),
    "magnesium": Material(r"magnesium|\bAZ\d\d", _of((4.4e4, 2e4, 8e4), 0.33, (26e-6, 9e-6, 55e-6), (90.0, 20.0, 250.0), (1.8, 0.9, 3.5))),
    "copper": Material(
        r"copper|kupfer|cuivre|brass|messing|bronze",
        _of((1.2e5, 6e4, 2e5), 0.34, (18e-6, 6e-6, 40e-6), (200.0, 20.0, 600.0), (3.4, 1.7, 6.0)),
    ),
    "titanium": Material(
        r"titan|\bTi[- ]?6|\bTi\d", _of((1.1e5, 5e4, 1.8e5), 0.33, (9e-6, 3e-6, 25e-6), (10.0, 3.0, 40.0), (2.4, 1.2, 4.5))
    ),
    "nickel": Material(
        r"nickel|inconel|hastelloy|\balloy ?\d{3}", _of((2.05e5, 1e5, 3e5), 0.30, (13e-6, 4e-6, 30e-6), (15.0, 5.0, 120.0), (3.7, 2.0, 6.0))
    ),
}
"""After ASM Handbook 1 and 2, at room temperature: E in MPa, 1/K, mW/(mm K), mJ/(mm^3 K)."""


def class_of(note: str) -> str:
    """The class that a note such as `steel sheet DC04` names, empty where it names none or several."""
    found = [name for name, material in MATERIALS.items() if re.search(material.words, note, re.IGNORECASE)]
    return found[0] if len(found) == 1 else ""
