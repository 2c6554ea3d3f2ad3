"""The form of an added heat of plastic flow is one of many: what counts as one, how large it is, and what intervals hold of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.heat_of_flow import goes_with_flow, heat_along, of_any_length, windows_of, with_form_of_heat
from thermofit.diagnose.loop import Closed
from thermofit.effects.catalogue import effect
from thermofit.fit.budget import FORM_OF_HEAT, Budget
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult

LARGEST = 0.2
HEAT = {"latent_heat.heat": 40.0, "latent_heat.centre": 0.1, "latent_heat.width": 0.05}
NAMES = ("beta", "c0")
RNG = np.random.default_rng(3)
COLUMNS = RNG.normal(size=(200, 2))
WINDOWS = RNG.normal(size=(200, 20))


def case(scored: Any = None, **values: float) -> Any:
    parameters = Parameters.of({"beta": 0.9, "c0": 3.6, **values}, NAMES)
    known = (effect("lamp"), effect("latent_heat"))
    return SimpleNamespace(parameters=parameters, largest_strain=LARGEST, known=known, scored=scored, spans=())


def closed(here: Any, accepted: tuple[str, ...] = ("latent_heat",)) -> Closed:
    residual = np.zeros(200)
    model = LinearModel(residual, COLUMNS)
    spread = model.covariance(NAMES, np.zeros(2, dtype=bool))
    made: Any = SimpleNamespace(
        names=NAMES, residual=residual, jacobian=COLUMNS, covariance=spread, sigma=spread.sigma, at_bound=np.zeros(2, bool)
    )
    fit = FitResult(**{f: getattr(made, f, None) for f in FitResult.__dataclass_fields__})
    last: Any = SimpleNamespace(case=here, problem=SimpleNamespace(model=model))
    budget = Budget(NAMES, {}, np.zeros(2, dtype=bool))
    return Closed((), last, last, fit, accepted, (), None, None, budget=budget)  # type: ignore[arg-type]


def seen(asked: list[Any], size: float = 0.05) -> Any:
    def scored(_: Any, names: tuple[str, ...], directions: Any) -> Any:
        asked.append((names, directions))
        return None, None, size * WINDOWS

    return scored


@pytest.mark.parametrize(("name", "expected"), [("latent_heat", True), ("stored_energy", True), ("local_source", False), ("lamp", False)])
def test_what_makes_heat_of_flow(name: str, expected: bool) -> None:
    one = effect(name)
    on = {one.amplitude.name: one.amplitude.probe or 1.0}
    assert goes_with_flow(one, case(**on)) is expected


def test_its_heat_per_plastic_strain() -> None:
    along = heat_along(effect("latent_heat"), case(**HEAT))
    assert along.max() == pytest.approx(40.0, rel=1e-3) and along[0] < 1e-3
    share = heat_along(effect("stored_energy"), case(**{"stored_energy.slope": -2.0}))
    # M_y0 = 130 MPa, and 272 MPa at 0.2 by the default law: 0.9 of that, times -2 Lambda.
    assert share[0] == 0.0 and share[-1] == pytest.approx(-2.0 * 0.2 * 0.9 * 272.27, rel=1e-3)


def test_windows_lie_side_by_side_up_to_the_largest_strain() -> None:
    found = windows_of(case(**HEAT))
    assert len(found) == 20 and {name for name, _ in found} == {"latent_heat.heat"}
    assert [v["latent_heat.centre"] for _, v in found] == pytest.approx(LARGEST * (np.arange(20) + 0.5) / 20)
    assert {v["latent_heat.width"] for _, v in found} == {LARGEST / 20}
    known = SimpleNamespace(**{**vars(case()), "known": (effect("lamp"),)})
    assert windows_of(known) == ()  # type: ignore[arg-type]


def test_intervals_hold_half_of_it_as_far_as_the_data_let() -> None:
    """Against the whole normal matrix with a prior for the windows and for stretches of them, each a term of its own."""
    asked: list[Any] = []
    before = closed(case(seen(asked), **HEAT))
    after = with_form_of_heat(before)
    assert asked == [((), windows_of(case(**HEAT)))]
    u = 0.5 * 40.0 / np.sqrt(3.0)
    stretches = [0.05 * WINDOWS.reshape(200, -1, n).sum(axis=2) for n in (1, 2, 4, 5, 10, 20)]
    every = np.column_stack([COLUMNS, *stretches])
    prior = [6.0 * u**-2] * (20 + 10 + 5 + 4 + 2 + 1)
    exact = np.linalg.inv(every.T @ every + np.diag([0.0, 0.0, *prior]))[:2, :2]
    assert after.fit.covariance is not None and after.fit.covariance.matrix_unit == pytest.approx(exact, rel=1e-3)
    assert after.budget is not None and set(after.budget.parts) == {FORM_OF_HEAT}
    assert "the form of latent_heat over plastic strain is one of many; intervals hold half of its heat, most of all" in after.remarks[-1]


def test_a_heat_that_is_off_all_along_is_as_likely_as_one_in_a_window() -> None:
    """Variance one at every strain; of the mean over all of them 0.35 (by hand: a sixth of 1/20 + 1/10 + 1/5 + 1/4 + 1/2 + 1), where
    windows on their own would leave a twentieth."""
    spread = of_any_length(20)
    covariance = spread @ spread.T
    assert np.diag(covariance) == pytest.approx(np.ones(20))
    assert covariance.mean() == pytest.approx(0.35)


def test_nothing_is_asked_where_no_heat_of_flow_was_added() -> None:
    asked: list[Any] = []
    one = closed(case(seen(asked), **{"lamp.absorbed": 0.01}), ("lamp",))
    off = closed(case(seen(asked)))
    open_end = closed(case(seen(asked), **HEAT))
    open_end = replace(open_end, fit=replace(open_end.fit, covariance=None))
    assert all(with_form_of_heat(c) is c for c in (one, off, open_end)) and not asked


def test_a_model_without_heat_runs_says_that_the_form_counts_as_exact() -> None:
    for here in (case(None, **HEAT), SimpleNamespace(**{**vars(case(seen([]), **HEAT)), "known": ()})):
        found = with_form_of_heat(closed(here))
        assert found.remarks == (
            "the form of latent_heat over plastic strain counts as exact: this model does not tell what a heat in a window of plastic "
            "strain would change",
        )


def test_a_run_that_fails_is_said() -> None:
    def scored(*_: Any) -> Any:
        raise NumericsError("no")

    found = with_form_of_heat(closed(case(scored, **HEAT)))
    assert found.remarks == (
        "the form of latent_heat over plastic strain counts as exact: the run of what another would change failed (no)",
    )
