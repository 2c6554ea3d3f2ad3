"""Units of native files and their conversion into the fixed ones: mm, s, N, MPa, K, strain without unit, mm^2, mm/s, 1/s.

Factors are the exact definitions: inch 25.4 mm, pound-force 4.4482216152605 N (NIST SP 811).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

_INCH = 25.4
_POUND_FORCE = 4.4482216152605
_PSI = _POUND_FORCE / _INCH**2


@dataclass(frozen=True)
class Unit:
    """`fixed` unit and the way there: fixed value = (value + `shift`) * `factor`; `quantity` in words."""

    quantity: str
    fixed: str
    factor: float
    shift: float = 0.0


_SPELLINGS: dict[str, tuple[Unit, tuple[str, ...]]] = {
    "mm": (Unit("length", "mm", 1.0), ("mm", "millimeter", "millimetre", "MM")),
    "um": (Unit("length", "mm", 1e-3), ("um", "micron", "microns", "micrometer", "mum")),
    "cm": (Unit("length", "mm", 10.0), ("cm",)),
    "m": (Unit("length", "mm", 1e3), ("m", "meter", "metre")),
    "in": (Unit("length", "mm", _INCH), ("in", "inch", "inches", "IN", '"', "in.")),
    "mil": (Unit("length", "mm", 1e-3 * _INCH), ("1e-3 in", "mil", "mils", "10^-3 in", "thou")),
    "px": (Unit("image length", "px", 1.0), ("px", "pixel", "pixels", "pix")),
    "s": (Unit("time", "s", 1.0), ("s", "sec", "secs", "second", "seconds", "sek")),
    "ms": (Unit("time", "s", 1e-3), ("ms", "msec", "millisecond", "milliseconds")),
    "min": (Unit("time", "s", 60.0), ("min", "mins", "minute", "minutes")),
    "h": (Unit("time", "s", 3600.0), ("h", "hr", "hrs", "hour", "hours")),
    "N": (Unit("force", "N", 1.0), ("N", "newton", "newtons")),
    "kN": (Unit("force", "N", 1e3), ("kN", "KN", "kilonewton")),
    "MN": (Unit("force", "N", 1e6), ("MN",)),
    "lbf": (Unit("force", "N", _POUND_FORCE), ("lbf", "lb", "lbs", "pound-force")),
    "kip": (Unit("force", "N", 1e3 * _POUND_FORCE), ("kip", "kips", "klbf")),
    "kgf": (Unit("force", "N", 9.80665), ("kgf", "kp")),
    "MPa": (Unit("stress", "MPa", 1.0), ("MPa", "Mpa", "MPA", "N/mm^2", "N/mm2", "N/mm**2", "megapascal")),
    "GPa": (Unit("stress", "MPa", 1e3), ("GPa", "Gpa", "kN/mm^2", "kN/mm2")),
    "kPa": (Unit("stress", "MPa", 1e-3), ("kPa",)),
    "Pa": (Unit("stress", "MPa", 1e-6), ("Pa", "N/m^2", "N/m2", "pascal")),
    "ksi": (Unit("stress", "MPa", 1e3 * _PSI), ("ksi",)),
    "psi": (Unit("stress", "MPa", _PSI), ("psi", "lbf/in^2", "lbf/in2")),
    "K": (Unit("temperature", "K", 1.0), ("K", "kelvin")),
    "mK": (Unit("temperature", "K", 1e-3), ("mK", "millikelvin")),
    "degC": (Unit("temperature", "K", 1.0, 273.15), ("degC", "C", "deg C", "deg.C", "celsius", "deg. C")),
    "degF": (Unit("temperature", "K", 5.0 / 9.0, 459.67), ("degF", "F", "deg F", "deg.F", "fahrenheit", "deg. F")),
    "degR": (Unit("temperature", "K", 5.0 / 9.0), ("degR", "R", "deg R", "rankine")),
    "1": (Unit("strain", "1", 1.0), ("1", "-", "--", "mm/mm", "m/m", "in/in", "strain", "none", "abs")),
    "%": (Unit("strain", "1", 1e-2), ("%", "percent", "pct", "prozent")),
    "permille": (Unit("strain", "1", 1e-3), ("permille", "millistrain", "mm/m", "1e-3", "m\u03b5")),
    "microstrain": (Unit("strain", "1", 1e-6), ("microstrain", "ustrain", "um/m", "ue", "u\u03b5", "1e-6", "ppm", "micro-strain", "uE")),
    "mm^2": (Unit("area", "mm^2", 1.0), ("mm^2", "mm2", "mm**2")),
    "in^2": (Unit("area", "mm^2", _INCH**2), ("in^2", "in2", "in**2")),
    "mm/s": (Unit("speed", "mm/s", 1.0), ("mm/s", "mm/sec")),
    "mm/min": (Unit("speed", "mm/s", 1.0 / 60.0), ("mm/min",)),
    "in/min": (Unit("speed", "mm/s", _INCH / 60.0), ("in/min",)),
    "1/s": (Unit("rate", "1/s", 1.0), ("1/s", "s^-1", "s-1", "s**-1", "/s", "1/sec", "sec^-1", "/sec", "Hz", "mm/mm/s")),
    "1/min": (Unit("rate", "1/s", 1.0 / 60.0), ("1/min", "min^-1", "min-1", "/min")),
    "%/s": (Unit("rate", "1/s", 1e-2), ("%/s",)),
}
_EXACT = {spelling: unit for unit, spellings in _SPELLINGS.values() for spelling in spellings}


def _regardless_of_case() -> dict[str, Unit]:
    """Spellings in lower case; left out where two units differ by their case only (MPa and mPa, mK and MK, K and k, N and n)."""
    found: dict[str, Unit] = {}
    for spelling, unit in _EXACT.items():
        if len(spelling) > 2 and spelling not in ("MPa", "GPa", "Mpa", "MPA", "Gpa"):
            found[spelling.lower()] = unit
    return found


_ANY_CASE = _regardless_of_case()


def _plain(text: str) -> str:
    """A unit in plain characters: signs of degree, micro, square and permille spelt out, brackets and blanks around it off."""
    text = text.strip().strip("()[]<>{}").strip()
    for sign, word in (
        ("\u00b0", "deg"),
        ("\u00ba", "deg"),
        ("\u00b5", "u"),
        ("\u03bc", "u"),
        ("\u00b2", "^2"),
        ("\u207b\u00b9", "^-1"),
        ("\u2030", "permille"),
    ):
        text = text.replace(sign, word)
    return re.sub(r"\s+", " ", text)


def known_unit(text: str) -> Unit | None:
    """The unit that a file writes as `text`, None where it is not known. An empty text is no unit."""
    plain = _plain(text)
    return _EXACT.get(plain) or _ANY_CASE.get(plain.lower())


def to_fixed(values: np.ndarray | float, unit: str) -> tuple[np.ndarray, str]:
    """Values of any shape in the fixed unit, and that unit. ValueError, for a reader to complete with its file, where it is unknown."""
    found = known_unit(unit)
    if found is None:
        raise ValueError(f"the unit {unit!r} is not known, expected one of {', '.join(_SPELLINGS)}")
    return (np.asarray(values, dtype=float) + found.shift) * found.factor, found.fixed
