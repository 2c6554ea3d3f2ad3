"""A pose at the end of what its landmarks can reach is fitted beyond it and judged as any effect; within it, it is no cause."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refits import refitting
from seen_field import BASE, case_of
from virtual_pulls import study

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import pose as module
from thermofit.diagnose.backward import Means
from thermofit.diagnose.case import Case, Sharper
from thermofit.diagnose.drift import drifts
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.pose import beyond_landmarks, released
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.rejudge import ends_of_fit
from thermofit.diagnose.trace import traced
from thermofit.experiment.row_states import VARIABLES
from thermofit.experiment.trust import physical
from thermofit.fit.result import FitResult

RATE = "ir_drift.rate"
"""Stands for the pose of a camera."""


def bounded(true: float, within: float, fails: str = "") -> tuple[Case, FitResult, Any]:
    """A case whose pose is fitted within bounds, its optimum, and a fit that keeps the pose at the bound where it ends there; labels that
    hold `fails` cannot be run."""
    case = case_of(5, **{RATE: true})
    plain = refitting(case.model)

    def refit(start: Parameters, label: str) -> tuple[Parameters, FitResult]:
        if fails and fails in label:
            raise NumericsError("no run")
        end, fit = plain(start, label)
        if "beyond its landmarks" in label or RATE not in start.free or abs(end[RATE]) <= within:
            return end, fit
        held = end.replace(**{RATE: within})
        for _ in range(3):
            held = plain(held.with_free(("kappa", "c0")), label)[0]
        held = held.with_free(start.free)
        residual, columns = case.model.linearised(held, held.free)
        return held, replace(fit, x=held.vector(), residual=residual, jacobian=columns, f=float(residual @ residual))

    case = replace(
        case,
        parameters=BASE.with_free(("kappa", "c0", RATE)),
        bounds=lambda name: (-within, within) if name == RATE else physical(name),
        pose=frozenset((RATE,)),
    )
    end, fit = refit(case.parameters, "joint")
    return replace(case, parameters=end), fit, refit


def looped(true: float, within: float, most: int = 3, fails: str = "") -> Closed:
    case, fit, refit = bounded(true, within, fails)
    return close_loop(case, fit, refit, most, None)


def test_within_its_bounds_it_is_no_cause() -> None:
    found = looped(0.02, 0.05)
    assert found.accepted == () and found.last.case.parameters[RATE] == pytest.approx(0.02, rel=0.05)


def test_beyond_them_it_is_named_with_all_of_it() -> None:
    found = looped(0.02, 0.005)
    assert found.accepted == ("ir_drift",) and found.last.case.parameters[RATE] == pytest.approx(0.02, rel=0.05)
    assert beyond_landmarks(found.first.case) == ("ir_drift",) and beyond_landmarks(found.last.case) == ()
    before, after = (float(np.mean(t.columns.residual**2)) for t in (found.first, found.last))
    assert before > 2.0 and after == pytest.approx(1.0, abs=0.1), "the error before is that at the bound"


def test_it_takes_the_place_of_an_effect() -> None:
    found = looped(0.02, 0.005, most=0)
    assert found.accepted == ()


def test_what_is_not_better_beyond_is_refused() -> None:
    """At the bound by chance: the data do not ask for more."""
    case, fit, refit = bounded(0.0, 1e-9)
    here = traced(case, None, fit=fit)
    assert beyond_landmarks(replace(case, parameters=case.parameters.replace(**{RATE: 1e-9}))) == ("ir_drift",)
    at_end = replace(here, case=replace(case, parameters=case.parameters.replace(**{RATE: 1e-9})))
    found = released(at_end, fit, Means(refit, None, "auto"))
    assert found is not None and found.accepted is None and found.trial.refused


def test_a_run_that_fails_beyond_is_said() -> None:
    found = looped(0.02, 0.005, fails="beyond its landmarks")
    assert found.accepted == () and "no run" in found.unjudged["ir_drift"]


def test_all_fits_go_beyond_from_then_on() -> None:
    """Those of the problem that knows the error of the force as well."""
    name = "ir_registration.shift_y"
    narrow = study().model_copy(update={"parameters": {}})
    fitting: Any = JointFit(narrow, SimpleNamespace(), SimpleNamespace(cheap=False), SimpleNamespace())  # type: ignore[arg-type]
    sharp: Any = Sharper(SimpleNamespace(), None, fitting, fitting, np.zeros(1), fitting.heated)  # type: ignore[arg-type]

    wide = module.wider(fitting, BASE, (name,))
    assert isinstance(wide, JointFit) and wide.study.bounds(name) == physical(name)
    case = Case(SimpleNamespace(), BASE, (), (), frozenset(), sharper=lambda _: sharp, heated=fitting.heated, pose=frozenset((name,)))  # type: ignore[arg-type]
    found = module.widened(replace(case, bounds=lambda _: (-0.2, 0.2)), (name,), wide)
    assert found.bounds(name) == physical(name) and found.bounds("kappa") == (-0.2, 0.2) and not found.pose
    assert found.heated == wide.heated and found.sharper is not None
    told = found.sharper(BASE)
    assert told is not None
    for one in (told.refit, told.nearby):
        assert isinstance(one, JointFit) and one.study.bounds(name) == physical(name)


def test_it_is_no_part_of_the_answer() -> None:
    """At its bound it speaks against no effect, and no drift of it is told."""
    case, fit, _ = bounded(0.02, 0.005)
    here = traced(case, None, fit=fit)
    stuck = replace(fit, sigma=None)
    assert RATE not in ends_of_fit(here, stuck) and RATE in ends_of_fit(replace(here, case=replace(case, pose=frozenset())), stuck)
    rows = here.rows
    states = {v: np.full(len(rows.time), np.nan) for v in VARIABLES} | {"time": rows.time}
    asked = drifts(here, states).asked
    assert drifts(replace(here, case=replace(case, pose=frozenset())), states).asked == asked + 1
