"""What tests of metals can show: one table of ranges, and one of the mistakes of unit that leave them.

Outside of `usual` somebody should look; outside of `possible` something is wrong. The bounds are wide on purpose: they tell a factor of a
thousand, not a bad test from a good one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Range:
    """`usual` and `possible` values of a quantity in its `unit`, and what they rest on."""

    unit: str
    usual: tuple[float, float]
    possible: tuple[float, float]
    source: str


RANGES: Mapping[str, Range] = {
    "modulus": Range(
        "MPa", (1e4, 6e5), (5e3, 1e6), "lead 16e3, tungsten 411e3, osmium 560e3 (CRC Handbook of Chemistry and Physics); soft grips: less"
    ),
    "stress": Range(
        "MPa", (8.0, 4000.0), (1.0, 8000.0), "largest nominal stress: lead 12 to 17, drawn wire up to 4000 (ASM Handbook 1, 2)"
    ),
    "strain": Range("1", (0.0, 1.5), (0.0, 3.0), "uniform and local elongation of ductile metals; superplastic ones reach more"),
    "rate": Range("1/s", (2e-6, 1e5), (1e-12, 1e8), "ISO 6892-1: 7e-5 to 6.7e-3 1/s; creep less, split Hopkinson bar up to 1e4 1/s"),
    "temperature": Range("K", (70.0, 2000.0), (2.0, 3700.0), "liquid nitrogen 77 K; tungsten melts at 3695 K"),
    "surroundings": Range("K", (253.0, 333.0), (4.0, 2500.0), "ISO 6892-1: room temperature 283 to 308 K; furnaces and cryostats beyond"),
    "thickness": Range("mm", (0.05, 30.0), (0.005, 200.0), "foil to plate"),
    "width": Range("mm", (1.0, 100.0), (0.1, 1000.0), "DIN 50125: 6 to 40 mm; miniature specimens 1 mm"),
    "length": Range("mm", (3.0, 500.0), (0.3, 5000.0), "parallel length, DIN 50125: 30 to 300 mm; miniature specimens 5 mm"),
}
"""By quantity. Temperatures in K."""


def outside(quantity: str, value: float) -> str:
    """ "usual" or "possible", whichever range the value leaves (the wider one first); empty where it leaves none."""
    known = RANGES[quantity]
    for word, (low, high) in (("possible", known.possible), ("usual", known.usual)):
        if not low <= value <= high:
            return word
    return ""


Doubt = Literal["specimen", "force", "displacement", "place", "time", "temperature", "side", "strain", "stress"]
"""What a question may be about; by these names data that are right all the same are confirmed."""


@dataclass(frozen=True)
class Mistake:
    """A wrong unit: `name` in words, the factors that would put nominal stress and strain right, and how to mend it."""

    name: str
    stress: float
    strain: float
    mend: str


KN = Mistake("the force in kN under a header in N", 1e3, 1.0, "name its column force_kN, it is converted then")
NOT_KN = Mistake("the force in N under a header in kN", 1e-3, 1.0, "name its column force_N")
THICKNESS_M = Mistake("the thickness in m", 1e-3, 1.0, "give specimen.thickness_mm in mm")
WIDTH_M = Mistake("the width in m", 1e-3, 1.0, "give specimen.gauge_width_mm in mm")
BOTH_M = Mistake("the lengths of the specimen in m", 1e-6, 1.0, "give all lengths of the section specimen in mm")
MOVED_M = Mistake("the displacements in m", 1.0, 1e3, "name their columns ux_m, uy_m, uz_m, or give dic.unit: m")
MOVED_UM = Mistake("the displacements in um", 1.0, 1e-3, "name their columns ux_um, uy_um, uz_um, or give dic.unit: um")
PERCENT = Mistake("the strain in percent", 1.0, 1e-2, 'give the column of the strain with unit: "%"')
MICRO = Mistake("the strain in millionths", 1.0, 1e-6, "give the column of the strain with unit: um/m")
STRESS_PA = Mistake("the stress in Pa", 1e-6, 1.0, "give the column of the stress with unit: Pa")
STRESS_GPA = Mistake("the stress in GPa, or the force in kN", 1e3, 1.0, "give that column with unit: GPa, or unit: kN")
STRESS_KPA = Mistake("the stress in kPa, or the force in N under kN", 1e-3, 1.0, "give that column with unit: kPa, or unit: N")
OF_RECORDS = (PERCENT, MICRO, STRESS_PA, STRESS_GPA, STRESS_KPA)
"""Mistakes that records of coupons may have."""
