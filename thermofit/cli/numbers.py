"""Numbers as a human reads them."""

from __future__ import annotations

import math
from typing import Any


def number(value: Any, digits: int = 5) -> str:
    """A number with so many digits; yes or no; a dash where there is none."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value) if isinstance(value, int | str) else f"{value:.{digits}g}"


def with_error(value: float, sigma: float | None) -> tuple[str, str]:
    """Value and standard error with the digits that the error warrants: two of the error, the value to the same place."""
    if sigma is None or not math.isfinite(sigma) or sigma <= 0.0:
        return number(value, 6), "-"
    place = math.floor(math.log10(sigma)) - 1
    size = math.floor(math.log10(abs(value))) if value else 0
    if -4 < size < 7:
        decimals = min(max(-place, 0), 12)
        return f"{value:.{decimals}f}", f"{sigma:.{decimals}f}"
    return f"{value:.{min(max(size - place, 0), 12)}e}", f"{sigma:.1e}"


def bounds(lower: float, upper: float) -> str:
    """Lower and upper bound."""
    return f"{number(lower, 6)} .. {number(upper, 6)}"


def percent(share: float | None) -> str:
    """A relative deviation in per cent, with sign."""
    return "-" if share is None else f"{100.0 * share:+.2f} %"


def seconds(wall: float) -> str:
    """A wall time."""
    if wall < 60.0:
        return f"{wall:.1f} s"
    return f"{int(wall // 60)} min {int(wall % 60):02d} s"
