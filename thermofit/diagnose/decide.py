"""Which test programme would part effects that this test cannot tell apart, or show one that it hardly feels.

The coupon of `point.driver` is run through every programme of `point.programmes` with the fitted parameters, and the same sensitivities are
taken: columns of stress and temperature over their noise, without what the fitted parameters can do. A programme parts two effects where
|cos| of their columns is below ALIKE; the smallest amplitude that it shows is CONVINCING over their length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import NAMES, Parameters, bare_name
from thermofit.diagnose.case import TINY, slots_of
from thermofit.diagnose.score import ALIKE, CONVINCING, likeness
from thermofit.diagnose.trace import Traced
from thermofit.effects.catalogue import Effect, effect
from thermofit.identify.missing_coupon import CouponMissing
from thermofit.point.driver import PointSettings, simulate_rates
from thermofit.point.programmes import PROGRAMMES, Named, Usual, programme

FAINT = 0.05
"""Part of a column that the fitted parameters leave below which a test is said to hardly feel an effect."""
STRESS, TEMPERATURE = 0.5, 0.02
"""Noise in MPa and K where the experiment has no such channel."""
PEAK, RATE = 0.05, 1e-3
"""Largest nominal strain and rate in 1/s of the programmes where the experiment is no coupon."""


@dataclass(frozen=True)
class Told:
    """What one programme tells of a family: largest |cos| between its members (1 where one is not felt), smallest amplitudes."""

    programme: Named
    cosine: float
    detectable: dict[str, float]


@dataclass(frozen=True)
class Decision:
    """Effects that this test leaves undecided, what the programmes tell, and effects that no coupon feels."""

    family: tuple[str, ...]
    told: tuple[Told, ...]
    unfelt: tuple[str, ...]
    failed: tuple[str, ...] = ()
    """Programmes that a coupon of these parameters cannot be driven through."""

    @property
    def best(self) -> Told | None:
        """The first programme, the simplest, that parts them; None where none does. Of one effect: the one that shows least of it."""
        if len(self.family) == 1:
            shown = [t for t in self.told if self.family[0] in t.detectable]
            return min(shown, key=lambda t: t.detectable[self.family[0]]) if shown else None
        return next((t for t in self.told if t.cosine < ALIKE), None)


def undecided_families(here: Traced) -> tuple[tuple[str, ...], ...]:
    """Families of more than one effect that are worth a refit, then effects above the threshold that the test hardly feels."""
    families = [s.family for s in here.promising() if len(s.family) > 1]
    faint = [(s.effect,) for s in here.ranking.scores if s.detectability < FAINT and s.z > here.ranking.threshold]
    seen: list[tuple[str, ...]] = []
    for family in (*families, *faint):
        if not any(set(family) <= set(other) for other in seen):
            seen.append(family)
    return tuple(seen)


def decisions(here: Traced) -> tuple[Decision, ...]:
    """A decision for every undecided family."""
    families = undecided_families(here)
    if not families:
        return ()
    usual, noise = _usual(here), _noise(here)
    known = {e.name for e in slots_of("point", ())}
    wanted = tuple(dict.fromkeys(n for family in families for n in family if n in known))
    runs = [(p, columns(p, usual, here.case.parameters, tuple(effect(n) for n in wanted), noise)) for p in PROGRAMMES] if wanted else []
    out = []
    for family in families:
        told = tuple(t for p, own in runs if own is not None and (t := _told(p, own, family)) is not None)
        failed = tuple(p.name for p, own in runs if own is None)
        out.append(Decision(family, told, tuple(n for n in family if n not in known), failed))
    return tuple(out)


def columns(
    named: Named, usual: Usual, parameters: Parameters, wanted: Sequence[Effect], noise: tuple[float, float]
) -> dict[str, np.ndarray] | None:
    """Whitened columns (2 n_t, k) of every effect that a coupon feels in a programme, without what the free parameters can do.

    None where a coupon of these parameters cannot be driven so; `noise` = (MPa, K).
    """
    free = tuple(n for n in parameters.free if n in NAMES and n not in ("theta_air", "theta_clamp", "kappa", "alpha_air", "alpha_clamp"))
    tiny = {e.amplitude.name: e.amplitude.neutral + TINY * float(e.amplitude.probe or 0.0) for e in wanted}
    felt = {e.name: tuple(p.name for p in e.amplitudes) for e in wanted}
    names = (*free, *(n for group in felt.values() for n in group))
    try:
        made = programme(named.name, usual, parameters, PointSettings())
        _, rates = simulate_rates(parameters.replace(**tiny), names, made, PointSettings())
    except NumericsError:
        return None
    whole = np.concatenate([rates["stress"] / noise[0], rates["theta_sensor"] / noise[1]])
    fitted = whole[:, : len(free)]
    size = np.linalg.norm(fitted, axis=0)
    basis, _ = np.linalg.qr(fitted[:, size > 0.0] / size[size > 0.0])
    at, out = len(free), {}
    for name, group in felt.items():
        block = whole[:, at : at + len(group)]
        at += len(group)
        own = block - basis @ (basis.T @ block)
        kept = np.linalg.norm(own, axis=0) > 1e-6 * np.maximum(np.linalg.norm(block, axis=0), 1e-300)
        if kept.any():
            out[name] = own[:, kept]
    return out


def _told(named: Named, own: dict[str, np.ndarray], family: tuple[str, ...]) -> Told | None:
    there = {n: own[n] for n in family if n in own}
    if not there:
        return None
    alike = likeness(there)
    largest = max((cos for (a, b), cos in alike.items() if a != b), default=0.0)
    shown = {n: float(CONVINCING / np.linalg.norm(s[:, 0])) for n, s in there.items()}
    return Told(named, 1.0 if len(there) < len(family) else largest, shown)


def _usual(here: Traced) -> Usual:
    """Largest strain and usual rate of the records; those of a common tension test where there are none."""
    missing, start = here.case.model.missing, here.case.parameters["theta_air"]
    if not isinstance(missing, CouponMissing):
        return Usual(PEAK, RATE, start)
    peak = min(max(float(np.abs(t.strain).max()) for t in missing.tests), 0.5)
    rates = np.concatenate([np.abs(np.diff(t.strain) / np.diff(t.time)) for t in missing.tests])
    moving = rates[rates > 1e-3 * rates.max()]
    return Usual(peak, float(np.median(moving)), missing.tests[0].theta_start)


def _noise(here: Traced) -> tuple[float, float]:
    found = {bare_name(c.channel): float(np.sqrt(np.mean(c.sigma**2))) for c in here.case.model.comparisons}
    return found.get("stress", STRESS), found.get("dtheta", found.get("theta", TEMPERATURE))


def decided(summary: dict[str, Any], here: Traced) -> dict[str, Any]:
    """A summary with `programmes`, what each would tell of every undecided family, and the sentences of `undecided` completed."""
    found = decisions(here)
    rows = [
        {
            "family": list(d.family),
            "best": None if d.best is None else d.best.programme.name,
            "no_coupon_feels": list(d.unfelt),
            "not_driven": list(d.failed),
            "told": [{"programme": t.programme.name, "max_cos": t.cosine, "detectable": t.detectable} for t in d.told],
        }
        for d in found
    ]
    said = [*summary.get("undecided", []), *(in_words(d) for d in found)]
    return {**summary, "undecided": said, "programmes": rows}


def in_words(d: Decision) -> str:
    """A decision as a sentence."""
    names = " and ".join(d.family)
    if d.unfelt:
        return f"{names}: no coupon feels {', '.join(d.unfelt)}; it takes a specimen with a field of temperature to decide"
    if d.best is None:
        tried = ", ".join(p.name for p in PROGRAMMES if p.name not in d.failed)
        missed = f" ({', '.join(d.failed)}: a coupon of these parameters cannot be driven so)" if d.failed else ""
        return f"{names}: none of the programmes {tried} would part them{missed}"
    best, shown = d.best, ", ".join(f"{n} from {v:.2g}" for n, v in d.best.detectable.items())
    part = f" (|cos| {best.cosine:.2f})" if len(d.family) > 1 else ""
    return f"{names}: the programme {best.programme.name} ({best.programme.words}) would decide{part}; it shows {shown} on"
