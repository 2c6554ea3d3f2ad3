"""Effects that temperatures show, judged by a refit on the known motion where one linear step from the optimum says too little.

A model that lacks something large drives its thermal parameters far off before it settles: contact, capacity, conductivity and heat of
plastic work lie in one bent valley. A drift of the jaws ends in a contact that conducts nothing, and through such a contact no drift is
felt. Neither the step of an effect from there nor the angle between two effects there is that of a model that fits. A heat run costs a
tenth of a coupled one, so that every effect that temperatures show is refitted on the motion of the optimum, with all parameters that
temperatures feel; it is judged by its held-out error there, and its family is told at the best of these ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case, HeatFit
from thermofit.diagnose.held_out import SURE, Proof, Rows, compared, restricted
from thermofit.diagnose.protected import Begin, Protected, begins, pairs, protected
from thermofit.diagnose.refit import with_effect
from thermofit.diagnose.score import ALIKE, Columns, Score, projected_likeness, ranked
from thermofit.diagnose.trace import PLAIN, PROVED_AT_MOST, Traced, room_of
from thermofit.effects.catalogue import effect
from thermofit.experiment.channels import field_of
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.priors import contradicted
from thermofit.fit.covariance import NoiseOperator
from thermofit.fit.linear_model import LinearModel, projection
from thermofit.fit.result import FitResult

REFITTED = 6
"""Most effects that are refitted from protected parameters."""
EXPLAINED = 2.0 / 3.0
"""Part of what a broad source explains that a name has to explain: it leaves half of what it takes at most."""
OF_SOURCE = "what a heat source over place, time and plastic strain explains: not the cause"
"""Ends the sentence on an effect that explains less than that part."""
RIVAL = 1.5
"""Times the square sum that the best of them leaves: a refit that would leave more is neither a name nor of the family of one."""
PARTNERS = 8
"""Effects of which pairs are made there, and..."""
PAIRS = 3
"""...pairs that are refitted."""
OF_THE_BEST = 0.25
"""Part of what the best of them takes there that an effect has to take to be refitted."""
HALF = 0.5
"""Part of what the residual holds beyond noise that the best linear step takes away where one step is enough."""


@dataclass(frozen=True)
class _End:
    """An effect refitted on the known motion: parameters, square sum of the temperatures' rows, the residual (n,) of all rows with those of
    the temperatures replaced, and the same as predicted from the folds that do not hold them."""

    score: Score
    parameters: Parameters
    left: np.ndarray
    held_out: np.ndarray
    proof: Proof


def rescored(here: Traced) -> Traced:
    """The trace with proofs, estimates and families of refits on the motion that displacements tell; the same where nothing is missing, or
    where one step of an effect that displacements show is enough. Where no broad source is known, also where one step of any is, or where
    no two effects that temperatures show stand above the threshold. NumericsError where the run of the motion fails."""
    asked = asked_of(here)
    best = max((s for s in here.ranking.scores if not s.vetoed), key=lambda s: s.predicted_drop, default=None)
    if here.case.heated is None or (enough(here) and (best is None or not _judged_here(here, best.effect))):
        return here  # what displacements show comes first: on a motion that is wrong, temperatures say little
    proposed = any(_judged_here(here, s.effect) for s in here.promising())
    if not proposed and here.answered:
        return here  # else, below the floor of a coarse mesh too, a step from parameters that are driven off names impostors
    moved = on_its_motion(here)
    fit = here.case.heated(moved.case.parameters)
    if fit is None:
        return here
    shielded = _from_protected(moved, fit)
    refused: Mapping[str, str] = {}
    ends: Mapping[str, _End]
    if shielded is not None:
        ends, refused = shielded.ends, shielded.refused
    else:
        if len(asked) < 2 or enough(here):
            return here
        ends = {s.effect: end for s in asked if (end := refitted(moved, (s,), fit, here.settings.get(s.effect, {}))) is not None}
    if not ends and not refused:
        return here
    alike = _alike(moved, ends, fit) if ends else {}
    known = {s.effect for s in here.ranking.scores}
    shown = [end.score for name, end in ends.items() if name not in known]
    every = (_told(s, ends, alike) for s in (*here.ranking.scores, *shown))
    told = sorted((replace(s, vetoed=s.vetoed or refused.get(s.effect, "")) for s in every), key=lambda s: (bool(s.vetoed), -s.z))
    unfelt = tuple(name for name in here.ranking.unfelt if name not in ends)
    proofs = {**here.proofs, **{name: end.proof for name, end in ends.items()}}
    ranking = replace(here.ranking, scores=tuple(told), unfelt=unfelt)
    own = {name: {p.name: end.parameters[p.name] for p in effect(name).exponents} for name, end in ends.items()}
    settings = {**here.settings, **{name: values for name, values in own.items() if values}}
    both = () if shielded is None else shielded.pairs
    found = replace(here, ranking=ranking, proofs=proofs, warmed=tuple(ends), shown=ends, settings=settings, together=both)
    return found if shielded is None else replace(found, against_source=True, protected=shielded.protected)


def on_its_motion(here: Traced) -> Traced:
    """The trace at parameters whose motion is that of the displacements alone: a joint fit bends the motion to what is missing in the
    temperatures, and on such a motion nothing explains them. NumericsError where that fit fails."""
    case = here.case
    return here if case.moved is None else replace(here, case=replace(case, parameters=case.moved(case.parameters)))


@dataclass(frozen=True)
class _Shielded:
    """What refits from protected parameters have shown: ends by effect, why effects are no name for what is missing, and the scores and
    ends of pairs that are; the protected parameters."""

    ends: Mapping[str, _End]
    refused: Mapping[str, str]
    pairs: tuple[tuple[tuple[Score, ...], _End], ...]
    protected: Protected


def _from_protected(here: Traced, fit: HeatFit) -> _Shielded | None:
    """Refits of effects on the known motion from parameters that the missing heat has not driven off, those first that explain most there;
    None where the model knows of no broad source.

    A name has to explain the broad source: it leaves no more than half of what it takes of it, noise and the error of mesh and steps apart,
    and with the declared readings as they are.
    """
    mine, found = shown_rows(here), protected_at(here, fit)
    names = [e.name for e in here.case.dormant() if _judged_here(here, e.name)]
    if found is None or not names:
        return None
    first = begins(here.case, fit, found, names)
    ranked_here = {s.effect: s for s in here.ranking.scores}
    now = nothing_added(here, fit, found, mine)
    worth = [b for b in first if now - b.f > max(OF_THE_BEST * (now - first[0].f), 0.0)][:REFITTED]
    scores = [(ranked_here.get(b.effects[0]) or hidden(b.effects[0]), b.parameters) for b in worth]
    ends = {s.effect: end for s, start in scores if (end := refitted(here, (s,), fit, {}, start)) is not None}
    whole = now - found.with_source - _numerical(here, mine)
    if whole <= PLAIN * np.sqrt(2.0 * float(mine.sum())):
        return _Shielded(ends, {}, (), found)

    def left_by(end: _End) -> float:
        return float(np.sum(end.left[mine] ** 2))

    def share_of(end: _End) -> float:
        return (now - left_by(end)) / whole

    def judged(these: Sequence[Score], start: Parameters, end: _End) -> tuple[_End, str]:
        """The better end with exponents held or free, with declared readings where they were read, and why it is no name for what is
        missing (empty: it is one). Held at scanned values, between which the truth may lie, an effect explains too little, and a coupled
        refit that begins there crawls along the valley into which that drives the others."""
        freed = any(effect(s.effect).exponents for s in these)

        least = min(left_by(one) for one in (*ends.values(), end))
        more = refitted(here, these, fit, {}, start, True, min(now - EXPLAINED * whole, RIVAL * least)) if freed else None
        if more is not None and share_of(more) > share_of(end):
            end = more
        held = with_readings(here, these, fit, end, found, freed) if share_of(end) >= EXPLAINED else None
        end, words = (end, "") if held is None else (held, ", declared readings held,")
        part = 100.0 * max(share_of(end), 0.0)
        why = f"explains{words} {part:.0f} % of {OF_SOURCE}"
        return end, why if share_of(end) < EXPLAINED else ""

    refused = {}
    for score, start in ((s, start) for s, start in scores if s.effect in ends):
        ends[score.effect], why = judged((score,), start, ends[score.effect])
        if why:
            refused[score.effect] = why
    far = {n: "explains far less than others once the missing heat no longer drives the parameters off" for n in names if n not in ends}
    if displacements_hold_nothing(here):
        words = "the fitted parameters explain the displacements; what is missing shows in the temperatures alone"
        far |= {e.name: words for e in here.case.dormant() if e.name not in names}
    both = pairs(here.case, found, first[:PARTNERS]) if len(refused) == len(ends) else ()
    worth_both = [p for p in both if now - p.f > EXPLAINED * whole][:PAIRS]
    tried = [(p.parameters, *t) for p in worth_both if (t := _both_refitted(here, fit, p)) is not None]
    told = [(these, *judged(these, start, end)) for start, these, end in tried]
    return _Shielded(ends, refused | far, tuple((these, end) for these, end, why in told if not why), found)


def protected_at(here: Traced, fit: HeatFit) -> Protected | None:
    """The protected parameters of a traced case, those of an earlier round where that has told them there; None where the model knows of no
    broad source. NumericsError where a run fails."""
    mine = shown_rows(here)
    return here.protected or protected(without_pose(here.case), fit, _only(here.rows, mine), restricted(here.split, mine))


def share_of_source(here: Traced, there: Traced) -> float | None:
    """Part of what a broad source explains of the temperatures of a trace that they no longer miss at another end; None where no such
    source was asked for, or it explains no more than noise."""
    if here.protected is None:
        return None
    mine = shown_rows(here)
    now, left = (float(np.sum(t.columns.residual[mine] ** 2)) for t in (here, there))
    whole = now - here.protected.with_source - _numerical(here, mine)
    return (now - left) / whole if whole > PLAIN * np.sqrt(2.0 * float(mine.sum())) else None


def _numerical(here: Traced, mine: np.ndarray) -> float:
    """Square sum of the error of mesh and steps that may be left in the rows that are `mine`."""
    error = here.problem.may_be_left
    return 0.0 if error is None else float(np.sum(error[mine] ** 2))


def nothing_added(here: Traced, fit: HeatFit, found: Protected, mine: np.ndarray) -> float:
    """Square sum in the rows that are `mine` that no effect is credited with: at the optimum, or where the same parameters end from the
    protected ones if that is less. The optimum may lie in another valley, and whatever leaves it would seem to explain what is missing. A
    fit that cannot be run is noted among its failures."""
    now = float(np.sum(here.columns.residual[mine] ** 2))
    there = without_pose(here.case).parameters
    start = there.replace(**{n: found.parameters[n] for n in acting_on_temperatures(there.free)})
    try:
        end = _minimised(fit, start, "nothing added on the known motion")
    except NumericsError:
        return now
    return min(now, float(np.sum(fit.model.residual(end) ** 2)))


def without_pose(case: Case) -> Case:
    """The case with the pose of the camera as its landmarks have it, and held: what is missing is far more than their error, and the pose
    would stand in for it. The coupled refit that follows has it free."""
    there = case.parameters.replace(**{n: param(n).neutral for n in case.pose})
    return replace(case, parameters=there.with_free(tuple(n for n in there.free if n not in case.pose)))


def _minimised(fit: HeatFit, start: Parameters, label: str, to_beat: float = np.inf) -> Parameters:
    """The optimum from a start and, where the fit can, from there alone; `to_beat` as `HeatFit.from_here` has it."""
    return fit.minimised(start, label) if fit.from_here is None else fit.from_here(start, label, to_beat)


def _both_refitted(here: Traced, fit: HeatFit, begin: Begin) -> tuple[tuple[Score, ...], _End] | None:
    """The effects of a beginning refitted together on the known motion, and their scores with the estimates of that; None where it cannot
    be run."""
    known = {s.effect: s for s in here.ranking.scores}
    scores = [known.get(name) or hidden(name) for name in begin.effects]
    end = refitted(here, scores, fit, {}, begin.parameters)
    if end is None:
        return None
    told = [replace(s, estimate={p.name: end.parameters[p.name] for p in effect(s.effect).amplitudes}, vetoed="") for s in scores]
    return tuple(told), end


def with_readings(here: Traced, scores: Sequence[Score], fit: HeatFit, end: _End, found: Protected, freed: bool) -> _End | None:
    """The refit of effects with those declared readings held that its end has driven beyond their errors, from that end; None where it has
    driven none, or they are the effects' own. A reading that has to give way stands in for something that the effects are not."""
    gone = {p.name: p.value for p in contradicted(fit.model.priors, end.parameters, found.parameters)}
    if not gone or set(gone) & {n for s in scores for n in effect(s.effect).names}:
        return None
    start = end.parameters.replace(**gone).with_free(tuple(n for n in end.parameters.free if n not in gone))
    return refitted(here, scores, fit, {}, start, freed)


