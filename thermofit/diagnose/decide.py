"""Which test programme would part effects that this test cannot tell apart, or show one that it hardly feels.

The coupon of `point.driver` is run through every programme of `point.programmes` with the fitted parameters, and the same sensitivities are
taken: columns of stress and temperature over their noise, without what the fitted parameters can do. A programme parts two effects where
|cos| of their columns is below ALIKE; the smallest amplitude that it shows is CONVINCING over their length. A coupon with a temperature
has the sensor of its records.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import NAMES, Parameters, bare_name, param
from thermofit.diagnose.case import TINY, slots_of
from thermofit.diagnose.decide_words import acted_on
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.score import ALIKE, CONVINCING, Columns, likeness
from thermofit.diagnose.trace import Traced
from thermofit.effects.catalogue import Effect, effect, effect_of_param, effects
from thermofit.identify.coupon_inputs import CouponTest
from thermofit.identify.coupon_sensor import SENSOR, shown_rates
from thermofit.identify.instruments import station_names
from thermofit.identify.missing_coupon import CouponMissing
from thermofit.point.driver import PointSettings, Programme, simulate_rates
from thermofit.point.programmes import PROGRAMMES, Named, Usual, programme

FAINT = 0.05
"""Part of a column that the fitted parameters leave below which a test is said to hardly feel an effect."""
STRESS, TEMPERATURE = 0.5, 0.02
"""Noise in MPa and K where the experiment has no such channel."""
PEAK, RATE = 0.05, 1e-3
"""Largest nominal strain and rate in 1/s of the programmes where the experiment is no coupon."""
_OF_BODIES = ("theta_air", "theta_clamp", "kappa", "alpha_air", "alpha_clamp")
"""Parameters of the base law that no coupon feels."""


@dataclass(frozen=True)
class Family:
    """Effects that a test leaves undecided: the one that the loop has added (empty: none of them is in the model) and the values of
    exponents at which the others were scored."""

    members: tuple[str, ...]
    added: str = ""
    settings: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Told:
    """What one programme tells of a family: largest |cos| between the members that coupons feel (1 where this one does not show one of
    them), smallest amplitudes."""

    programme: Named
    cosine: float
    detectable: dict[str, float]


@dataclass(frozen=True)
class Decision:
    """Effects that this test leaves undecided, what the programmes tell, and effects that no coupon feels; `added` is in the model."""

    family: tuple[str, ...]
    told: tuple[Told, ...]
    unfelt: tuple[str, ...]
    failed: tuple[str, ...] = ()
    """Programmes that a coupon of these parameters cannot be driven through."""
    added: str = ""

    @property
    def felt(self) -> tuple[str, ...]:
        """Members that a coupon feels."""
        return tuple(n for n in self.family if n not in self.unfelt)

    @property
    def best(self) -> Told | None:
        """The first programme, the simplest, that parts what coupons feel of them; None where none does. Of one effect: the one that shows
        least of it."""
        if len(self.felt) == 1:
            shown = [t for t in self.told if self.felt[0] in t.detectable]
            return min(shown, key=lambda t: t.detectable[self.felt[0]]) if shown else None
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


def added_families(closed: Closed) -> tuple[Family, ...]:
    """The families of accepted effects, as the rounds that accepted them told them; without what was accepted besides: all of that is
    needed at the end."""
    out = []
    for turn in closed.rounds:
        for trial in turn.trials:
            if trial.score.effect != turn.accepted or turn.accepted not in closed.accepted:
                continue
            others = tuple(n for n in trial.score.family if n not in closed.accepted)
            if others:
                settings = {n: v for other in others for n, v in turn.traced.settings.get(other, {}).items()}
                out.append(Family((turn.accepted, *others), turn.accepted, settings))
    return tuple(out)


def decisions(here: Traced, added: Sequence[Family] = ()) -> tuple[Decision, ...]:
    """A decision for every family of an effect that was added, then for every one that is undecided among dormant effects."""
    known = felt_by_coupons(here)
    dormant = tuple(f for f in undecided_families(here) if not any(set(f) <= set(other.members) for other in added))
    settings = {n: v for family in dormant for other in family for n, v in here.settings.get(other, {}).items()}
    runs = _runs(here, Family(tuple(dict.fromkeys(n for family in dormant for n in family)), "", settings), known)
    found = [_decision(family, _runs(here, family, known), known) for family in added]
    return (*found, *(_decision(Family(family), runs, known) for family in dormant))


def felt_by_coupons(here: Traced) -> frozenset[str]:
    """Names of the effects that a coupon of this material feels; where the records are coupons, with those of their sensor."""
    if isinstance(here.case.model.missing, CouponMissing):
        return frozenset(e.name for e in here.case.known)
    return frozenset(e.name for e in slots_of("point", ()))


_Runs = list[tuple[Named, dict[str, np.ndarray] | None]]


def _runs(here: Traced, family: Family, known: frozenset[str]) -> _Runs:
    """Columns of the members that a coupon feels by every programme, see `columns`."""
    wanted = tuple(effect(n) for n in family.members if n in known)
    if not wanted:
        return []
    parameters, usual, noise = _on_coupon(here, family, known), _usual(here), _noise(here)
    return [(p, columns(p, usual, parameters, wanted, noise)) for p in PROGRAMMES]


def _on_coupon(here: Traced, family: Family, known: frozenset[str]) -> Parameters:
    """The parameters of a coupon: free are those that it feels, but for what the added effect of a family has; the instruments of a body do
    not look at it."""
    base = here.case.parameters
    others = {n: param(n).neutral for n in base.values if n in station_names() and effect_of_param(n).name not in known}
    own = effect(family.added).names if family.added else ()
    free = (n for n in base.free if n not in own and (n in NAMES or ("." in n and effect_of_param(n).name in known)))
    return base.replace(**others, **family.settings).with_free(tuple(n for n in free if n not in _OF_BODIES))


def _decision(family: Family, runs: _Runs, known: frozenset[str]) -> Decision:
    felt = tuple(n for n in family.members if n in known)
    told = tuple(t for p, own in runs if own is not None and (t := _told(p, own, felt)) is not None)
    failed = tuple(p.name for p, own in runs if own is None)
    return Decision(family.members, told, tuple(n for n in family.members if n not in known), failed, family.added)


def columns(
    named: Named, usual: Usual, parameters: Parameters, wanted: Sequence[Effect], noise: tuple[float, float]
) -> dict[str, np.ndarray] | None:
    """Whitened columns (2 n_t, k) of every effect that a coupon feels in a programme, without what the free parameters can do.

    An effect that is on is asked at its value, one that is off beside neutral. None where a coupon of these parameters cannot be driven so;
    `noise` = (MPa, K).
    """
    free = tuple(n for n in parameters.free if n not in _OF_BODIES)
    off = [e for e in wanted if e.slot not in SENSOR and all(parameters[p.name] == p.neutral for p in e.amplitudes)]
    tiny = {e.amplitude.name: e.amplitude.neutral + TINY * float(e.amplitude.probe or 0.0) for e in off}
    felt = {e.name: tuple(p.name for p in e.amplitudes) for e in wanted}
    names = (*free, *(n for group in felt.values() for n in group))
    try:
        made = programme(named.name, usual, parameters, PointSettings())
        whole = _whitened(parameters.replace(**tiny), names, made, noise)
    except NumericsError:
        return None
    at = {name: k for k, name in enumerate(names)}
    dormant = {name: (group, whole[:, [at[n] for n in group]]) for name, group in felt.items()}
    found = Columns(np.zeros(len(whole)), whole[:, : len(free)], dormant)
    own = {name: found.felt(block) for name, (_, block) in dormant.items()}
    return {name: block for name, block in own.items() if block.shape[1] > 0}


def _whitened(parameters: Parameters, names: tuple[str, ...], made: Programme, noise: tuple[float, float]) -> np.ndarray:
    """Derivatives (2 n_t, n_p) of stress and of what the sensor shows, over their noise. NumericsError where the run fails."""
    of_sensor = effects(SENSOR)
    stations = {n for e in of_sensor for n in e.names}
    body = tuple(n for n in names if n not in stations)
    history, rates = simulate_rates(parameters, body, made, PointSettings())
    start = float(history.theta[0])
    test = CouponTest("", history.time, history.strain, history.stress, None, parameters["theta_air"], start, {}, ())
    stress = np.zeros((len(history.time), len(names)))
    stress[:, [names.index(n) for n in body]] = rates["stress"]
    theta = shown_rates(history.theta_sensor, rates["theta_sensor"], test, parameters, (names, of_sensor))
    return np.concatenate([stress / noise[0], theta / noise[1]])


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


def decided(summary: dict[str, Any], here: Traced, added: Sequence[Family] = ()) -> dict[str, Any]:
    """A summary with `programmes`, what each would tell of every undecided family, those of `added` effects first, and the sentences of
    `undecided` completed."""
    found = decisions(here, added)
    rows = [
        {
            "family": list(d.family),
            "added": d.added or None,
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
    names = " or ".join(f"{n} (added)" if n == d.added else n for n in d.family) if d.added else " and ".join(d.family)
    missing = f"no coupon feels {acted_on(d.unfelt)}" if d.unfelt else ""
    if not d.felt:
        return f"{names}: {missing}"
    best, tail = d.best, f"; {missing}" if missing else ""
    if best is None:
        tried = ", ".join(p.name for p in PROGRAMMES if p.name not in d.failed)
        missed = f" ({', '.join(d.failed)}: a coupon of these parameters cannot be driven so)" if d.failed else ""
        would = f"would part {' and '.join(d.felt)}" if len(d.felt) > 1 else f"would show {d.felt[0]}"
        return f"{names}: none of the programmes {tried} {would}{missed}{tail}"
    shown = ", ".join(f"{n} from {v:.2g}" for n, v in best.detectable.items())
    part = f" (|cos| {best.cosine:.2f})" if len(d.felt) > 1 else ""
    return f"{names}: the programme {best.programme.name} ({best.programme.words}) would decide{part}; it shows {shown} on{tail}"
