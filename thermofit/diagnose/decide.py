"""Which test programme would part effects that this test cannot tell apart, or show one that it hardly feels.

The coupon of `point.driver` is run through every programme of `point.programmes` with the fitted parameters, and the same sensitivities are
taken: columns of stress and temperature over their noise, without what the fitted parameters can do. A programme parts two effects where
|cos| of their columns is below ALIKE; the smallest amplitude that it shows is CONVINCING over their length. A coupon with a temperature
has the sensor of its records. Specimens whose force drives them are asked besides for changes of their own test (`decide_specimen`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import AT, Parameters, acting, bare_name, param
from thermofit.diagnose import decide_specimen
from thermofit.diagnose.case import TINY
from thermofit.diagnose.decide_specimen import CandidateProgramme, Discrimination, Family, discrimination_of
from thermofit.diagnose.loop import Closed, like_of
from thermofit.diagnose.score import ALIKE
from thermofit.diagnose.trace import Traced
from thermofit.effects.catalogue import BASE, HEAT, KINEMATICS, LOAD, MEASUREMENT, Effect, effect, effect_of_param, effects, is_of_effect
from thermofit.experiment.coupon_records import CouponTest
from thermofit.experiment.coupon_sensor import SENSOR, shown_rates
from thermofit.experiment.instruments import station_names
from thermofit.experiment.joint import JointParts
from thermofit.experiment.known_effects import effects_of_point
from thermofit.fit.linear_model import projection
from thermofit.observe.stations import CAMERA
from thermofit.point.driver import PointSettings, simulate_rates
from thermofit.point.driver import Programme as Driven
from thermofit.point.programmes import PROGRAMMES, Named, Usual, programme

FIELD_OF_DISPLACEMENT, FIELD_OF_TEMPERATURE = "the field of displacement", "the field of temperature"
FORCE, MACHINE = "the channel of force", "the machine between crosshead and specimen"
_BASE = {"hill_anisotropy": FIELD_OF_DISPLACEMENT}
"""What mechanisms of the base law act on that is not a field of temperature."""


def acts_on(e: Effect) -> str:
    """What an effect acts on, in words; of an effect of the load the record that it changes."""
    if e.slot in LOAD:
        values = (float(p.probe or p.neutral) for p in e.params)
        force, _ = e.act(np.ones(2), np.zeros(2), *values)
        return FORCE if np.any(force != 1.0) else MACHINE
    if e.slot in BASE:
        return _BASE.get(e.name, FIELD_OF_TEMPERATURE)
    if e.slot in (*KINEMATICS, *CAMERA):
        return FIELD_OF_DISPLACEMENT
    return FIELD_OF_TEMPERATURE if e.slot in (*HEAT, *MEASUREMENT) else "the material"


def acted_on(names: Sequence[str]) -> str:
    """Names of effects, each group with what it acts on: "lamp and ir_drift, which act on the field of temperature"."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(acts_on(effect(name)), []).append(name)
    return ", nor ".join(f"{' and '.join(own)}, which act{'s' if len(own) == 1 else ''} on {what}" for what, own in groups.items())


FAINT = 0.05
"""Part of a column that the fitted parameters leave below which a test is said to show an effect hardly."""
STRESS, TEMPERATURE = 0.5, 0.02
"""Noise in MPa and K where the experiment has no such channel."""
PEAK, RATE = 0.05, 1e-3
"""Largest nominal strain and rate in 1/s of the programmes where the experiment is no coupon."""
_OF_FIELDS = acting("conduction", "film")
"""Parameters of the base law that no coupon feels."""