def displacements_hold_nothing(here: Traced) -> bool:
    """Whether a step of the fitted parameters leaves no more in the rows that are not the temperatures' than noise, the error of mesh and
    steps and chance make. A joint fit spreads what is missing in one field over both; each alone says where it is."""
    own = ~shown_rows(here)
    alone = LinearModel(here.columns.residual[own], here.columns.fitted[own]).left
    n = float(own.sum())
    return float(alone @ alone) - n - _numerical(here, own) < PLAIN * np.sqrt(2.0 * n)


def _only(rows: Rows, mine: np.ndarray) -> Rows:
    """The rows that are `mine`."""
    return Rows(rows.channel[mine], rows.time[mine], rows.xy[mine], rows.phase[mine])


def asked_of(here: Traced) -> tuple[Score, ...]:
    """Effects that temperatures show and that stand above the threshold, the strongest first, those that cannot be last; then those of
    which next to nothing is felt where the parameters are: one step would take them out of their bounds. None that declared held-out tests
    judge."""
    every = [s for s in here.ranking.scores if _judged_here(here, s.effect)]
    found = [s for s in every if s.z > here.ranking.threshold]
    faint = (s.effect for s in every if s.vetoed and s not in found)
    faintest = [hidden(name) for name in (*faint, *(n for n in here.ranking.unfelt if _judged_here(here, n)))]
    return tuple([*sorted(found, key=lambda s: bool(s.vetoed)), *faintest][:PROVED_AT_MOST])


