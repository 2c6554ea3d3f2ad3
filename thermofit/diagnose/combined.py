"""Combined uncertainty of what the loop ends with: the noise of all channels, what the test prescribes, and what may be left of the errors
of mesh and steps, as the joint fit of the stages has it (`identify.combined`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.widened import with_covariance
from thermofit.experiment.prescribed import Moved
from thermofit.fit.budget import root_of
from thermofit.fit.result import FitResult
from thermofit.identify.combined import joint_budget, taken_for_exact
from thermofit.identify.solve import Solved


def with_combined(closed: Closed) -> Closed:
    """The loop's result with combined standard errors and their budget. Where a run for it fails, a remark says that they hold the noise
    alone; the same where the last fit has no covariance."""
    case, fit = closed.last.case, closed.fit
    if not fit.converged or fit.covariance is None or fit.jacobian is None or fit.names != case.parameters.free:
        return closed
    try:
        budget = joint_budget(Solved(case.parameters, case.model, fit, fit.covariance, (), ()), _prescribed(case), case.doubts)
    except NumericsError as error:
        words = f"the uncertainty holds the noise of the data alone: a run that tells the rest failed ({error})"
        return replace(closed, remarks=(*closed.remarks, words))
    return replace(closed, fit=with_covariance(fit, budget.covariance, budget.sigma), budget=budget, by_noise=fit.sigma)


def with_wider(closed: Closed, cause: str, fit: FitResult) -> Closed:
    """The loop's result with a fit whose covariance another cause has made larger, which its budget names."""
    before, after, budget = closed.fit.covariance, fit.covariance, closed.budget
    if budget is not None and before is not None and after is not None:
        own = (budget.parts[cause],) if cause in budget.parts else ()
        budget = replace(budget, parts={**budget.parts, cause: np.column_stack([*own, root_of(after.matrix - before.matrix)])})
    return replace(closed, fit=fit, budget=budget)


def errors_of(case: Case, columns: np.ndarray) -> np.ndarray:
    """What one standard error of each thing that a case takes for exact makes in its residual (n, m); `columns` (n, n_p): those of its free
    parameters. NumericsError where a run fails."""
    found = taken_for_exact(case.model, case.parameters, columns, _prescribed(case), case.doubts)
    return np.concatenate([np.zeros((len(columns), 0)), *found.values()], axis=1)


def _prescribed(case: Case) -> Mapping[str, Moved]:
    """By how much parameters move for one standard error of what the test of a case takes for exact, by cause."""
    return {} if case.prescribed is None else case.prescribed(case.parameters)
