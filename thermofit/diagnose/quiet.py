"""Histories that nothing tells, and what they may make of the fitted parameters all the same.

A jaw, a film or a camera may change by so little that held-out data gain less by it than an answer has to, and still move a conductivity by
many of its standard errors: all of it that parameters could take, they have. So at the end every kind k of history that a channel may have,
and the term of any place, is weighed beside all that is fitted, and none of them too (`unlisted_second.mixed`). Values stay what they are;
standard errors hold

    E = sum_k p_k (C_k - C + d_k d_k^T)

more. A kind of which the data show nothing has its lambda at the largest, moves nothing, and adds nothing. Each channel is asked by itself.
Where parameters are told beside something unlisted, the other channels are asked beside it (`beside_source`).
"""

from __future__ import annotations

from dataclasses import replace

from thermofit.core.errors import NumericsError
from thermofit.diagnose.case import Case
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.unlisted import IN_TIME, LIKELIER, Unlisted, broad_basis, has_parameters, histories
from thermofit.diagnose.unlisted_second import Second, mixed
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
    here, fit = closed.last, closed.fit
    if here.case.cheap or fit.covariance is None or fit.jacobian is None or here.case.model.missing is None:
        return closed
    if has_parameters(missing):
        return closed
    wider, likely, known = fit, list[str](), LinearModel(fit.residual, fit.jacobian)
    with progress("quiet histories", None) as advance:
        for structure in structures(here.case, here.rows, here.problem.model.left, None):
            advance(1, structure.blocks.channel)
            try:
                found = quiet(known, here.case, structure)
            except NumericsError as error:
                words = f"what histories that nothing tells may make of the parameters is not known: a run failed ({error})"
                return replace(closed, remarks=(*closed.remarks, words))
            if found is not None:
                wider = widened(wider, found.covariance)
                likely += [KINDS[kind].words for kind, part in found.likelihood.items() if part > LIKELIER]
    most = most_widened(fit, wider)
    if not most:
        return closed
    closed = with_wider(closed, QUIET, wider)
    if not likely:
        return closed
    words = f"intervals hold what a quiet {' and a quiet '.join(likely)} would make of the parameters, most of all of {most}"
    return replace(closed, remarks=(*closed.remarks, f"{words}: too small to be told, and not excluded"))


def quiet(whole: LinearModel, case: Case, structure: Structure) -> Second | None:
    """How likely every kind of history is that a channel may have, and the term of any place, beside all that a linear model of a case
    fits, and E; None where there is no kind of which anything would show. NumericsError where a run fails."""
    kinds, broad = histories(case, structure, most=IN_TIME), broad_basis(case, structure)
    if broad is not None:
        kinds[broad.kind] = broad
    return mixed(whole, kinds, RARE) if kinds else None