def _judged_here(here: Traced, name: str) -> bool:
    """Whether temperatures show an effect, and no declared held-out test judges it."""
    names = effect(name).names
    return len(acting_on_temperatures(names)) == len(names) and not (name in here.proofs and here.proofs[name].on)


def hidden(name: str) -> Score:
    """An effect that is not felt where the parameters are: what it acts through is fitted to nothing there."""
    probes = {p.name: p.neutral + float(p.probe or 0.0) for p in effect(name).amplitudes}
    return Score(name, 0.0, 0.0, 0.0, probes, dict.fromkeys(probes, float("inf")), 0.0, float("inf"), "", (name,))


def enough(here: Traced) -> bool:
    """Whether the best linear step takes away half of what the residual holds beyond its floor, or that is not more than chance."""
    beyond = here.excess(float(here.columns.residual @ here.columns.residual))
    best = max((s.predicted_drop for s in here.ranking.scores if not s.vetoed), default=0.0)
    return beyond == 0.0 or best > HALF * beyond


def shown_rows(here: Traced) -> np.ndarray:
    """True (n,) in rows that the model of the temperatures alone has: theirs and the priors'."""
    warm = [k for k, c in enumerate(here.case.model.comparisons) if field_of(c) == "theta"]
    return np.asarray(np.isin(here.rows.channel, [*warm, -1]))


