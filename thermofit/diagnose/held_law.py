"""What a hardening law that is held beside a curve of any form adds to the uncertainty of everything else.

The law was fitted beside the curve (`curve_and_law`) and is held from then on: in a fit of all together it bends the way of every step.
Its numbers are known as anything that a fit holds is (`widened.known_to`), beside the columns of what is unlisted: that was fitted with
nothing beside, and may have drawn them. Before the data speak, each may be off by itself (uniform, JCGM 100, 4.3.7). The yield stress at
no plastic strain may be off by as much as the curve adds at most: what of it is of the law, no datum tells.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import param
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.curve_and_law import curve_at, held_law, of_first_yield
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.unlisted import Unlisted
from thermofit.diagnose.widened import known_to, most_widened, widened
from thermofit.effects.catalogue import effect
from thermofit.fit.budget import HELD_LAW, moves
from thermofit.fit.linear_model import LinearModel


def with_held_law(closed: Closed, missing: Unlisted | None = None) -> Closed:
    """The loop's result with standard errors that know of a hardening law which is held beside a curve of any form, and a remark on what
    the data leave of its numbers; the same where there is no curve. `missing`: what is unlisted. Where the run of its columns fails, a
    remark says so."""
    here, fit = closed.last, closed.fit
    at = here.case.parameters
    curve = next((e for e in map(effect, closed.accepted) if e.last and e.is_on(at)), None)
    names = () if curve is None else tuple(n for n in held_law(at) if n not in fit.names)
    if curve is None or not names or fit.covariance is None or fit.jacobian is None:
        return closed
    try:
        columns = here.case.model.linearised(at, names)[1]
    except NumericsError as error:
        words = f"{', '.join(names)} count as exact: the run of their derivatives failed ({error})"
        return replace(closed, remarks=(*closed.remarks, words))
    model = LinearModel(fit.residual, fit.jacobian, here.problem.model.noise)
    first = of_first_yield(at)
    begins = [k for k, n in enumerate(names) if n in first]
    hardens = [k for k, n in enumerate(names) if n not in first and at[n] != 0.0]
    spread = np.zeros((len(names), len(names)))
    # Of the sum at no plastic strain nobody knows what is of the law.
    spread[begins, begins] = float(np.abs(curve_at(at, curve, here.case.largest_strain)).max()) / np.sqrt(3.0)
    known = np.zeros((0, 0))
    if hardens:
        known = known_to(_beside(model, missing), columns[:, hardens], np.array([abs(at[names[k]]) for k in hardens]) / np.sqrt(3.0))
        spread[np.ix_(hardens, hardens)] = np.linalg.cholesky(known)
    gone = moves(model, columns @ spread, fit.at_bound)
    wider = widened(fit, gone @ gone.T)
    told = most_widened(fit, wider)
    closed = with_wider(closed, HELD_LAW, wider)
    if not told:
        return closed
    left = [
        f"{names[k]} = {at[names[k]]:.4g} +- {s:.2g} {param(names[k]).unit}" for k, s in zip(hardens, np.sqrt(np.diag(known)), strict=True)
    ]
    words = f"{', '.join((*(names[k] for k in begins), *left))}: held beside the curve; intervals hold what of both may be stored"
    return replace(closed, remarks=(*closed.remarks, f"{words}, most of all {told}"))


def _beside(model: LinearModel, missing: Unlisted | None) -> LinearModel:
    """The model with the columns of what is unlisted as well."""
    if missing is None or missing.field is None:
        return model
    basis = missing.field.basis
    block = np.zeros((len(model.residual), basis.columns.shape[1]))
    block[basis.rows] = basis.columns
    return model.with_columns(block)
