"""Parameters of the base model where an unlisted heat has not driven them off, with their standard errors.

A joint fit spreads a heat that nobody lists over all parameters: they end many of their standard errors away, with small ones. Beside an
unlisted heat two things are told instead. Parameters that temperatures do not feel are those of the displacements alone. The others are
those beside a broad source (`protected`); how little is known of that source is part of their standard errors. Beside the offset of a
camera they are those fitted with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.diagnose.rescored import on_its_motion, protected_at, shown_rows
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.unlisted import Unlisted
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.fit.linear_model import projection


@dataclass(frozen=True)
class BesideSource:
    """Values of the fitted parameters beside an unlisted heat or offset and their standard errors by the noise, each in its unit; in words
    why there are none, where a run failed."""

    value: Mapping[str, float]
    sigma: Mapping[str, float]
    failed: str = ""


def beside_source(here: Traced, missing: Unlisted | None) -> BesideSource | None:
    """The parameters beside an unlisted heat of a body, or offset of its camera; None where none is unlisted, or the model knows of no
    broad source."""
    case = here.case
    if missing is None or missing.field is None or missing.field.basis.kind not in ("heat", "offset"):
        return None
    if missing.field.basis.kind == "offset":
        free, spread = missing.parameters.free, missing.field.uncertainty.tolist()
        return BesideSource({n: missing.parameters[n] for n in free}, dict(zip(free, spread, strict=True)))
    if case.heated is None or case.model.segments is not None:
        return None
    try:
        moved = on_its_motion(here)
        fit = case.heated(moved.case.parameters)
        found = None if fit is None else protected_at(moved, fit)
        if found is None:
            return None
        free = moved.case.parameters.free
        _, columns = case.model.linearised(moved.case.parameters, free)
    except NumericsError as error:
        return BesideSource({}, {}, f"parameters beside the unlisted heat are not known ({error})")
    thermal = acting_on_temperatures(found.parameters.free)
    value = {n: found.parameters[n] for n in thermal}
    sigma = dict(zip(thermal, found.source.uncertainty.tolist(), strict=True))
    others = [n for n in free if n not in acting_on_temperatures(free)]
    own = ~shown_rows(here)
    if others and own.any():
        block = columns[own][:, [free.index(n) for n in others]]
        white = np.sqrt(np.sum(projection(block).root() ** 2, axis=1))
        value |= {n: moved.case.parameters[n] for n in others}
        sigma |= dict(zip(others, white.tolist(), strict=True))
    return BesideSource({n: value[n] for n in free if n in value}, {n: sigma[n] for n in free if n in sigma})