@dataclass(frozen=True)
class Decision:
    """Effects that this test leaves undecided, what the programmes tell, and effects that no coupon feels; `added` is in the model."""

    family: tuple[str, ...]
    told: tuple[Discrimination, ...]
    unfelt: tuple[str, ...]
    failed: tuple[str, ...] = ()
    """Programmes that a coupon of these parameters cannot be driven through."""
    added: str = ""
    as_it_was: Discrimination | None = None
    """What the test itself tells of them on the mesh of the programmes of the specimen; None where there are none."""
    on_specimen: tuple[Discrimination, ...] = ()
    """What changes of the test would tell."""
    failed_on_specimen: tuple[str, ...] = ()

    @property
    def felt(self) -> tuple[str, ...]:
        """Members that a coupon feels."""
        return tuple(n for n in self.family if n not in self.unfelt)

    @property
    def best(self) -> Discrimination | None:
        """The first programme, the simplest, that parts what coupons feel of them; None where none does. Of one effect: the one that shows
        least of it."""
        if len(self.felt) == 1:
            shown = [t for t in self.told if self.felt[0] in t.detectable]
            return min(shown, key=lambda t: t.detectable[self.felt[0]]) if shown else None
        return next((t for t in self.told if t.cosine < ALIKE), None)

    @property
    def best_on_specimen(self) -> Discrimination | None:
        """The first change of the test that parts all of them where the test does not; where it does, but too weakly, the first that tells
        one of them from the others from half the amplitude on, and none of them later. Of one effect: the one that shows least of it, if
        that is half as much."""
        was = self.as_it_was
        if was is None:
            return None
        parts = [t for t in self.on_specimen if t.cosine < ALIKE]
        if was.cosine < ALIKE:
            shares = [(t, [t.apart(n) / was.apart(n) if n in was.detectable else 0.0 for n in self.family]) for t in parts]
            parts = [t for t, share in shares if max(share) <= 1.0 and min(share) < 0.5]
        if len(self.family) == 1:
            return min(parts, key=lambda t: t.detectable[self.family[0]], default=None)
        return next(iter(parts), None)


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
    """The families of accepted effects, as `like_of` tells them."""
    out, like = [], like_of(closed)
    for turn in closed.rounds:
        for trial in turn.trials:
            for score in trial.scores if trial.effects == turn.accepted else ():
                others = like.get(score.effect, ())
                if others:
                    settings = {n: v for other in others for n, v in turn.traced.settings.get(other, {}).items()}
                    out.append(Family((score.effect, *others), score.effect, settings))
    return tuple(out)


def decisions(here: Traced, added: Sequence[Family] = (), parts: JointParts | None = None) -> tuple[Decision, ...]:
    """A decision for every family of an effect that was added, then for every one that is undecided among dormant effects; `parts`: the
    problem of the specimens, where the records are no coupons."""
    known = sensitive_at_point(here)
    dormant = tuple(f for f in undecided_families(here) if not any(set(f) <= set(other.members) for other in added))
    settings = {n: v for family in dormant for other in family for n, v in here.settings.get(other, {}).items()}
    together = Family(tuple(dict.fromkeys(n for family in dormant for n in family)), "", settings)
    runs, on_specimen = _runs(here, together, known), _on_specimen(here, together, parts)
    found = [_decision(family, _runs(here, family, known), _on_specimen(here, family, parts), known) for family in added]
    return (*found, *(_decision(Family(family), runs, on_specimen, known) for family in dormant))


def sensitive_at_point(here: Traced) -> frozenset[str]:
    """Names of the effects that a coupon of this material feels; where the records are coupons, with those of their sensor."""
    return frozenset(e.name for e in (here.case.known if _records(here) else effects_of_point(sensor=False)))


def _records(here: Traced) -> tuple[CouponTest, ...]:
    """The records of the point driver that were fitted; none where the test was another one."""
    missing = here.case.model.missing
    return () if missing is None else missing.records


_Runs = Sequence[tuple[CandidateProgramme, dict[str, np.ndarray] | None]]


def _runs(here: Traced, family: Family, known: frozenset[str]) -> _Runs:
    """Columns of the members that a coupon feels by every programme, see `columns`."""
    wanted = tuple(effect(n) for n in family.members if n in known)
    if not wanted:
        return []
    parameters, usual, noise = at_point(here, family, known), _usual(here), _noise(here)
    return [(p, columns(p, usual, parameters, wanted, noise)) for p in PROGRAMMES]