def shown_alone(here: Traced, fit: HeatFit) -> dict[str, _End]:
    """Effects that temperatures show, each refitted on the known motion, as `rescored` has done it where it was asked."""
    if here.shown:
        return dict(here.shown)
    return {s.effect: end for s in asked_of(here) if (end := refitted(here, (s,), fit, here.settings.get(s.effect, {}))) is not None}


def shown_together(here: Traced, fit: HeatFit, scores: Sequence[Score], settings: Mapping[str, float]) -> _End | None:
    """Several effects refitted together on the known motion; None where no start can be run."""
    return refitted(here, scores, fit, settings)


def refitted(
    here: Traced,
    scores: Sequence[Score],
    fit: HeatFit,
    settings: Mapping[str, float],
    begin: Parameters | None = None,
    freed: bool = False,
    to_beat: float = np.inf,
) -> _End | None:
    """Effects refitted on the known motion; None where no start can be run, which the fit notes among its failures. The end bears the score
    of the first one, told there where it was not felt before. `begin`: where the fit starts, with the effects in it, and from there alone;
    `freed`: with their exponents free; `to_beat`: the square sum of its rows above which a refit is given up.

    The optimum without the effect may lie where nothing is felt of it, so that the fall of the square sum tells its score as well.
    """
    score, start = scores[0], without_pose(here.case).parameters if begin is None else begin
    for one in scores:
        chosen = {n: v for n, v in settings.items() if n in effect(one.effect).names}
        own = {**one.estimate, **chosen} if begin is None else {n: begin[n] for n in effect(one.effect).names}
        start = with_effect(start, one.effect, own)
    if freed:
        start = start.with_free(tuple(dict.fromkeys((*start.free, *(p.name for one in scores for p in effect(one.effect).exponents)))))
    label = f"{' '.join(s.effect for s in scores)} on the known motion"
    try:
        parameters = fit.minimised(start, label) if begin is None else _minimised(fit, start, label, to_beat)
    except NumericsError:
        return None
    before = here.problem.model.predicted(here.split.folds)
    thermal = acting_on_temperatures(parameters.free)
    mine = shown_rows(here)
    noise = _of_rows(here.problem.model.noise, mine)
    warm = LinearModel(*fit.model.linearised(parameters, thermal), noise, room_of(parameters, thermal, here.case.reach))
    predicted = warm.predicted(restricted(here.split, mine).folds)
    left, after = here.columns.residual.copy(), before.copy()
    left[mine], after[mine] = warm.residual, predicted
    proof = compared(before, after, here.rows, len(here.split.held_out), here.problem.model.noise, left)
    if len(scores) == 1 and (score.vetoed or score.z == 0.0 or begin is not None):
        score = _scored_there(here, score, parameters, warm, mine)
    if len(scores) == 1 and begin is not None:
        # A drift acts through a film: the data know the product, and the quotient has no standard error that says how far it is from
        # nothing.
        fall = max(float(np.sum(here.columns.residual[mine] ** 2)) - warm.f, 0.0)
        variance = max(warm.f / len(warm.residual), _variance_along(warm.residual - here.columns.residual[mine], noise))
        score = replace(score, z=max(score.z, float(np.sqrt(fall / variance))), predicted_drop=fall)
    return _End(score, parameters, left, after, proof)


