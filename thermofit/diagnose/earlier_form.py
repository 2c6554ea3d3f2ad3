"""An effect that makes up for the form of an earlier one.

Of two laws that predict held-out data about as well the loop takes one, and what its form leaves may pass for a further effect: a lamp
beside a logarithmic law of the rate, where a power law leaves nothing. So where the loop accepts a further effect, what could stand in for
each earlier one is fitted in its stead, without the further effect. Where that predicts held-out data as well, it is taken, for it has one
effect less.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from thermofit.core.errors import NumericsError
from thermofit.diagnose.backward import Means, held_out_of
from thermofit.diagnose.held_out import compared
from thermofit.diagnose.score import Score
from thermofit.diagnose.stand_ins import TRIED, by_another, stand_ins
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.trial import Trial, ends_of
from thermofit.effects.catalogue import effect
from thermofit.fit.result import FitResult


@dataclass(frozen=True)
class OtherForm:
    """A stand-in that was fitted in the stead of an earlier effect and makes a further one needless: the names of both, its trial, and
    where its fit ends."""

    name: str
    other: str
    trial: Trial
    here: Traced
    fit: FitResult


def families_of(trials: Iterable[Trial]) -> dict[str, tuple[str, ...]]:
    """The family of every effect of the trials that were accepted, by its name."""
    return {s.effect: s.family for t in trials for s in t.scores}


def in_another_form(
    here: Traced, fit: FitResult, families: Mapping[str, Sequence[str]], further: Traced, means: Means, dropped: Sequence[str] = ()
) -> tuple[OtherForm | None, tuple[str, ...]]:
    """The first stand-in of an earlier effect that predicts held-out data as well as the model with that effect and a further one does
    (`further`); None where there is none, or of coupons, of which all were refitted. And remarks on fits that failed.

    `here`, `fit`: the model without the further effect. `families`: of the earlier effects. An effect that was `dropped` is not asked."""
    remarks: list[str] = []
    if not families or here.case.cheap:
        return None, ()
    scores = {s.effect: s for s in here.ranking.scores if not s.vetoed}
    for name, family in families.items():
        others = [n for n in stand_ins(here, name, tuple(family)) if n in scores and n not in dropped]
        for other in others[:TRIED]:
            try:
                end = by_another(here, name, other, means, further)
            except NumericsError as error:
                remarks.append(f"whether {other} in the stead of {name} leaves less is not known: its fit failed ({error})")
                continue
            if end is not None:
                there, after = end
                score = replace(scores[other], family=(other, name))
                return OtherForm(name, other, _trial(here, fit, score, there, after), there, after), tuple(remarks)
    return None, tuple(remarks)


def _trial(here: Traced, fit: FitResult, score: Score, there: Traced, after: FitResult) -> Trial:
    """The trial of an effect in the stead of another one, with its proof beside that one."""
    folds = len(here.split.held_out)
    proof = compared(held_out_of(here), held_out_of(there), here.rows, folds, here.problem.model.noise, there.columns.residual)
    names = tuple(p.name for p in effect(score.effect).amplitudes)
    sigma = {n: float(after.sigma[after.names.index(n)]) if after.sigma is not None else float("inf") for n in names}
    parameters = there.case.parameters
    ends = ends_of([score.effect], parameters, after)
    return Trial((score,), proof, {n: parameters[n] for n in names}, sigma, fit.f - after.f, "", ends=ends)