def at_point(here: Traced, family: Family, known: frozenset[str]) -> Parameters:
    """The parameters of a coupon: free are those that it feels, but for what the added effect of a family has; the instruments of a body do
    not look at it."""
    base = here.case.parameters
    others = {n: param(n).neutral for n in base.values if n in station_names() and effect_of_param(n).name not in known}
    own = effect(family.added).names if family.added else ()
    free = (n for n in base.free if n not in own and (effect_of_param(n).name in known if is_of_effect(n) else AT not in n))
    return base.replace(**others, **family.settings).with_free(tuple(n for n in free if n not in _OF_FIELDS))


def _on_specimen(here: Traced, family: Family, parts: JointParts | None) -> _Runs:
    """Columns of all members by the test as it was and by its changes; nothing where the specimen's programmes are not known."""
    specimen = decide_specimen.drivable(parts)
    if not family.members or specimen is None:
        return []
    every = (decide_specimen.OWN, *decide_specimen.PROGRAMMES)
    return [(p, decide_specimen.columns(specimen, p, here.case.parameters, family)) for p in every]


def _all_told(runs: _Runs, members: Sequence[str]) -> tuple[Discrimination, ...]:
    return tuple(t for p, own in runs if own is not None and (t := discrimination_of(p, own, members)) is not None)


def _decision(family: Family, runs: _Runs, on_specimen: _Runs, known: frozenset[str]) -> Decision:
    felt, unfelt = (tuple(n for n in family.members if (n in known) is there) for there in (True, False))
    failed, failed_on_specimen = (tuple(p.name for p, own in of if own is None) for of in (runs, on_specimen))
    was = _all_told(on_specimen[:1], family.members)
    told = (_all_told(runs, felt), unfelt, failed, family.added, was[0] if was else None, _all_told(on_specimen[1:], family.members))
    return Decision(family.members, *told, failed_on_specimen)


def columns(
    named: Named, usual: Usual, parameters: Parameters, wanted: Sequence[Effect], noise: tuple[float, float]
) -> dict[str, np.ndarray] | None:
    """Whitened columns (2 n_t, k) of every effect that a coupon feels in a programme, without what the free parameters can do.

    An effect that is on is asked at its value, one that is off beside neutral. None where a coupon of these parameters cannot be driven so;
    `noise` = (MPa, K).
    """
    free = tuple(n for n in parameters.free if n not in _OF_FIELDS)
    off = [e for e in wanted if e.slot not in SENSOR and not e.is_on(parameters)]
    tiny = {e.amplitude.name: e.amplitude.neutral + TINY * float(e.amplitude.probe or 0.0) for e in off}
    felt = {e.name: tuple(p.name for p in e.amplitudes) for e in wanted}
    names = (*free, *(n for group in felt.values() for n in group))
    try:
        made = programme(named.name, usual, parameters, PointSettings())
        whole = _whitened(parameters.replace(**tiny), names, made, noise)
    except NumericsError:
        return None
    at = {name: k for k, name in enumerate(names)}
    found = projection(whole[:, : len(free)])
    own = {name: found.sensitive(whole[:, [at[n] for n in group]]) for name, group in felt.items()}
    return {name: block for name, block in own.items() if block.shape[1] > 0}


def _whitened(parameters: Parameters, names: tuple[str, ...], made: Driven, noise: tuple[float, float]) -> np.ndarray:
    """Derivatives (2 n_t, n_p) of stress and of what the sensor shows, over their noise. NumericsError where the run fails."""
    of_sensor = effects(SENSOR)
    stations = {n for e in of_sensor for n in e.names}
    material = tuple(n for n in names if n not in stations)
    history, rates = simulate_rates(parameters, material, made, PointSettings())
    start = float(history.theta[0])
    test = CouponTest("", history.time, history.strain, history.stress, None, parameters["theta_air"], start, {}, ())
    stress = np.zeros((len(history.time), len(names)))
    stress[:, [names.index(n) for n in material]] = rates["stress"]
    theta = shown_rates(history.theta_sensor, rates["theta_sensor"], test, parameters, names, of_sensor)
    return np.concatenate([stress / noise[0], theta / noise[1]])


def _usual(here: Traced) -> Usual:
    """Largest strain and usual rate of the records; those of a common tension test where there are none."""
    records = _records(here)
    if not records:
        return Usual(PEAK, RATE, here.case.parameters["theta_air"])
    peak = min(max(float(np.abs(t.strain).max()) for t in records), 0.5)
    rates = np.concatenate([np.abs(np.diff(t.strain) / np.diff(t.time)) for t in records])
    moving = rates[rates > 1e-3 * rates.max()]
    return Usual(peak, float(np.median(moving)), records[0].theta_start)


