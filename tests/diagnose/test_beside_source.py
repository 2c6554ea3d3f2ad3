"""Parameters beside an unlisted heat: within their standard errors of the truth, where a plain fit is many of its own off."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from test_protected import THERMAL, Made, found_of, problem
from virtual_pulls import TRUTH

from thermofit.core.errors import NumericsError
from thermofit.diagnose import beside_source as module
from thermofit.diagnose.beside_source import BesideSource, beside_source
from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.rescored import shown_rows
from thermofit.diagnose.trace import traced
from thermofit.diagnose.unlisted import structured, unlisted
from thermofit.diagnose.unlisted_field import Basis, field_of, moves_beside
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.missing import Grid
from thermofit.fit.budget import Budget
from thermofit.fit.linear_model import LinearModel

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
    missing = unlisted(here, structured(here, None), ())
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
    grid = Grid(np.zeros(1), np.zeros(1, dtype=int), np.zeros(1), np.zeros(1))
    alike = replace(cast(Any, missing.field), basis=replace(cast(Any, missing.field).basis, kind="jaws", grid=grid))
    unsettled = beside_source(here, replace(missing, field=alike, settled=False))
    assert unsettled is not None and not unsettled.value and "have not settled" in unsettled.failed


def test_they_are_told_no_better_than_what_is_taken_for_exact_lets_them(problem: Made) -> None:
    """What may be left of the error of a mesh moves them beside the source, and a reading that is prescribed as well."""
    case, fit, *_ = made = problem(**{"spot_of_this_test.power": 0.05})
    optimum = fit.minimised(case.parameters.replace(**fit.first), "plain")
    here = traced(replace(case, parameters=optimum))
    missing = unlisted(here, structured(here, None), ())
    bare = beside_source(here, missing)
    rows = np.zeros(len(here.columns.residual))
    rows[shown_rows(here)] = 0.05 * fit.model.linearised(found_of(made).parameters, ("c0",))[1][:, 0]
    told = beside_source(replace(here, case=replace(here.case, doubts={"mesh": np.sqrt(3.0) * rows})), missing)
    assert bare is not None and told is not None and dict(told.value) == dict(bare.value)
    more = {n: np.sqrt(told.sigma[n] ** 2 - bare.sigma[n] ** 2) for n in told.sigma}
    assert more["c0"] == pytest.approx(0.05, rel=1e-3), "an error like 0.05 mJ/(mm^3 K) of the capacity"
    assert more["kappa"] < 1e-3 * bare.sigma["kappa"]

    by_beta = {"heat of plastic work": {"beta": 0.01}}
    again = beside_source(replace(here, case=replace(here.case, prescribed=lambda _: by_beta)), missing)
    assert again is not None and np.sqrt(again.sigma["beta"] ** 2 - bare.sigma["beta"] ** 2) > 3e-3


def test_they_are_known_no_better_than_the_form_of_what_was_added(problem: Made) -> None:
    """Exponents that are held and rates below the slowest widen these as those of the joint fit; noise and mesh are their own."""
    case, fit, *_ = problem(**{"spot_of_this_test.power": 0.05})
    here = traced(replace(case, parameters=fit.minimised(case.parameters.replace(**fit.first), "plain")))
    missing = unlisted(here, structured(here, None), ())
    bare = beside_source(here, missing)
    names = ("beta", "c0")
    parts = {
        "held exponents": np.array([[0.3], [0.0]]),
        "rates below the slowest": np.array([[0.0], [0.4]]),
        "mesh": np.array([[9.0], [9.0]]),
    }
    told = beside_source(here, missing, Budget(names, parts, np.zeros(2, dtype=bool)))
    assert bare is not None and told is not None and dict(told.value) == dict(bare.value)
    assert told.sigma["beta"] == pytest.approx(np.hypot(bare.sigma["beta"], 0.3))
    assert told.sigma["c0"] == pytest.approx(np.hypot(bare.sigma["c0"], 0.4)) and told.sigma["kappa"] == bare.sigma["kappa"]


def test_they_are_those_beside_one_spot_where_that_is_all(problem: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    """And where it is, is told with them; else why not is."""
    case, fit, *_ = problem(**{"spot_of_this_test.power": 0.05})
    here = traced(replace(case, parameters=fit.minimised(case.parameters.replace(**fit.first), "plain")))
    missing = unlisted(here, structured(here, None), ())
    assert missing is not None and missing.field is not None
    grid = Grid(np.zeros(1), np.zeros(1, dtype=int), np.zeros(1), np.array([6.0]), spread=4.0)
    spot = replace(missing, field=replace(missing.field, basis=replace(missing.field.basis, grid=grid)))
    beside = BesideSource({"kappa": 131.0}, {"kappa": 2.0})
    monkeypatch.setattr(module, "as_spot", lambda *_: (spot, ""))
    monkeypatch.setattr(module, "beside_one_place", lambda *_: beside)
    assert beside_source(here, missing) == replace(beside, spot=module.spot_of(spot.field))
    monkeypatch.setattr(module, "as_spot", lambda *_: pytest.fail("that spot is known"))
    assert beside_source(here, replace(missing, spot=spot)) == replace(beside, spot=module.spot_of(spot.field))
    monkeypatch.setattr(module, "as_spot", lambda *_: (None, "it leaves structure"))
    broad = beside_source(here, missing)
    assert broad is not None and broad.spot is None and broad.no_spot == "it leaves structure" and set(broad.value) == set(THERMAL)


@pytest.mark.parametrize("weight", [1e-3, 1.0])
def test_moves_beside_a_term_are_those_of_the_step_with_other_data(weight: float) -> None:
    """Normal equations of columns and hats with their roughness, solved for data with an error and without."""
    draw = np.random.default_rng(4)
    n, p, m = 60, 3, 5
    columns, hats, residual, error = draw.normal(size=(n, p)), draw.normal(size=(40, m)), draw.normal(size=n), draw.normal(size=(n, 2))
    grid = Grid(np.arange(float(m)), np.zeros(m, dtype=int), np.zeros(1), np.zeros(1))
    own = np.arange(10, 50)
    basis = Basis("heat", "mW/mm^3", grid, np.arange(m), own, hats, np.eye(m))
    everywhere = Rows(np.zeros(n, dtype=int), np.arange(float(n)), np.zeros((n, 2)), np.zeros(n, dtype=int))
    parts = np.arange(n) // 10
    split = Split(tuple(parts == k for k in range(6)), (np.zeros(n, dtype=bool),) * 6, "")
    known = LinearModel(residual, columns)
    one = field_of(known, basis, everywhere, split, weight)
    for k in range(2):
        other = field_of(LinearModel(residual + error[:, k], columns), basis, everywhere, split, weight)
        np.testing.assert_allclose(moves_beside(known, one, error)[:, k], other.step - one.step, rtol=1e-5)
