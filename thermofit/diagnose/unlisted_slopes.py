"""Sensitivities of the fitted parameters beside a missing heat: what it adds runs through the same heat equation.

    r(p + d) + B(p + d) (q + e) = r + B q + (J + d(B q)/dp) d + B e + ...

The answers B to unit heats hold conductivity, capacity and films. Heat that comes from jaws which warm up and cool down tells the
conductivity by how far it goes. J alone does not see that. Its steps may not come down, nor end where the squares are least, and its
standard errors are those of another problem.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.unlisted_field import Basis, MissingField
from thermofit.diagnose.unlisted_middle import about
from thermofit.diagnose.unlisted_steps import best_of_its_form
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.fit.linear_model import LinearModel


def beside_term(known: LinearModel, case: Case, parameters: Parameters, term: MissingField, hat: Basis | None = None) -> LinearModel:
    """The linear model of a case's fitted parameters where they are, with what they change of a term's answers.

    `hat`: the hats where the parameters are; with them the coefficients are those that go best with these parameters, held as the term's
    are, else they are the term's own. Unchanged on coupons and for a term that does not run through the heat equation. NumericsError where
    the run of these parameters fails."""
    missing, names = case.model.missing, acting_on_temperatures(parameters.free)
    if missing is None:
        return known
    basis = term.basis
    amount = term.q[: len(basis.chosen)] if hat is None else best_of_its_form(term, known.residual, hat)[0][: len(basis.chosen)]
    moved = missing.slopes(basis.kind, parameters, about(term), basis.chosen, amount, names)
    if not moved:
        return known
    columns, ends = known.columns.copy(), np.cumsum([c.n for c in case.model.comparisons])
    at = [parameters.free.index(name) for name in names]
    for k, part in case.model.columns(moved).items():
        columns[ends[k] - len(part) : ends[k], at] += part
    return replace(known, columns=columns)
