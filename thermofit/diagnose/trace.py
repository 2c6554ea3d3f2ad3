"""Trace the residual to effects: scores of all dormant effects, held-out proof of the strongest, and which of them are worth a refit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case, Linearised, at_its_end, columns_of, linearised, scans
from thermofit.diagnose.held_out import FEWEST, Proof, Rows, Split, groups_of, proof, split_by_blocks, split_by_phase
from thermofit.diagnose.other_tests import UnseenColumns, proof_unseen, unseen_columns_of
from thermofit.diagnose.remembered import noise_of, remembered
from thermofit.diagnose.score import OVER_NUMERICAL, Columns, Ranking, Score, drop_of, ranked
from thermofit.effects.catalogue import Effect, is_of_effect
from thermofit.experiment.priors import improbable
from thermofit.experiment.trust import Bounds, physical
from thermofit.fit.linear_model import LinearModel, Room, projection
from thermofit.fit.result import FitResult

PLAIN = 4.0
"""Standard errors of the square sum of noise beyond which a residual holds something."""
PROVED_AT_MOST = 8
"""Effects for which held-out data are asked."""
_BLOCKS = (25, 5)
_BUFFER_SHARE = (0.01, 0.05)
"""Parts of time and of length that are left out beside a held-out block at least."""


Scan = tuple[dict[str, float], np.ndarray]
"""Values of the exponents of an effect, and its columns (n, k) there."""


@dataclass(frozen=True)
class Traced:
    """A case traced: its columns, rows, split of held-out data, ranking, and proofs by effect."""

    case: Case
    columns: Linearised
    rows: Rows
    split: Split
    ranking: Ranking
    proofs: Mapping[str, Proof]
    problem: Columns
    settings: Mapping[str, dict[str, float]]
    """Values of exponents that were scanned, by effect."""
    unseen: tuple[UnseenColumns, ...] = ()
    """The declared held-out tests at these parameters."""
    warmed: tuple[str, ...] = ()
    """Effects that were refitted on the known motion: proof, estimate and family are those of the refit."""
    unjudged: Mapping[str, str] = field(default_factory=dict)
    """Effects with which the model could not run, however near to neutral and with none of the values of their exponents, and why: the
    data may hold them or not."""
    scanned: Mapping[str, tuple[Scan, ...]] = field(default_factory=dict)
    """Of effects whose exponents were scanned: every set of values that could be run, the best first."""
    unpredicted: Mapping[str, str] = field(default_factory=dict)
    """Declared held-out tests that the model cannot be run through at these parameters, and why."""
    shown: Mapping[str, Any] = field(default_factory=dict)
    """Where the refits of `warmed` effects on the known motion end; that of a pair by both names."""
    together: tuple[Any, ...] = ()
    """Scores and ends of pairs that explain on the known motion what a broad source explains."""
    against_source: bool = False
    """Whether effects that temperatures show were held against a broad source: then no further pairs of them are made. Where the source
    takes no more than noise, two effects of heat take no more either."""
    protected: Any = None
    """The parameters beside that source, and the source (`protected.Protected`)."""
    from_displacements: Mapping[str, Parameters] = field(default_factory=dict)
    """Where fits of effects to the displacements alone end, which a refit begins with."""
    whole: bool = True
    """False where no dormant effect was asked: the end of a refit, whose own parameters are all that judges it."""

    def excess(self, f: float) -> float:
        """What a square sum f of the residual holds beyond noise and what the error of mesh and steps that may be left would make; no more
        than chance where it is not above PLAIN standard errors of the square sum of noise, then zero."""
        return beyond_floor(f, len(self.columns.residual), self.problem.may_be_left)

    @property
    def answered(self) -> bool:
        """Whether the fitted parameters leave no more than the floor."""
        return self.excess(float(self.columns.residual @ self.columns.residual)) == 0.0

    def promising(self) -> tuple[Score, ...]:
        """Effects worth a refit, the largest held-out gain first; where gains differ by no more than their errors, one that a refit on the
        known motion has shown comes before one that the linear model promises."""
        left = [s for s in self.ranking.scores if s.effect in self.proofs and self.why_not(s) == ""]
        found: list[Score] = []
        while left:
            best = max(left, key=lambda s: self.proofs[s.effect].gain)
            if best.effect not in self.warmed:
                shown = [s for s in left if s.effect in self.warmed and self.proofs[s.effect].not_less_than(self.proofs[best.effect])]
                best = max(shown, key=lambda s: self.proofs[s.effect].gain, default=best)
            found.append(best)
            left.remove(best)
        return tuple(found)

    def why_not(self, score: Score) -> str:
        """In words why an effect is not worth a refit, empty where it is."""
        if score.effect in self.unjudged:
            return f"not judged: {self.unjudged[score.effect]}"
        if score.vetoed:
            return score.vetoed
        if score.z <= self.ranking.threshold:
            return f"not significant (z {score.z:.2f}, threshold {self.ranking.threshold:.2f})"
        if score.predicted_drop <= OVER_NUMERICAL * score.numerical_drop:
            return "the error of mesh and time steps alone looks as large"
        proved = self.proofs.get(score.effect)
        if proved is None:
            return "weaker than others, not tried on held-out data"
        if not proved.convinces:
            return f"{proved.words}: not enough" if proved.gain > 0.0 else proved.words
        return ""


def beyond_floor(f: float, n: int, numerical: np.ndarray | None) -> float:
    """What a square sum f of n rows holds beyond noise and the error of mesh and steps (n,) that may be left; zero where that is chance."""
    beyond = f - n - (0.0 if numerical is None else float(numerical @ numerical))
    return beyond if beyond >= PLAIN * np.sqrt(2.0 * n) else 0.0


def information(fitted: np.ndarray) -> np.ndarray:
    """Share (n,) of every row in what all rows tell of the parameters, half of it even: mean of its squared normalised columns."""
    return np.asarray(0.5 / len(fitted) + 0.5 * np.mean(projection(fitted).unit ** 2, axis=1))


def _clocked(case: Case, rows: Rows) -> Rows:
    """Rows of coupons with the number of the sample for the time: records of one study last from milliseconds to hours."""
    return replace(rows, time=np.unique(rows.time, return_inverse=True)[1].astype(float)) if case.cheap else rows


def split_of(case: Case, rows: Rows, fitted: np.ndarray, how: str = "auto", memory: float = 0.0) -> Split:
    """Held-out data: load phases where there are several ("phases"), else buffered blocks ("blocks"); "auto" takes blocks.

    Blocks see every phase, so that a parameter which a single phase determines is not lost with it; `fitted` (n, p) are the columns of the
    fitted parameters, of which every fold still sees enough. Their buffer in space is not shorter than the noise hangs together: else a
    seen point would tell the noise of a held-out one. So it is in time: `memory` is how long it hangs together, in samples on coupons,
    whose clock they are. A body is seen in few frames, and its blocks become longer for it. Records and experiments have blocks of their
    own.
    """
    clock = "samples" if case.cheap else "s"
    rows = _clocked(case, rows)
    if how == "phases":
        found = split_by_phase(rows, [s.name for s in case.spans], _BUFFER_SHARE[0] * float(np.ptp(rows.time)))
        if found is not None:
            return found
    used = rows.channel >= 0
    length = float(np.ptp(rows.xy[used, 1]))
    longest = np.inf if case.cheap or memory <= 0.0 else 0.5 * float(np.ptp(rows.time[used])) / memory
    shape = (int(np.clip(longest, FEWEST, _BLOCKS[0])), _BLOCKS[1] if length > 0.0 else 1)
    names = [span.record or span.experiment for span in case.spans]
    of_span = np.array([names.index(name) for name in names])
    here = of_span[np.where(used, rows.phase, 0)]
    # Rows of priors are seen in every fold: they stand nowhere, and are put where no block is changed by them.
    first = {k: float(rows.time[used & (here == k)].min()) for k in np.unique(here[used])}
    at = int(min(first))
    here, time = np.where(used, here, at), np.where(used, rows.time, first[at])
    inside = replace(rows, time=time)
    buffer = (_BUFFER_SHARE[0] * float(np.ptp(time)), max(_BUFFER_SHARE[1] * length, case.correlation_length))
    weight = np.where(used, information(fitted), 0.0)
    split = split_by_blocks(inside, shape, buffer, weight=weight, clock=clock, part=here, fitted=fitted, memory=memory)
    kept = tuple(held & used for held in split.held_out)
    note = " (only one load phase)" if how == "phases" else ""
    return Split(kept, tuple(near & used for near in split.buffer), split.by + note)


def traced(
    case: Case, numerical: np.ndarray | None = None, how: str = "auto", split: Split | None = None, fit: FitResult | None = None
) -> Traced:
    """Trace a case; `split`: the held-out data of an earlier trace, so that both can be compared. `fit`: the one that ended there.

    UntrustworthyError where the data do not suffice; NumericsError where the run fails.
    """
    found = linearised(case, fit)
    rows = case.rows
    alike = remembered(case, rows, found.residual)
    if split is None:
        split = split_of(case, rows, found.fitted, how, alike.lag(case, rows))
    groups = groups_of(_clocked(case, rows), np.ones(len(rows.time), dtype=bool))
    noise = noise_of(case, alike)
    room = room_of(case.parameters, case.parameters.free, case.reach)
    model = LinearModel(found.residual, found.fitted, noise, room, len(case.model.priors))
    columns = Columns(model, found.dormant, groups, numerical, channel=rows.channel)
    answered = beyond_floor(float(found.residual @ found.residual), len(found.residual), columns.may_be_left) == 0.0
    columns = replace(columns, material=material_of(case, answered))
    scanned, unjudged = _scanned(case, columns, found)
    return _judged(case, found, rows, split, columns, scanned, unjudged)


def with_residual(here: Traced, residual: np.ndarray) -> Traced:
    """The trace with another residual (n,) and the columns as they are: what data that differ a little would be asked, without a run.
    Declared held-out tests are left out of it."""
    case = replace(here.case, other_tests=())
    columns = replace(here.problem, model=replace(here.problem.model, residual=residual), also_tried=())
    scanned = {}
    for name, tried in here.scanned.items():
        names = here.problem.dormant[name][0]
        falls = [drop_of(columns, names, block) for _, block in tried]
        scanned[name] = tuple(tried[k] for k in sorted(range(len(tried)), key=lambda k: -falls[k]))
    return _judged(case, replace(here.columns, residual=residual), here.rows, here.split, columns, scanned, dict(here.unjudged))


def _judged(
    case: Case,
    found: Linearised,
    rows: Rows,
    split: Split,
    columns: Columns,
    scanned: Mapping[str, tuple[Scan, ...]],
    unjudged: dict[str, str],
) -> Traced:
    """Ranking and proofs of columns; those of scanned effects are taken at the first of their values."""
    settings = {name: tried[0][0] for name, tried in scanned.items()}
    dormant = dict(columns.dormant)
    for effect in case.dormant():
        if effect.name in scanned:
            dormant[effect.name] = (tuple(p.name for p in effect.amplitudes), scanned[effect.name][0][1])
    others = tuple(block for tried in scanned.values() for _, block in tried[1:])
    columns = replace(columns, dormant=dormant, also_tried=others)
    ranking = _probable(ranked(columns), case)
    strongest = [s.effect for s in ranking.scores if s.z > ranking.threshold and not s.vetoed][:PROVED_AT_MOST]
    beyond, unpredicted = unseen_columns_of(case, strongest, settings)
    unjudged |= {name: why for b in beyond for name, why in b.failed.items()}
    proofs = {}
    for name in strongest:
        names, block = columns.dormant[name]
        own = room_of(case.parameters, names)
        inside = proof(columns.model, block, own, rows, split)
        inside = replace(inside, moves=columns.moves(block, own))
        proofs[name] = proof_unseen(columns.model, name, block, beyond, own) or inside
    result = Traced(case, found, rows, split, ranking, proofs, columns, settings, beyond)
    return replace(result, unjudged=unjudged, unpredicted=unpredicted, scanned=scanned)


def at_end(case: Case, fit: FitResult | None, split: Split, before: Traced) -> Traced:
    """The trace of the fitted parameters alone at the end of a refit, on the held-out data `split`: all that judges the refit.

    The columns of dormant effects are most of a trace, of a body nine tenths, and are asked for where a round begins. Residual and columns
    are those of the fit, so that nothing is run but what is held out elsewhere. NumericsError where that fails.
    """
    parameters, rows = case.parameters, before.rows
    residual, fitted = at_its_end(case, fit) or case.model.linearised(parameters, parameters.free)
    model = replace(before.problem.model, residual=residual, columns=fitted, bounds=room_of(parameters, parameters.free, case.reach))
    columns = Columns(model, {}, before.problem.groups, before.problem.numerical, channel=rows.channel)
    found, none = Linearised(residual, fitted, {}, {}), Ranking((), before.ranking.threshold, ())
    beyond, unpredicted = unseen_columns_of(case, (), {})
    return Traced(case, found, rows, split, none, {}, columns, {}, beyond, unpredicted=unpredicted, whole=False)


def material_of(case: Case, answered: bool = False) -> dict[int, float]:
    """Places among the fitted parameters of those of the material, with their values, on a body to which no effect was added, or where
    those that were have `answered`: they leave no more than the floor. None elsewhere. Beside an effect of another form than the cause a
    second one would move them as well; and coupons have so few data that what moves them far is worth it anyway."""
    parameters, declared = case.parameters, {prior.name for prior in case.model.priors}
    if case.cheap or (not answered and any(is_of_effect(n) and n not in case.pose for n in parameters.free)):
        return {}
    return {k: parameters[n] for k, n in enumerate(parameters.free) if not is_of_effect(n) and n not in declared}


def _probable(ranking: Ranking, case: Case) -> Ranking:
    """The ranking with a veto for every effect whose estimate lies farther off what was declared than an error of that explains, by two
    standard errors of the estimate and more."""
    scores = []
    for s in ranking.scores:
        near = {n: v - float(np.clip(v - param(n).neutral, -2.0 * s.sigma[n], 2.0 * s.sigma[n])) for n, v in s.estimate.items()}
        why = improbable(case.model.priors, case.parameters.replace(**near), case.parameters)
        scores.append(replace(s, vetoed=s.vetoed or why))
    gone = {s.effect for s in scores if s.vetoed}
    scores = [replace(s, family=(s.effect, *(other for other in s.family[1:] if other not in gone))) for s in scores]
    return replace(ranking, scores=tuple(sorted(scores, key=lambda s: (bool(s.vetoed), -s.z))))


def room_of(parameters: Parameters, names: Sequence[str], bounds: Bounds = physical) -> Room:
    """How far the named parameters may go to their bounds."""
    x = np.array([parameters[name] for name in names])
    ends = np.array([bounds(name) for name in names]).reshape(len(names), 2)
    return ends[:, 0] - x, ends[:, 1] - x


def _scanned(case: Case, columns: Columns, found: Linearised) -> tuple[dict[str, tuple[Scan, ...]], dict[str, str]]:
    """Columns of effects at the values of their exponents, the best first, and the effects that could not be run with any of them.

    Only what is known from a heat run or costs next to nothing is scanned.
    """
    scanned, unjudged = {}, dict(found.failed)
    for effect in case.dormant():
        if len(scans(effect, case)) > 1 and (case.cheap or effect.name in found.scanned):
            try:
                scanned[effect.name] = best_scans(case, columns, effect, found.scanned.get(effect.name, ()))
                unjudged.pop(effect.name, None)
            except NumericsError as error:
                unjudged[effect.name] = str(error)
    return scanned, unjudged


def best_scans(
    case: Case, columns: Columns, effect: Effect, known: Sequence[np.ndarray] = (), advance: Callable[[], None] = lambda: None
) -> tuple[Scan, ...]:
    """The values of an effect's exponents and its columns there, the largest predicted drop first; `known`: the columns at all of them,
    `advance` is told of each.

    Values with which the model cannot run are left out. NumericsError where that is all of them.
    """
    tried, found = [], []
    error: NumericsError | None = None
    for k, values in enumerate(scans(effect, case)):
        try:
            if known:
                block = known[k]
            elif k == 0 and effect.name in columns.dormant:
                block = columns.dormant[effect.name][1]
            else:
                block = columns_of(case, effect, values)
        except NumericsError as failed:
            error = failed
            continue
        finally:
            advance()
        tried.append((values, block))
        found.append(drop_of(columns, tuple(p.name for p in effect.amplitudes), block))
    if not tried:
        assert error is not None
        raise error
    return tuple(tried[k] for k in sorted(range(len(tried)), key=lambda k: -found[k]))