def _of_rows(noise: NoiseOperator | None, mine: np.ndarray) -> NoiseOperator | None:
    """A noise for the rows (n,) that are `mine` alone."""
    if noise is None:
        return None

    def apply(columns: np.ndarray) -> np.ndarray:
        whole = np.zeros((len(mine), columns.shape[1]))
        whole[mine] = columns
        return noise(whole)[mine]

    return apply


def _variance_along(change: np.ndarray, noise: NoiseOperator | None) -> float:
    """Variance of the noise along a change (n,) of the residual."""
    size = float(change @ change)
    return 1.0 if noise is None or size == 0.0 else float(change @ noise(change[:, None])[:, 0]) / size


def _scored_there(here: Traced, score: Score, parameters: Parameters, there: LinearModel, mine: np.ndarray) -> Score:
    """The score of an effect by the parameters of its refit, linearised there in the rows that are `mine`, a mask."""
    names = tuple(p.name for p in effect(score.effect).amplitudes)
    thermal = acting_on_temperatures(parameters.free)
    block = there.columns[:, [thermal.index(n) for n in names]]
    without = there.residual - block @ np.array([parameters[p.name] - p.neutral for p in effect(score.effect).amplitudes])
    groups = None if here.problem.groups is None else here.problem.groups[mine]
    others = there.only([k for k, n in enumerate(thermal) if n not in names])
    alone = ranked(Columns(replace(others, residual=without), {score.effect: (names, block)}, groups))
    return replace(alone.scores[0], numerical_drop=score.numerical_drop, family=score.family) if alone.scores else score


