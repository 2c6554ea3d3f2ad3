"""Do the data determine the parameters? Spectrum, correlations, detectability, what to fix, and a verdict in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermofit.core.parameters import param
from thermofit.fit.covariance import Covariance
from thermofit.fit.information import (
    FREEDOM,
    DesignCriteria,
    Flat,
    Invariant,
    Spectrum,
    criteria,
    detectability,
    fixing_sets,
    relative_sigma,
    spectrum,
)
from thermofit.identify.linear import Linear, moved

Kind = Literal["unique", "weak", "valley", "undetermined"]
"""`weak`: to first order the data tell one optimum, but a direction of it no better than to `FREEDOM`; `valley`: several parameters move
together, and the data do not tell one place along it from another; `undetermined`: a single one is not felt."""
OPEN = 1.0
"""Relative standard error along a direction from which on the data do not tell one optimum: a factor e."""
_MOST_SETS = 8
STRONG = 0.01
"""Relative move of a parameter by an error of something prescribed from which on it is said."""


@dataclass(frozen=True)
class Analysis:
    """What a linearised stage says: `kind` and `verdict` in words; per parameter (of those not at a bound, in `names`) the relative
    standard error, the share of its effect that no other can imitate, and the smallest change that the test would show (95 %); sets of
    parameters that would have to be given; moves (n_p,) of the optimum, relative, by errors of what is prescribed."""

    kind: Kind
    verdict: str
    names: tuple[str, ...]
    relative: np.ndarray
    detectability: np.ndarray
    spectrum: Spectrum
    criteria: DesignCriteria
    fixing: tuple[tuple[str, ...], ...]
    covariance: Covariance
    sigma: np.ndarray
    shifts: Mapping[str, np.ndarray]
    s2: float


def analysed(linear: Linear, freedom: float = FREEDOM) -> Analysis:
    """Analysis of a linearised stage. UntrustworthyError where there are not more data than parameters."""
    spread = linear.covariance()
    s2 = 1.0 if linear.before or spread.s2 == 0.0 else spread.s2
    info = linear.information(s2)
    found = spectrum(info, _reference(info.names), freedom)
    fixing = fixing_sets(info, freedom)[:_MOST_SETS] if found.flat else ((),)
    relative = relative_sigma(info)
    sigma = np.sqrt(s2) * spread.sigma_unit
    kind = _kind(found, spectrum(info, _reference(info.names), max(freedom, OPEN)))
    held = tuple(name for name, at in zip(linear.names, linear.at_bound, strict=True) if at)
    return Analysis(
        kind=kind,
        verdict=_verdict(kind, found, info.names, relative, fixing, held),
        names=info.names,
        relative=relative,
        detectability=detectability(info),
        spectrum=found,
        criteria=criteria(info),
        fixing=fixing,
        covariance=spread,
        sigma=sigma,
        shifts={name: moved(linear, shift) for name, shift in linear.shifts.items()},
        s2=s2,
    )


def _reference(names: tuple[str, ...]) -> str | None:
    """What ratios refer to: the dimensionless factor of the dissipation where it is free, else another number without a unit."""
    if "beta" in names:
        return "beta"
    return next((name for name in names if param(name).unit == "1"), None)


def _kind(found: Spectrum, wide: Spectrum) -> Kind:
    """`found` holds the directions that are given poorly, `wide` those that are not given at all."""
    if not found.flat:
        return "unique"
    if not wide.flat:
        return "weak"
    return "valley" if any(len(flat.members) > 1 for flat in wide.flat) else "undetermined"


def _verdict(
    kind: Kind, found: Spectrum, names: tuple[str, ...], relative: np.ndarray, fixing: tuple[tuple[str, ...], ...], held: tuple[str, ...]
) -> str:
    """The answer in one line."""
    at_bound = f"; {', '.join(held)} at its bound and held there" if held else ""
    if kind == "unique":
        worst = int(np.argmax(relative)) if len(relative) else 0
        what = ", ".join(names) or "nothing"
        limit = f", {names[worst]} least: +- {percent(float(relative[worst]))}" if names else ""
        return f"unique: the data determine {what}{limit}{at_bound}"
    said = "weak: one optimum, but " if kind == "weak" else f"{kind}: "
    return f"{said}{'; '.join(relation(flat) for flat in found.flat)}; {mend(fixing)}{at_bound}"


def relation(flat: Flat) -> str:
    """A flat direction in words: who moves together, and what stays constant."""
    how = "the model leaves it open" if flat.exact else f"+- {percent(flat.sigma)} along it"
    if len(flat.members) == 1:
        return f"{flat.members[0]} is {'hardly' if flat.sigma <= OPEN else 'not'} determined (+- {percent(flat.sigma)})"
    constant = [combination(i, flat.reference) for i in flat.invariants]
    worst = max((i.sigma for i in flat.invariants), default=0.0)
    exact = f", which the data give to {percent(worst)}" if np.isfinite(worst) else ""
    return f"{', '.join(flat.members)} can move together ({how}); constant along it: {', '.join(constant)}{exact}"


def combination(invariant: Invariant, reference: str) -> str:
    """x/r, x*r, or x/r^e."""
    e = invariant.exponent if invariant.plain is None else float(invariant.plain)
    power = "" if abs(e) == 1.0 else f"^{abs(e):.3g}"
    return f"{invariant.name}{'/' if e > 0.0 else '*'}{reference}{power}"


def mend(fixing: tuple[tuple[str, ...], ...]) -> str:
    """What would make the rest determined."""
    if not fixing:
        return "too many parameters to say which to fix"
    if len(fixing[0]) == 1:
        ones = [names[0] for names in fixing]
        return f"fix {ones[0]}" if len(ones) == 1 else f"fix one of {', '.join(ones)}"
    sets = " or ".join("{" + ", ".join(names) + "}" for names in fixing[:3])
    return f"fix {sets}"


def percent(share: float) -> str:
    """A share as a percentage."""
    return "any amount" if not np.isfinite(share) or share > 1e4 else f"{100.0 * share:.2g} %"