def _noise(here: Traced) -> tuple[float, float]:
    found = {bare_name(c.channel): float(np.sqrt(np.mean(c.sigma**2))) for c in here.case.model.comparisons}
    return found.get("stress", STRESS), found.get("dtheta", found.get("theta", TEMPERATURE))


def decided(summary: dict[str, Any], here: Traced, added: Sequence[Family] = (), parts: JointParts | None = None) -> dict[str, Any]:
    """A summary with `programmes`, what each would tell of every undecided family, those of `added` effects first, and the sentences of
    `undecided` completed; arguments as `decisions`."""
    found = decisions(here, added, parts)
    rows = [
        {
            "family": list(d.family),
            "added": d.added or None,
            "best": None if d.best is None else d.best.programme.name,
            "no_coupon_feels": list(d.unfelt),
            "not_driven": list(d.failed),
            "told": [_row(t) for t in d.told],
            "on_specimen": None if d.as_it_was is None else _specimen(d, d.as_it_was),
        }
        for d in found
    ]
    said = [*summary.get("undecided", []), *(in_words(d) for d in found)]
    return {**summary, "undecided": said, "programmes": rows}


def _row(t: Discrimination) -> dict[str, Any]:
    return {"programme": t.programme.name, "max_cos": t.cosine, "detectable": t.detectable}


def _specimen(d: Decision, was: Discrimination) -> dict[str, Any]:
    """What changes of the test would tell, as a plain row."""
    best = None if d.best_on_specimen is None else d.best_on_specimen.programme.name
    return {"best": best, "not_driven": list(d.failed_on_specimen), "as_it_was": _row(was), "told": [_row(t) for t in d.on_specimen]}


def in_words(d: Decision) -> str:
    """A decision as a sentence."""
    names = " or ".join(f"{n} (added)" if n == d.added else n for n in d.family) if d.added else " and ".join(d.family)
    missing = [f"a coupon test cannot show {acted_on(d.unfelt)}"] if d.unfelt else []
    return f"{names}: {'; '.join([*_of_programmes(d), *missing, *_of_specimen(d)])}"


def _shown(t: Discrimination) -> str:
    return ", ".join(f"{n} from {v:.2g}" for n, v in t.detectable.items())


def _of_programmes(d: Decision) -> list[str]:
    if not d.felt:
        return []
    if d.best is None:
        tried = ", ".join(p.name for p in PROGRAMMES if p.name not in d.failed)
        missed = f" ({', '.join(d.failed)}: a coupon of these parameters cannot be driven so)" if d.failed else ""
        would = f"would part {' and '.join(d.felt)}" if len(d.felt) > 1 else f"would show {d.felt[0]}"
        return [f"none of the programmes {tried} {would}{missed}"]
    part = f" (|cos| {d.best.cosine:.2f})" if len(d.felt) > 1 else ""
    return [f"the programme {d.best.programme.name} ({d.best.programme.words}) would decide{part}", f"it shows {_shown(d.best)} on"]


def _of_specimen(d: Decision) -> list[str]:
    was, best = d.as_it_was, d.best_on_specimen
    if was is None:
        return ["on the coarse mesh of the programmes this specimen cannot be driven as it was"] if d.failed_on_specimen else []
    if best is None:
        tried = ", ".join(p.name for p in decide_specimen.PROGRAMMES if p.name not in d.failed_on_specimen)
        missed = f" ({', '.join(d.failed_on_specimen)}: this specimen cannot be driven so)" if d.failed_on_specimen else ""
        return [f"none of the changes {tried} of this test would {'distinguish them' if len(d.family) > 1 else 'show it better'}{missed}"]
    part = f" (|cos| {best.cosine:.2f}, as it was {was.cosine:.2f})" if len(d.family) > 1 else ""
    return [f"on the specimen {best.programme.name} ({best.programme.words}) would decide{part}", f"it shows {_shown(best)} on"]