def _alike(here: Traced, ends: Mapping[str, _End], fit: HeatFit) -> dict[tuple[str, str], float]:
    """|cos| of every two of these effects at the best of the ends, one where what they predict of held-out data cannot be told apart."""
    best = max(ends.values(), key=lambda end: end.proof.gain)
    own = {name: tuple(p.name for p in effect(name).amplitudes) for name in ends}
    others = tuple(n for n in acting_on_temperatures(best.parameters.free) if n not in own[best.score.effect])
    scanned = {n: v for name, end in ends.items() if name != best.score.effect for n, v in here.settings.get(name, {}).items()}
    names = (*others, *(n for group in own.values() for n in group))
    _, columns = fit.model.linearised(best.parameters.replace(**scanned), names)
    at = {n: k for k, n in enumerate(names)}
    blocks = {name: columns[:, [at[n] for n in group]] for name, group in own.items()}
    alike = projected_likeness(columns[:, : len(others)], blocks)
    for one, other in ((a, b) for a in ends for b in ends if a != b):
        if not _discriminated(here, ends[one], ends[other]):
            alike[one, other] = 1.0
    return alike


def _discriminated(here: Traced, one: _End, other: _End) -> bool:
    """Whether one of two ends predicts held-out data better than the other by more than its uncertainty."""
    worse, better = sorted((one, other), key=lambda end: end.proof.gain)
    found = compared(worse.held_out, better.held_out, here.rows, len(here.split.held_out), here.problem.model.noise, better.left)
    return found.gain > SURE * found.sigma


def _told(score: Score, ends: Mapping[str, _End], alike: Mapping[tuple[str, str], float]) -> Score:
    """A score with the estimate of its refit, and the family that the refits tell; members that were not refitted stay."""
    if score.effect not in ends:
        return score
    end = ends[score.effect]
    one = score.effect
    near = sorted((b for b in ends if b != one and alike[one, b] > ALIKE), key=lambda b: -alike[one, b])
    family = (score.effect, *near, *(n for n in score.family[1:] if n not in ends))
    return replace(end.score, estimate={n: end.parameters[n] for n in end.score.estimate}, family=family)


def missed(there: Traced, name: str, fit: FitResult) -> float:
    """Standard errors by which the temperatures miss an effect that is on, once everything else is fitted again on the motion of `there`.

    A drift acts through a film: the data know the product with the film's coefficient, and the quotient has no standard error of its own
    that says how far it is from nothing. Zero where temperatures do not show the effect, or where no start without it can be run, which the
    fit notes among its failures. `fit`: the one that gave its parameters, with its standard errors, which hold how the noise hangs
    together.
    """
    names, amplitudes = effect(name).names, tuple(p.name for p in effect(name).amplitudes)
    parameters = there.case.parameters
    warm = there.case.heated(parameters) if there.case.heated is not None and len(acting_on_temperatures(names)) == len(names) else None
    if warm is None or fit.jacobian is None or fit.sigma is None:
        return 0.0
    off = parameters.replace(**{p.name: p.neutral for p in effect(name).amplitudes})
    try:
        without = warm.minimised(off.with_free(tuple(n for n in parameters.free if n not in names)), f"without {name} on the known motion")
    except NumericsError:
        return 0.0
    rise = float(np.sum(warm.model.residual(without) ** 2) - np.sum(warm.model.residual(parameters) ** 2))
    white = np.sum(projection(fit.jacobian).root() ** 2, axis=1)
    own = [fit.names.index(n) for n in amplitudes if n in fit.names]
    together = max((float(fit.sigma[k]) ** 2 / max(float(white[k]), 1e-300) for k in own), default=1.0)
    return float(np.sqrt(max(rise, 0.0) / max(together, 1.0)))
