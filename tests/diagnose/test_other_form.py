"""A stand-in is fitted in the stead of what was added: a fit tells the two, or intervals hold both."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refits import fitted, refitting
from seen_field import case_of

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import other_form, stand_ins
from thermofit.diagnose.backward import Means
from thermofit.diagnose.beside_source import FORM
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.other_form import with_other_forms
from thermofit.diagnose.stand_ins import by_another
from thermofit.fit.budget import NOISE, OTHER_FORM, Budget, root_of

ON = {"ir_drift.rate": 0.02}


@pytest.fixture(scope="module")
def drift() -> Closed:
    """A loop that has added a drift of many standard errors."""
    case, fit = fitted(case_of(5, **ON))
    found = close_loop(case, fit, refitting(case.model), 3, None)
    assert found.accepted == ("ir_drift",) and not found.last.case.cheap
    return found


def with_(drift: Closed, *others: str) -> Closed:
    spread = drift.fit.covariance
    assert spread is not None
    budget = Budget(drift.fit.names, {NOISE: root_of(spread.matrix)}, np.zeros(len(drift.fit.names), dtype=bool))
    return replace(drift, stand_ins={"ir_drift": others}, budget=budget)


def test_intervals_hold_where_the_stand_in_has_the_parameters(drift: Closed, monkeypatch: pytest.MonkeyPatch) -> None:
    """By as much as the two ends are apart, all parameters together; what was added has no value in the other one."""
    here = drift.last
    name = next(n for n in drift.fit.names if not n.startswith("ir_drift"))
    k = drift.fit.names.index(name)
    moved = here.case.parameters.replace(**{name: here.case.parameters[name] * 1.3, "ir_drift.rate": 0.0})
    there = SimpleNamespace(case=SimpleNamespace(parameters=moved))
    monkeypatch.setattr(other_form, "by_another", lambda *_: (there, drift.fit))
    before = with_(drift, "ir_gain", "ir_emissivity")
    found = with_other_forms(before, "auto")
    added = found.fit.sigma**2 - before.fit.sigma**2  # type: ignore[operator]
    assert added[k] == pytest.approx((0.3 * here.case.parameters[name]) ** 2)
    assert added[drift.fit.names.index("ir_drift.rate")] == pytest.approx(0.0, abs=1e-15)
    assert found.budget is not None and found.budget.of(OTHER_FORM)[k] == pytest.approx(0.3 * abs(here.case.parameters[name]))
    assert OTHER_FORM in FORM, "parameters beside an unlisted heat know of it as well"
    assert found.stand_ins == {"ir_drift": ("ir_gain", "ir_emissivity")}
    assert found.remarks[-1].startswith("intervals hold what ir_gain in the stead of ir_drift would make of the parameters, most of all ")


def test_a_stand_in_that_a_fit_tells_is_none(drift: Closed, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next one is asked then, two at most; one whose fit fails stays, and a remark says so."""
    asked: list[str] = []

    def another(here: Any, name: str, other: str, means: Any) -> Any:
        asked.append(other)
        if other == "lamp":
            raise NumericsError("no equilibrium")

    monkeypatch.setattr(other_form, "by_another", another)
    found = with_other_forms(with_(drift, "ir_gain", "ir_emissivity", "ir_lag"), "auto")
    assert asked == ["ir_gain", "ir_emissivity"] and found.stand_ins == {"ir_drift": ("ir_lag",)}
    assert found.fit is drift.fit and found.remarks == drift.remarks
    failed = with_other_forms(with_(drift, "lamp", "ir_gain"), "auto")
    assert failed.stand_ins == {"ir_drift": ("lamp", "ir_gain")} and failed.fit is drift.fit
    assert failed.remarks[-1].endswith("is not known: its fit failed (no equilibrium)")
    asked.clear()
    for nothing in (with_(drift), replace(drift, stand_ins=None)):
        assert with_other_forms(nothing, "auto") is nothing
    assert not asked


def test_it_begins_in_the_stead_of_what_was_added(drift: Closed, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the amplitude that one step asks for, with what was added at neutral and held; its own exponents are free."""
    begun: list[tuple[Parameters, str, bool]] = []

    def refit(start: Parameters, label: str, exponents: bool = False) -> Any:
        begun.append((start, label, exponents))
        return drift.refit(start, label)

    here = drift.last
    means: Any = Means(refit, None, "auto")
    other = next(n for n in here.problem.dormant if n in ("ir_gain", "ir_emissivity"))
    (amplitude,) = here.problem.dormant[other][0]
    told = by_another(here, "ir_drift", other, means)
    ((start, label, _),) = begun
    assert start["ir_drift.rate"] == 0.0 and "ir_drift.rate" not in start.free and amplitude in start.free
    assert start[amplitude] != here.case.parameters[amplitude] and label.startswith(f"{other} in the stead of ir_drift")
    assert told is None, "a drift of many standard errors is no gain"
    monkeypatch.setattr(stand_ins, "compared", lambda *_: SimpleNamespace(convinces=False))
    found = by_another(here, "ir_drift", other, means)
    assert found is not None and found[0].case.parameters[amplitude] != start[amplitude]


def test_parameters_that_temperatures_do_not_show_step_with_it(drift: Closed, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a yield stress takes over from the other form has to go with it; what temperatures show is fitted on the known motion first."""
    here, begun = drift.last, list[Parameters]()
    other = next(n for n in here.problem.dormant if n in ("ir_gain", "ir_emissivity"))
    others = tuple(n for n in here.case.parameters.free if n != "ir_drift.rate")

    def refit(start: Parameters, label: str, exponents: bool = False) -> Any:
        begun.append(start)
        return drift.refit(start, label)

    means: Any = Means(refit, None, "auto")
    for warm, moves in ((others, False), ((), True)):
        monkeypatch.setattr(stand_ins, "acting_on_temperatures", lambda _, warm=warm: warm)
        by_another(here, "ir_drift", other, means)
        assert any(begun[-1][n] != here.case.parameters[n] for n in others) is moves
