"""An effect within the error of a calibration is needed, and no cause: it is fitted, told, and not named."""

from __future__ import annotations

from dataclasses import replace

import pytest
from refits import fitted, refitting
from seen_field import case_of

from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.experiment.model import Prior
from thermofit.report.findings import causes_of

DRIFT, RATE = "ir_drift.rate", 0.02
CASES = ((RATE, False, False), (RATE / 4.0, False, False), (RATE / 8.0, False, True), (RATE, True, True))
"""Standard error of the drift, whether an error of the reading alone explains another value, and whether the drift is then a cause."""


def with_prior(case: Case, sigma: float, firm: bool = False) -> Case:
    """The case whose drift has a standard error from a calibration."""
    return replace(case, model=replace(case.model, priors=(Prior(DRIFT, 0.0, sigma, firm=firm),)))


def closed(sigma: float, most: int = 3, firm: bool = False, **more: float) -> Closed:
    case, fit = fitted(with_prior(case_of(5, **{DRIFT: RATE, **more}), sigma, firm))
    return close_loop(case, fit, refitting(case.model), most, None)


@pytest.mark.parametrize(
    ("sigma", "firm", "named"), [(RATE, False, False), (RATE / 4.0, False, False), (RATE / 8.0, False, True), (RATE, True, True)]
)
def test_within_the_error_of_its_calibration_it_is_no_cause(sigma: float, firm: bool, named: bool) -> None:
    found = closed(sigma, firm=firm)
    assert found.accepted == ("ir_drift",)
    assert found.causes == (("ir_drift",) if named else ()) and found.corrections == (() if named else ("ir_drift",))
    assert set(causes_of(found)) == set(found.causes)


def test_a_correction_takes_no_place_of_an_effect() -> None:
    """One effect is allowed: where the drift is within the error of its calibration another one is added besides."""
    other = {"ir_emissivity.slope": 0.4}
    assert len(closed(RATE / 8.0, 1, **other).accepted) == 1
    found = closed(RATE, 1, **other)
    assert set(found.accepted) == {"ir_drift", "ir_emissivity"} and found.causes == ("ir_emissivity",) and not found.open_ones
