"""When the motion of sections drives a specimen instead of its force, and what it does to the data."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_up import TRUTH, uniaxial_test

from thermofit.core.errors import NumericsError
from thermofit.experiment.drive import carried, last_growth, near_maximum, with_driven_force, with_force_channel
from thermofit.experiment.fields import Measured, Stretched
from thermofit.experiment.start import mean_strain
from thermofit.observe.end_motion import Gauge
from thermofit.study.stages import ElasticStage, PlasticStage, ThermalStage

LENGTH = 40.0


def pulled(last: float) -> Measured:
    """A uniaxial test up to Lambda = `last`, with the elongation of 40 mm and its error of 7 N of force."""
    data = uniaxial_test(last=last)
    e = LENGTH * mean_strain(data.displacement, 1)
    gauge = Gauge(np.array([[0.0, -20.0], [0.0, 20.0]]), np.array([-1.0, 1.0]))
    return replace(data, gauge=gauge, stretched=Stretched(data.displacement.time, e, np.full(len(e), 7.0)))


def growth(multiplier: float) -> float:
    """d ln F / d ln lambda = (dM/dLambda / r) / M - 1 of rigid plastic flow."""
    r = np.sqrt(TRUTH["F"] + TRUTH["H"])
    rest = (TRUTH["M_yinf"] - TRUTH["M_y0"]) * np.exp(-TRUTH["H_exp"] * multiplier)
    return float(TRUTH["H_exp"] * rest / (r * (TRUTH["M_yinf"] - rest)) - 1.0)


@pytest.mark.parametrize("last", [0.06, 0.14, 0.3])
def test_growth_of_the_force_is_considere(last: float) -> None:
    found = last_growth(pulled(last))
    assert found is not None and growth(last) < found < growth(0.88 * last)


def test_a_force_that_hardly_grows_or_falls_does_not_drive() -> None:
    assert near_maximum(pulled(0.06)) == ""
    assert "falls" in near_maximum(pulled(0.3))
    assert near_maximum(replace(pulled(0.3), stretched=None)) == ""


def test_the_error_of_the_elongation_is_one_of_the_force_and_counted_once() -> None:
    data = pulled(0.06)
    once = with_driven_force(data)
    assert once.force.sigma.ravel() == pytest.approx(np.full(len(data.force.time), np.hypot(4.0, 7.0)))
    assert np.array_equal(with_driven_force(once).force.sigma, once.force.sigma)


def test_the_force_joins_the_displacements_and_nothing_else() -> None:
    assert list(with_force_channel(PlasticStage()).channels) == ["du", "force"]
    assert list(with_force_channel(ElasticStage.model_validate({"channels": {"stress": {}, "du": {}}})).channels) == ["stress", "du"]
    assert list(with_force_channel(ThermalStage()).channels) == ["dtheta"]


def test_what_fails_is_tried_once_more_in_the_other_drive() -> None:
    other = SimpleNamespace(sections="the sections y = -20 and 20 mm", by_sections=None)
    first: Any = SimpleNamespace(by_sections=other)

    def attempt(experiment: Any) -> str:
        if experiment is first:
            raise NumericsError("time step to t = 3 s failed")
        return "done"

    driven, answer, said = carried(first, attempt)
    assert (driven, answer) == (other, "done")
    assert "the sections y = -20 and 20 mm" in said and "time step to t = 3 s failed" in said
    first.by_sections = None
    with pytest.raises(NumericsError, match="time step"):
        carried(first, attempt)
