"""Histories that nothing tells, and what they may make of the fitted parameters all the same.

A jaw, a film or a camera may change by so little that held-out data gain less by it than an answer has to, and still move a conductivity by
many of its standard errors: all of it that parameters could take, they have. So at the end every kind k of history that a channel may have,
and the term of any place, is weighed beside all that is fitted, and none of them too (`unlisted_second.mixed`). Values stay what they are;
standard errors hold

    E = sum_k p_k (C_k - C + d_k d_k^T)

more. What may be left of the errors of mesh and steps is free beside them: it is no history. A kind of which the data show nothing has its
lambda at the largest, moves nothing, and adds nothing. Each channel is asked by itself. Where parameters are told beside something
unlisted, the other channels are asked beside it (`beside_source`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.diagnose.case import Case
from thermofit.diagnose.combined import errors_of, with_wider
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.unlisted import IN_TIME, LIKELIER, Unlisted, broad_basis, has_parameters, histories
from thermofit.diagnose.unlisted_second import Second, held_beside, mixed
from thermofit.diagnose.unlisted_structure import Structure, structures
from thermofit.diagnose.widened import most_widened, widened
from thermofit.experiment.missing import KINDS
from thermofit.fit.budget import QUIET
from thermofit.fit.linear_model import LinearModel
from thermofit.records.progress import progress

RARE = 0.05
"""How likely it is, before the data speak, that a channel has a history which nothing tells: as often as chance may name an effect."""


def with_quiet(closed: Closed, missing: Unlisted | None) -> Closed:
    """The loop's result with standard errors that know what histories which nothing tells may make of the parameters of a body, and a
    remark where one is likelier than not; the same where parameters are told beside something unlisted, or none is widened. Where a
    run for it fails, a remark says so."""
    here, fit, case = closed.last, closed.fit, closed.last.case
    if case.cheap or fit.covariance is None or fit.jacobian is None or case.model.missing is None or has_parameters(missing):
        return closed
    there = replace(case, parameters=case.parameters.with_free(fit.names))
    try:
        errors = errors_of(there, fit.jacobian)
        channels = structures(case, here.rows, here.problem.model.left, None)
        found = quiet_histories(LinearModel(fit.residual, fit.jacobian), errors, there, channels)
    except NumericsError as error:
        words = f"what histories that nothing tells may make of the parameters is not known: a run failed ({error})"
        return replace(closed, remarks=(*closed.remarks, words))
    wider, likely = fit, list[str]()
    for one in found:
        wider = widened(wider, one.covariance)
        likely += [KINDS[kind].words for kind, part in one.likelihood.items() if part > LIKELIER]
    most = most_widened(fit, wider)
    if not most:
        return closed
    closed = with_wider(closed, QUIET, wider)
    if not likely:
        return closed
    words = f"intervals hold what a quiet {' and a quiet '.join(likely)} would make of the parameters, most of all of {most}"
    return replace(closed, remarks=(*closed.remarks, f"{words}: too small to be told, and not excluded"))


def quiet_histories(known: LinearModel, errors: np.ndarray, case: Case, channels: Sequence[Structure]) -> list[Second]:
    """The quiet histories of channels that have any (`quiet`). NumericsError where a run fails."""
    found = list[Second]()
    with progress("quiet histories", len(channels)) as advance:
        for one in channels:
            second = quiet(known, errors, case, one)
            found += [] if second is None else [second]
            advance(1, one.blocks.channel)
    return found


def quiet(known: LinearModel, errors: np.ndarray, case: Case, structure: Structure) -> Second | None:
    """How likely every kind of history is that a channel may have, and the term of any place, and E (p, p) of the fitted parameters of a
    case; None where there is no kind of which anything would show. NumericsError where a run fails.

    `known`: the linear model of the parameters, with what else is fitted behind them. `errors` (n, m): what may be left of the errors of
    mesh and steps, and what else counts as exact, as one standard error each. They are free beside: what they could make is no history."""
    kinds, broad = histories(case, structure, most=IN_TIME), broad_basis(case, structure)
    if broad is not None:
        kinds[broad.kind] = broad
    if not kinds:
        return None
    p, m = len(case.parameters.free), errors.shape[1]
    longer = np.pad(errors, ((0, len(known.residual) - len(errors)), (0, 0)))  # rows that hold a term know nothing of them
    found = mixed(held_beside(known, longer, np.eye(m)), kinds, RARE)
    return replace(found, covariance=found.covariance[:p, :p])
