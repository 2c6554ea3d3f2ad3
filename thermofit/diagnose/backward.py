"""Is what was accepted still needed? The backward check of the loop, and what trials of the loop are refitted, traced and predicted by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Refit
from thermofit.diagnose.held_out import Proof, compared, far
from thermofit.diagnose.proof_other_tests import proof_of_need, proof_of_refit
from thermofit.diagnose.refit import EXPONENTS
from thermofit.diagnose.trace import Traced, at_end, material_of, traced
from thermofit.effects.catalogue import effect
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult

STANDS_IN = 0.2
"""Part of an effect's square that held exponents of the others could take, from which a refit asks whether they do."""


@dataclass(frozen=True)
class Means:
    """How trials are refitted and traced: the refit, the error of discretisation in the residual, and what is held out."""

    refit: Refit
    numerical: np.ndarray | None
    how: str

    def traced(self, here: Traced, fit: FitResult) -> Traced:
        """The whole trace of an end, on the same held-out data."""
        return traced(here.case, self.numerical, self.how, here.split, fit)

    def at_end(self, here: Traced, end: tuple[Parameters, FitResult]) -> Traced:
        """The end of a refit on the same held-out data, without the dormant effects."""
        return at_end(replace(here.case, parameters=end[0]), end[1], here.split, here)


def held_out_of(here: Traced) -> np.ndarray:
    """Whitened residual (n,) of every row as predicted from the folds that do not hold it; nan in rows that are never held out."""
    return here.problem.model.predicted(here.split.folds)


def without_effects(here: Traced, names: Sequence[str]) -> LinearModel:
    """The linearised problem if the effects were back at neutral, to first order, and without their columns."""
    free, parameters, model = here.case.parameters.free, here.case.parameters, here.problem.model
    every = {n for name in names for n in effect(name).names}
    amplitudes = [k for k, n in enumerate(free) if n in every and not param(n).scan]
    back = np.array([param(free[k]).neutral - parameters[free[k]] for k in amplitudes])
    rest = model.only([k for k, n in enumerate(free) if n not in every])
    return replace(rest, residual=model.residual + model.columns[:, amplitudes] @ back)


def still_needed(here: Traced, name: str) -> bool:
    """Whether the held-out error rises when an accepted effect is taken away again."""
    without_it = without_effects(here, [name])
    ends, folds = (without_it.predicted(here.split.folds), held_out_of(here)), len(here.split.held_out)
    found = compared(*ends, here.rows, folds, here.problem.model.noise, here.columns.residual)
    found = replace(found, moves=moved_by(here, name, without_it))
    return (proof_of_need(here, name, without_it) or found).convinces


def moved_by(here: Traced, name: str, without_it: LinearModel) -> bool:
    """Whether an accepted effect has moved a parameter of the material far; asked where nothing else was added, or where the effects
    together leave no more than the floor (`trace.material_of`)."""
    case, gone = here.case, effect(name).names
    rest = case.parameters.with_free(tuple(n for n in case.parameters.free if n not in gone))
    asked = material_of(replace(case, parameters=rest), here.answered)
    if not asked:
        return False
    own = [case.parameters.free.index(rest.free[k]) for k in asked]
    sigma = np.sqrt(np.sum(here.problem.model.root()[own] ** 2, axis=1))
    return far(without_it.free_step[list(asked)], np.array(list(asked.values())), sigma)


def neutral(parameters: Parameters, names: Sequence[str]) -> Parameters:
    """The parameters with effects back at neutral and nothing of them fitted."""
    back = {n: param(n).neutral for name in names for n in effect(name).names}
    return parameters.replace(**back).with_free(tuple(n for n in parameters.free if n not in back))


def without(here: Traced, name: str, means: Means) -> tuple[Traced, FitResult]:
    """The loop's state after an effect was dropped and everything else refitted."""
    end = means.refit(neutral(here.case.parameters, [name]), f"without {name}")
    return means.at_end(here, end), end[1]


def compensated(here: Traced, name: str, others: Sequence[str], means: Means) -> tuple[Traced, FitResult] | None:
    """The loop's state without an effect whose part held exponents of other accepted ones take over; None where the effect is needed.

    Of an exponent that was held because freeing it gained nothing an effect accepted before may have made up the difference (a lamp that
    came on earlier, for heat at that time). Asked by a refit where the exponents' columns explain STANDS_IN of what the effect does.
    NumericsError where a run fails.
    """
    free = here.case.parameters.free
    exponents = tuple(p.name for other in others for p in effect(other).exponents if p.name not in free)
    if here.case.cheap or not exponents:  # of coupons every exponent is tried free already
        return None
    rest = without_effects(here, [name])
    done = replace(rest, residual=rest.residual - here.columns.residual)
    left, most = (m.left for m in (done.with_columns(here.case.model.linearised(here.case.parameters, exponents)[1]), done))
    if left @ left > (1.0 - STANDS_IN) * (most @ most):
        return None
    start = neutral(here.case.parameters, [name])
    end = means.refit(start.with_free((*start.free, *exponents)), f"without {name}{EXPONENTS}", exponents=True)
    there = means.at_end(here, end)
    return None if proof_against(there, here, name).convinces else (there, end[1])


def proof_against(there: Traced, here: Traced, name: str) -> Proof:
    """Proof of an accepted effect by the end `there` of a refit without it: what one step says of that may be wrong."""
    ends, folds = (held_out_of(there), held_out_of(here)), len(here.split.held_out)
    inside = compared(*ends, here.rows, folds, here.problem.model.noise, here.columns.residual)
    return proof_of_refit(there, here, name) or inside
