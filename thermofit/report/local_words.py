"""Local balances and drifting parameters of a result in words, for a terminal and for the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from thermofit.experiment.missing import KINDS

_BALANCES = {"force": "force through sections", "heat": "heat of pieces"}
_WHERE = {
    "inside": "something is missing inside the observed field",
    "outside": "what is left comes from outside the observed field",
    "none": "nothing is missing there",
}
LIKELY = 0.05
"""Likelihood from which another history beside an unlisted one is worth a word."""
_ALIKE = 4
"""Drifts that are alike and are named."""


def balance_lines(said: Mapping[str, Any]) -> list[str]:
    """One line for each local balance: chi-square, where it comes from, and the block of place and time that misses most."""
    return [_line(row) for row in said["maps"]] + [str(text) for text in said["without"]]


def _line(row: Mapping[str, Any]) -> str:
    lead = f"{row['experiment']}: " if row["experiment"] else ""
    line = f"{lead}{_BALANCES[row['balance']]}: chi2 {row['chi2']:.3g} of {row['degrees']:.3g}, {_WHERE[row['where']]}"
    if row["block"] is not None:
        b = row["block"]
        (y0, y1), (t0, t1) = b["y_mm"], b["when_s"]
        line += f": {_value(b['value'], b['sigma'])} {row['unit']} at y = {y0:.3g} to {y1:.3g} mm from {t0:.3g} to {t1:.3g} s"
    if row["closes_with"] is not None:
        c = row["closes_with"]
        line += f"; the balance closes with {c['parameter']} = {_value(c['value'], c['sigma'])}, where the fit has {c['fitted']:.3g}"
    return line


def drift_line(row: Mapping[str, Any]) -> str:
    """A drifting parameter in one line, and what these data do not tell from it."""
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    line = f"{row['words']}: {_value(row['slope'], row['sigma'])}{unit} (z {row['z']:.1f})"
    others = [f"{a['parameter']} with {a['variable']}" for a in row["alike"]]
    if not others:
        return line
    return f"{line}; not told from {', '.join(others[:_ALIKE])}" + (" and others" if len(others) > _ALIKE else "")


def _value(value: float, sigma: float | None) -> str:
    return f"{value:.3g}" if sigma is None else f"{value:.3g} +- {sigma:.2g}"


def with_article(kind: str) -> str:
    """The kind of a term with its article."""
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def second_in_words(likelihood: Mapping[str, float]) -> str:
    """Which other kinds of histories standard errors hold, the likeliest first, from how likely each is beside the one that is told; empty
    where none is. No shares: one is told as likely where none is, too (docs/other-causes.md)."""
    likely = [kind for kind, p in sorted(likelihood.items(), key=lambda one: -one[1]) if p >= LIKELY]
    if not likely:
        return ""
    kinds = ", ".join(with_article(KINDS[kind].words) for kind in likely)
    return f"standard errors hold that there may be another history beside it: {kinds}"


def held_in_words(held: Mapping[str, float]) -> str:
    """Which exponents of added laws are held beside an unlisted term; empty where none is."""
    values = ", ".join(f"{n} = {v:.3g}" for n, v in held.items())
    return f"{values}: held beside it; standard errors hold what other values would change" if held else ""


def travel_in_words(spot: Mapping[str, Any] | None) -> str:
    """How an unlisted heat travels that was taken for one spot; empty where there is none, or it is at rest."""
    if spot is None or spot.get("velocity_mm_per_s") is None:
        return ""
    pace = f"{spot['velocity_mm_per_s']:.3g} +- {spot['velocity_sigma']:.1g} mm/s"
    return f"taken for one spot that travels at {pace}, and is at y = {spot['y_mm']:.3g} mm at {spot['at_s']:.4g} s"


def steps_in_words(said: Mapping[str, Any]) -> str:
    """When an unlisted term is switched, and by how much."""
    return ", ".join(f"{one['amount']:+.3g} {said['unit']} at {one['time_s']:.4g} s" for one in said["steps"])
