"""Is what was accepted still needed? The backward check of the loop, and what trials of the loop are refitted, traced and predicted by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.held_out import Room, compared, held_out_residual
from thermofit.diagnose.proof_elsewhere import proof_of_need, proof_of_refit
from thermofit.diagnose.refit import EXPONENTS
from thermofit.diagnose.trace import Traced, room_of, traced
from thermofit.effects.catalogue import effect
from thermofit.fit.result import FitResult

Refit = Callable[[Parameters, str], tuple[Parameters, FitResult]]
"""Minimise the joint objective from given parameters (`free` names the fitted ones); the text names the fit."""
STANDS_IN = 0.2
"""Part of an effect's square that held exponents of the others must be able to make up for before a refit asks whether they do."""


@dataclass(frozen=True)
class Means:
    """How trials are refitted and traced: the refit, the error of discretisation in the residual, and what is held out."""

    refit: Refit
    numerical: np.ndarray | None
    how: str

    def traced(self, here: Traced, parameters: Parameters) -> Traced:
        """Trace at other parameters, on the same held-out data."""
        return traced(replace(here.case, parameters=parameters), self.numerical, self.how, here.split)


def held_out_of(here: Traced) -> np.ndarray:
    """Whitened residual (n,) of every row as predicted from the folds that do not hold it; nan in rows that are never held out."""
    return held_out_residual(here.columns.residual, here.columns.fitted, here.split, room(here))


def room(here: Traced) -> Room:
    """How far the free parameters may go to their physical bounds."""
    return room_of(here.case.parameters, here.case.parameters.free)


def _own(here: Traced, name: str) -> list[int]:
    """Places of an effect's Params among the free parameters."""
    return [k for k, n in enumerate(here.case.parameters.free) if n in effect(name).names]


def without_columns(here: Traced, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Residual and fitted columns if the effect of that name were back at neutral, to first order."""
    free, own = here.case.parameters.free, _own(here, name)
    amplitudes = [k for k in own if not param(free[k]).scan]
    back = np.array([param(free[k]).neutral - here.case.parameters[free[k]] for k in amplitudes])
    residual = here.columns.residual + here.columns.fitted[:, amplitudes] @ back
    return residual, np.delete(here.columns.fitted, own, axis=1)


def still_needed(here: Traced, name: str) -> bool:
    """Whether the held-out error rises when an accepted effect is taken away again."""
    residual, fitted = without_columns(here, name)
    own, (low, high) = _own(here, name), room(here)
    left = (np.delete(low, own), np.delete(high, own))
    ends, folds = (held_out_residual(residual, fitted, here.split, left), held_out_of(here)), len(here.split.held_out)
    found = compared(*ends, here.rows, folds, here.problem.noise, here.columns.residual)
    return (proof_of_need(here, name, (residual, fitted), left) or found).convinces


def _neutral(here: Traced, name: str) -> Parameters:
    neutral = {n: param(n).neutral for n in effect(name).names}
    return here.case.parameters.replace(**neutral).with_free(tuple(n for n in here.case.parameters.free if n not in neutral))


def without(here: Traced, name: str, means: Means) -> tuple[Traced, FitResult]:
    """The loop's state after an effect was dropped and everything else refitted."""
    parameters, fit = means.refit(_neutral(here, name), f"without {name}")
    return means.traced(here, parameters), fit


def made_up_for(here: Traced, name: str, others: Sequence[str], means: Means) -> tuple[Traced, FitResult] | None:
    """The loop's state without an effect whose part held exponents of other accepted ones take over; None where the effect is needed.

    Of an exponent that was held because freeing it gained nothing an effect accepted before may have made up the difference (a lamp that
    came on earlier, for heat at that time). Asked by a refit where the exponents' columns explain STANDS_IN of what the effect does.
    NumericsError where a run fails.
    """
    free = here.case.parameters.free
    exponents = tuple(p.name for other in others for p in effect(other).exponents if p.name not in free)
    if here.case.cheap or not exponents:  # of coupons every exponent is tried free already
        return None
    residual, fitted = without_columns(here, name)
    done = residual - here.columns.residual
    columns = here.case.model.linearised(here.case.parameters, exponents)[1]
    left, most = (beyond_columns(done, part) for part in (np.concatenate([fitted, columns], axis=1), fitted))
    if left > (1.0 - STANDS_IN) * most:
        return None
    start = _neutral(here, name)
    parameters, fit = means.refit(start.with_free((*start.free, *exponents)), f"without {name}{EXPONENTS}")
    there = means.traced(here, parameters)
    ends, folds = (held_out_of(there), held_out_of(here)), len(here.split.held_out)
    found = compared(*ends, here.rows, folds, here.problem.noise, here.columns.residual)
    return None if (proof_of_refit(there, here, name) or found).convinces else (there, fit)


def beyond_columns(change: np.ndarray, columns: np.ndarray) -> float:
    """Square of what columns (n, k) leave of a change (n,)."""
    size = np.linalg.norm(columns, axis=0)
    unit = columns[:, size > 0.0] / size[size > 0.0]
    rest = change - unit @ np.linalg.lstsq(unit, change, rcond=None)[0]
    return float(rest @ rest)
