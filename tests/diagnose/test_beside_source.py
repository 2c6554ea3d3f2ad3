"""Parameters beside an unlisted heat: within their standard errors of the truth, where a plain fit is many of its own off."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from test_protected import THERMAL, Made, found_of, problem
from virtual_pulls import TRUTH

from thermofit.core.errors import NumericsError
from thermofit.diagnose.beside_source import beside_source
from thermofit.diagnose.trace import traced
from thermofit.diagnose.unlisted import unlisted
from thermofit.experiment.known_motion import acting_on_temperatures

__all__ = ["problem"]
SPOTS = [
    {},
    {"spot_of_this_test.power": 0.05},
    {"spot_of_this_test.power": -0.05},
    {"spot_of_this_test.power": 1e-9, "spot_of_this_test.pulse": 0.1},
    {"spot_of_this_test.power": 1e-9, "spot_of_this_test.pulse": -0.1},
]


@pytest.mark.parametrize("planted", SPOTS)
def test_they_come_back_within_three_standard_errors(problem: Made, planted: dict[str, float]) -> None:
    """A source that is not in the catalogue, conductivity, capacity, heat of plastic work and both films."""
    found = found_of(problem(**planted))
    names = acting_on_temperatures(found.parameters.free)
    z = np.array([(found.parameters[n] - TRUTH[n]) / s for n, s in zip(names, found.source.uncertainty, strict=True)])
    assert set(names) == set(THERMAL) and np.abs(z).max() < 3.0, dict(zip(names, z, strict=True))
    assert np.mean(z**2) > 0.05, "and are not told too wide"


def test_what_is_told_beside_an_unlisted_heat(problem: Made) -> None:
    """Those that temperatures do not feel by the displacements alone, the others beside the broad source; a run that fails is said."""
    case, fit, *_ = made = problem(**{"spot_of_this_test.power": 0.05})
    optimum = fit.minimised(case.parameters.replace(**fit.first), "plain")
    here = traced(replace(case, parameters=optimum))
    missing = unlisted(here, None, ())
    assert missing is not None and beside_source(here, None) is None
    told, expected = beside_source(here, missing), found_of(made)
    assert told is not None and dict(told.value) == pytest.approx({n: expected.parameters[n] for n in THERMAL})
    assert all(abs(told.value[n] - TRUTH[n]) < 3.0 * told.sigma[n] for n in THERMAL)
    with_modulus = replace(
        here, case=replace(here.case, parameters=optimum.with_free(("E", *THERMAL)), moved=lambda p: p.replace(E=TRUTH["E"]))
    )
    more = beside_source(with_modulus, missing)
    assert more is not None and more.value["E"] == TRUTH["E"] and 0.0 < more.sigma["E"] < 0.05 * TRUTH["E"]

    def fails(_: Any) -> Any:
        raise NumericsError("no run there")

    failed = beside_source(replace(here, case=replace(here.case, moved=fails)), missing)
    assert failed is not None and "no run there" in failed.failed and not failed.value
    other = replace(missing, field=replace(cast(Any, missing.field), basis=replace(cast(Any, missing.field).basis, kind="displacement")))
    assert beside_source(here, other) is None
