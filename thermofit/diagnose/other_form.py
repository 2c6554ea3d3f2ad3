"""What an effect that the data do not tell from an added one would make of all other parameters, fitted in its stead.

The loop names one of the two, and the parameters beside it are those of its form: the yield stress of one law of the rate is not that of
another, nor is the heat. So the stand-in is fitted in the stead of the added effect, with everything else free, where held-out data tell
the two no better by one step. Where that end predicts held-out data worse, it was no stand-in. Else each parameter may be anywhere
between the two ends: their difference is a standard error more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.backward import Means, held_out_of, neutral
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.held_out import compared
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.refit import EXPONENTS, with_effect
from thermofit.diagnose.stand_ins import at_neutral, best_of
from thermofit.diagnose.trace import Traced, room_of
from thermofit.diagnose.widened import most_widened, widened
from thermofit.effects.catalogue import effect
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.fit.budget import OTHER_FORM

TRIED = 2
"""Stand-ins of an effect that are fitted at most, the most alike first."""


def with_other_forms(closed: Closed, how: str) -> Closed:
    """The loop's result with standard errors that know what a stand-in would make of the parameters, without the stand-ins that a fit tells
    from what was added, and a remark; the same where there is none. Where a fit fails, a remark says so."""
    fit = closed.fit
    if closed.last.case.cheap or fit.covariance is None or not any((closed.stand_ins or {}).values()):
        return closed
    means, wider = Means(closed.refit, closed.numerical, how), fit
    left: dict[str, tuple[str, ...]] = {}
    remarks, forms = list(closed.remarks), list[str]()
    for name, others in (closed.stand_ins or {}).items():
        told: list[str] = []
        for other in others[:TRIED]:
            try:
                moved = by_another(closed.last, name, other, means)
            except NumericsError as error:
                remarks.append(f"what {other} in the stead of {name} would make of the parameters is not known: its fit failed ({error})")
                break
            if moved is None:
                told.append(other)
                continue
            apart = np.array([moved[n] - closed.last.case.parameters[n] if n not in effect(name).names else 0.0 for n in fit.names])
            wider = widened(wider, np.outer(apart, apart))
            forms.append(f"{other} in the stead of {name}")
            break
        left[name] = tuple(n for n in others if n not in told)
    closed = replace(closed, stand_ins=left, remarks=tuple(remarks))
    most = most_widened(fit, wider)
    if not most:
        return closed
    words = f"intervals hold what {' and '.join(forms)} would make of the parameters, most of all {most}"
    return with_wider(replace(closed, remarks=(*closed.remarks, words)), OTHER_FORM, wider)


def by_another(here: Traced, name: str, other: str, means: Means) -> Parameters | None:
    """The parameters with the other effect fitted in the stead of the accepted one; None where held-out data are then predicted worse.
    NumericsError where a run fails."""
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
    ends, folds = (held_out_of(there), held_out_of(here)), len(here.split.held_out)
    told = compared(*ends, here.rows, folds, here.problem.model.noise, here.columns.residual)
    return None if told.convinces else end[0]
