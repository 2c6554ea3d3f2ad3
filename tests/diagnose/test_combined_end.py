"""The end of the loop with combined standard errors: what is taken for exact widens them by what it would move, and a budget says so."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from refits import fitted, refitting
from seen_field import N_S, N_T, case_of

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.combined import with_combined, with_wider
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.widened import widened
from thermofit.fit.budget import EXPONENTS, NOISE
from thermofit.fit.linear_model import LinearModel

N = N_T * N_S


def closed(**more: Any) -> Closed:
    """A loop that has added the drift of a camera, with `more` known of its case."""
    case, fit = fitted(case_of(3, **{"ir_drift.rate": 1e-3}))
    found = close_loop(case, fit, refitting(case.model), 3, None)
    last = found.last.case
    spread = LinearModel(found.fit.residual, found.fit.jacobian).covariance(found.fit.names, found.fit.at_bound)  # type: ignore[arg-type]
    fit = replace(found.fit, covariance=spread, sigma=spread.sigma)
    return replace(found, fit=fit, last=replace(found.last, case=replace(last, **more)))


def test_what_may_be_left_of_the_mesh_widens_every_parameter_by_its_move() -> None:
    """A limit e of a uniform error makes e over the root of three: refitted with the data off by that, parameters move as told."""
    limit = 0.3 * np.sin(np.arange(N) / 7.0)
    before, found = closed(), with_combined(closed(doubts={"mesh": limit}))
    assert found.budget is not None and found.by_noise is not None and before.fit.sigma is not None and found.fit.sigma is not None
    fit = found.fit
    moved = -np.linalg.lstsq(fit.jacobian, limit / np.sqrt(3.0), rcond=None)[0]
    assert before.fit.covariance is not None
    np.testing.assert_allclose(found.fit.sigma**2, before.fit.covariance.sigma_unit**2 + moved**2, rtol=1e-9)
    np.testing.assert_allclose(found.by_noise, before.fit.sigma)
    np.testing.assert_allclose(found.budget.of("mesh"), np.abs(moved), rtol=1e-9)
    assert found.fit.covariance is not None
    np.testing.assert_allclose(np.diag(found.fit.covariance.matrix), found.fit.sigma**2)


def test_what_the_test_prescribes_widens_them_through_parameters_that_are_held() -> None:
    """A camera whose gain is known to 1 %, and held in the fit: one over the capacity."""

    def prescribed(parameters: Parameters) -> dict[str, dict[str, float]]:
        return {"gain": {"ir_gain.gain": 0.01}}

    case = closed().last.case
    found = with_combined(closed(prescribed=prescribed))
    column = case.model.linearised(case.parameters, ("ir_gain.gain",))[1][:, 0]
    moved = -np.linalg.lstsq(found.fit.jacobian, 0.01 * column, rcond=None)[0]
    assert found.budget is not None and np.abs(moved).max() > 0.0
    np.testing.assert_allclose(found.budget.of("gain"), np.abs(moved), rtol=1e-6, atol=1e-12)
    assert found.budget.of("gain")[1] == pytest.approx(0.01 * case.parameters["c0"], rel=0.05)


def test_a_run_that_fails_is_said_and_leaves_the_noise() -> None:
    def fails(*_: Any) -> Any:
        raise NumericsError("time step to t = 7 s failed")

    one = closed(prescribed=lambda _: {"gain": {"ir_gain.gain": 0.01}})
    model = replace(one.last.case.model, linearise=fails)
    one = replace(one, last=replace(one.last, case=replace(one.last.case, model=model)))
    found = with_combined(one)
    assert found.budget is None and found.fit is one.fit
    assert found.remarks[-1].startswith("the uncertainty holds the noise of the data alone") and "t = 7 s" in found.remarks[-1]


@pytest.mark.parametrize("lacking", ["converged", "covariance", "names"])
def test_a_fit_that_has_not_ended_there_has_none(lacking: str) -> None:
    one = closed(doubts={"mesh": np.ones(N)})
    gone = {"converged": {"converged": False}, "covariance": {"covariance": None}, "names": {"names": ("c0",)}}[lacking]
    one = replace(one, fit=replace(one.fit, **gone))
    assert with_combined(one) is one


def test_what_widens_an_interval_later_has_its_part_of_the_budget() -> None:
    found = with_combined(closed())
    assert found.budget is not None and found.fit.covariance is not None
    extra = np.outer(found.fit.sigma, found.fit.sigma)  # type: ignore[arg-type]
    wider = with_wider(with_wider(found, EXPONENTS, widened(found.fit, extra)), EXPONENTS, widened(widened(found.fit, extra), extra))
    assert wider.budget is not None and wider.fit.sigma is not None and found.fit.sigma is not None
    np.testing.assert_allclose(wider.budget.of(EXPONENTS), np.sqrt(2.0) * found.fit.sigma)
    np.testing.assert_allclose(wider.budget.sigma, wider.fit.sigma)
    np.testing.assert_allclose(wider.budget.of(NOISE), found.budget.of(NOISE))
    bare = with_wider(closed(), EXPONENTS, wider.fit)
    assert bare.budget is None and bare.fit is wider.fit
