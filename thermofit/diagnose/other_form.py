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
from thermofit.diagnose.backward import Means
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.loop import Closed, like_of
from thermofit.diagnose.stand_ins import TRIED, by_another, stand_ins
from thermofit.diagnose.widened import most_widened, widened
from thermofit.effects.catalogue import effect
from thermofit.fit.budget import OTHER_FORM


def with_stand_ins(closed: Closed) -> Closed:
    """The loop's result with the stand-ins of every accepted effect: of a body those that held-out data do not tell from it at the end."""
    here = closed.last
    if here.case.cheap or not here.whole:
        return closed
    return replace(closed, stand_ins={name: stand_ins(here, name, others) for name, others in like_of(closed).items()})


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
            there = moved[0].case.parameters
            apart = np.array([there[n] - closed.last.case.parameters[n] if n not in effect(name).names else 0.0 for n in fit.names])
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
