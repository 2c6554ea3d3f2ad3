"""What the form of added laws leaves unknown, told where parameters beside an unlisted heat are.

The budget of the joint fit tells it at that optimum. What nobody lists had driven exponents there to where a law of the rate is a straight
line, which says next to nothing below the slowest rate, and holds them at values that the data do not ask for. Beside one history, or one
spot, both doubts are told anew: exponents that are held as in `held_exponents`, and the overstress at the slowest rate as in
`slowest_rate`, with the coefficients of the term as free as they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermofit.diagnose.case import Case
from thermofit.diagnose.held_exponents import columns_of, held_at
from thermofit.diagnose.slowest_rate import laws_of_rate, told_at
from thermofit.diagnose.unlisted_field import MissingField
from thermofit.diagnose.unlisted_second import with_term
from thermofit.diagnose.widened import known_to
from thermofit.fit.budget import moves
from thermofit.fit.linear_model import LinearModel


def moves_of_form(known: LinearModel, term: MissingField, case: Case, accepted: Sequence[str]) -> tuple[np.ndarray, tuple[str, ...]]:
    """How far (p, k) things of unit variance in the form of accepted effects move the fitted parameters of a case beside a term with its
    lambda, and in words what of it is not told; `known`: the linear model of these parameters where they are. NumericsError where a run
    fails."""
    names, whole = case.parameters.free, with_term(known, term)
    found, untold = [np.zeros((len(names), 0))], list[str]()

    def moved(columns: np.ndarray, but: Sequence[str] = ()) -> np.ndarray:
        stay = np.concatenate([np.isin(names, but), np.zeros(whole.columns.shape[1] - len(names), dtype=bool)])
        return moves(whole, _longer(columns, whole), stay)[: len(names)]

    if held := held_at(case, accepted):
        columns = columns_of(held)
        known_so_far = known_to(whole, _longer(columns, whole), np.ones(columns.shape[1]))
        found.append(moved(columns @ np.linalg.cholesky(known_so_far)))
    for law in laws_of_rate(case, accepted):
        told = told_at(case, law)
        if isinstance(told, str):
            untold.append(told)
        else:
            found.append(moved(told.column, [p.name for p in law.exponents]))
    return np.concatenate(found, axis=1), tuple(untold)


def _longer(columns: np.ndarray, model: LinearModel) -> np.ndarray:
    """Columns (n, k) of the data for a model that has rows behind them, which know nothing of these."""
    return np.pad(columns, ((0, len(model.residual) - len(columns)), (0, 0)))
