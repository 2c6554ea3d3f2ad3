"""The end of the loop: what it leaves, and which of the effects that it accepted only resembled an unlisted one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import param
from thermofit.diagnose.held_out import compared
from thermofit.diagnose.loop import Closed, Refit
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import Unlisted, unlisted
from thermofit.diagnose.unlisted_field import Field, field_of
from thermofit.effects.catalogue import effect

LEFT_BEHIND = 0.1
"""Part of an excess that an effect which is the cause does not leave behind."""


def ended(closed: Closed, refit: Refit, numerical: np.ndarray | None, how: str) -> tuple[Closed, Unlisted | None]:
    """The loop's result without effects that only resembled what is missing, and what is missing.

    An accepted effect is taken back where more than a tenth of the excess stays, a field of the missing term explains that, and held-out
    data no longer ask for the effect beside the field. A refit that fails or does not converge leaves it where it is.
    """
    found = unlisted(closed.last, numerical)
    resembles: list[str] = []
    while found is not None and found.field is not None:
        name = next((n for n in closed.accepted if n not in resembles and _resembles(closed, n, found, found.field, numerical)), None)
        if name is None:
            break
        resembles.append(name)
        taken = _taken_back(closed, name, refit, numerical, how)
        if taken is None:
            break
        closed = taken
        found = unlisted(closed.last, numerical, resembles)
    return closed, None if found is None else replace(found, resembles=tuple(resembles))


def _resembles(closed: Closed, name: str, found: Unlisted, field: Field, numerical: np.ndarray | None) -> bool:
    """True where the effect left too much behind, and is not needed beside the field."""
    blocks = found.structure.blocks
    if found.structure.excess <= LEFT_BEHIND * blocks.excess(closed.first.columns.residual):
        return False
    here = closed.last
    free = here.case.parameters.free
    own = [k for k, n in enumerate(free) if n in effect(name).names]
    amplitudes = [k for k in own if not param(free[k]).scan]
    back = np.array([param(free[k]).neutral - here.case.parameters[free[k]] for k in amplitudes])
    residual = here.columns.residual + here.columns.fitted[:, amplitudes] @ back
    alone = field_of((residual, np.delete(here.columns.fitted, own, axis=1)), field.basis, here.rows, here.split)
    gain = compared(alone.after, field.after, here.rows, len(here.split.held_out))
    return not gain.convinces


def _taken_back(closed: Closed, name: str, refit: Refit, numerical: np.ndarray | None, how: str) -> Closed | None:
    """The result with the effect at neutral and everything else refitted; None where that fails."""
    last: Traced = closed.last
    neutral = {n: param(n).neutral for n in effect(name).names}
    free = tuple(n for n in last.case.parameters.free if n not in neutral)
    try:
        parameters, fit = refit(last.case.parameters.replace(**neutral).with_free(free), f"without {name}")
    except NumericsError:
        return None
    if not fit.converged:
        return None
    here = traced(replace(last.case, parameters=parameters), numerical, how, last.split)
    accepted = tuple(n for n in closed.accepted if n != name)
    return replace(closed, last=here, fit=fit, accepted=accepted, dropped=(*closed.dropped, name))
