"""Which other effects could stand in for one that was accepted: asked at the end, where nothing else is missing any more.

A family is what one angle tells, |cos| above a limit. But where an amplitude of a hundred standard errors gives way to another effect at
|cos| 0.9, forty of them are left: data that are good enough tell the two apart. So every effect of the family is put in the stead of the
accepted one, which goes back to neutral by a run, with all other parameters stepping beside it; it stays a stand-in where held-out data are
predicted as well. One step from so far off may reach what no fit does: where temperatures show both, the stand-in is refitted on the known
motion, and its end decides. Of coupons all of them were refitted already, and that has told.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import param
from thermofit.diagnose.backward import Means, held_out_of, neutral, without_effects
from thermofit.diagnose.held_out import SURE, compared
from thermofit.diagnose.refit import EXPONENTS, with_effect
from thermofit.diagnose.rescored import hidden, refitted
from thermofit.diagnose.score import ALIKE, likeness
from thermofit.diagnose.trace import Traced, room_of
from thermofit.effects.catalogue import effect
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult

TRIED = 2
"""Stand-ins of an effect that are fitted at most, the most alike first."""


def stand_ins(here: Traced, name: str, family: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Dormant effects, of the family or at |cos| above ALIKE from the accepted one, that in its stead predict held-out data as well."""
    rest = at_neutral(here, name)
    own = rest.sensitive(_amplitudes(here, name))
    blocks = {n: best_of(here, rest, n) for n in here.problem.dormant if n != name}
    near = {n: rest.sensitive(block) for n, block in blocks.items()}
    alike = likeness({name: own, **{n: s for n, s in near.items() if s.shape[1] > 0}}, (name,))
    asked = [n for n in blocks if n in family or alike.get((name, n), 0.0) > ALIKE]
    now, folds = held_out_of(here), len(here.split.held_out)
    found = []
    for other in asked:
        names = here.problem.dormant[other][0]
        instead = rest.with_columns(blocks[other], room_of(here.case.parameters, names)).predicted(here.split.folds)
        better = compared(instead, now, here.rows, folds, here.problem.model.noise, here.columns.residual)
        if better.gain <= SURE * better.sigma and not _told_by_refit(here, name, other):
            found.append((better.gain, other))
    return tuple(other for _, other in sorted(found))


def _told_by_refit(here: Traced, name: str, other: str) -> bool:
    """Whether a refit with the other effect in the stead of the accepted one, on the known motion, predicts held-out data worse. False
    where temperatures do not show both, or no start of it can be run: then nothing tells them."""
    both = (*effect(name).names, *effect(other).names)
    if here.case.heated is None or len(acting_on_temperatures(both)) < len(both):
        return False
    parameters = here.case.parameters
    there = neutral(parameters, [name])
    try:
        fit = here.case.heated(parameters)
        end = (
            None
            if fit is None
            else refitted(replace(here, case=replace(here.case, parameters=there)), (hidden(other),), fit, {}, freed=True)
        )
    except NumericsError:
        return False
    if end is None:
        return False
    now, folds = held_out_of(here), len(here.split.held_out)
    return compared(end.held_out, now, here.rows, folds, here.problem.model.noise, here.columns.residual).convinces


def by_another(here: Traced, name: str, other: str, means: Means, against: Traced | None = None) -> tuple[Traced, FitResult] | None:
    """Where a fit with the other effect in the stead of the accepted one ends; None where it predicts held-out data worse than what it is
    held `against` (None: than with the accepted one). NumericsError where a run fails."""
    parameters = here.case.parameters
    without = neutral(parameters, [name])
    rest, names = at_neutral(here, name), here.problem.dormant[other][0]
    room = room_of(parameters, without.free, here.case.reach)
    step = replace(rest, bounds=room).with_columns(best_of(here, rest, other), room_of(parameters, names)).step.d
    # What the yield stress takes over from the other form has to go with it, else the force is not carried.
    warm = acting_on_temperatures(without.free)
    moved = {n: parameters[n] + float(d) for n, d in zip(without.free, step[: -len(names)], strict=True) if n not in warm}
    estimate = {n: parameters[n] + float(d) for n, d in zip(names, step[-len(names) :], strict=True)}
    start = with_effect(without.replace(**moved), other, estimate | here.settings.get(other, {}))
    exponents = tuple(p.name for p in effect(other).exponents)
    label = f"{other} in the stead of {name}{EXPONENTS if exponents else ''}"
    end = means.refit(start.with_free((*start.free, *exponents)), label, exponents=bool(exponents))
    there = means.at_end(here, end)
    best = here if against is None else against
    ends, folds = (held_out_of(there), held_out_of(best)), len(here.split.held_out)
    told = compared(*ends, here.rows, folds, here.problem.model.noise, best.columns.residual)
    return None if told.convinces else (there, end[1])


def _amplitudes(here: Traced, name: str) -> np.ndarray:
    """Columns (n, k) of the amplitudes of an effect that is fitted."""
    free = here.case.parameters.free
    return here.columns.fitted[:, [free.index(p.name) for p in effect(name).amplitudes if p.name in free]]


def at_neutral(here: Traced, name: str) -> LinearModel:
    """The problem without the columns of an effect, at neutral by a run; to first order where that run fails."""
    rest = without_effects(here, [name])
    off: Mapping[str, float] = {n: param(n).neutral for n in effect(name).names}
    try:
        return replace(rest, residual=here.case.model.residual(here.case.parameters.replace(**off)))
    except NumericsError:
        return rest


def best_of(here: Traced, rest: LinearModel, name: str) -> np.ndarray:
    """Columns (n, k) of a dormant effect at the values of its exponents that do most in the stead of what went."""
    blocks = [block for _, block in here.scanned.get(name, ())] or [here.problem.dormant[name][1]]
    if len(blocks) == 1:
        return blocks[0]
    drops = [rest.score(s).drop if (s := rest.sensitive(block)).shape[1] > 0 else -1.0 for block in blocks]
    return blocks[int(np.argmax(drops))]
