"""Where a further effect only makes up for the form of an earlier one, another form of that stands for both."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from refits import fitted, refitting
from seen_field import case_of

from thermofit.core.errors import NumericsError
from thermofit.diagnose import earlier_form, loop, stand_ins
from thermofit.diagnose.backward import Means
from thermofit.diagnose.earlier_form import families_of, in_another_form
from thermofit.diagnose.loop import Closed, accepted_trials, close_loop
from thermofit.diagnose.trace import Traced, traced
from thermofit.fit.result import FitResult

BOTH = {"ir_drift.rate": 2e-3, "ir_emissivity.slope": 3.0}
OTHER_ALONE = {"ir_emissivity.slope": 3.0}
FAMILY = {"ir_drift": ("ir_drift", "ir_emissivity")}


def begun(**planted: float) -> tuple[Traced, FitResult, Traced, Means]:
    """A trace with a drift, its fit, and the end of a refit with an emissivity besides, of data that hold what is planted."""
    case = case_of(5, **planted)
    means = Means(refitting(case.model), None, "auto")
    one, fit = fitted(replace(case, parameters=case.parameters.with_free((*case.parameters.free, "ir_drift.rate"))))
    here = traced(one, None, "auto", fit=fit)
    both = means.refit(one.parameters.with_free((*one.parameters.free, "ir_emissivity.slope")), "both")
    return here, fit, means.at_end(here, both), means


def test_another_form_that_leaves_nothing_is_taken() -> None:
    here, fit, further, means = begun(**OTHER_ALONE)
    found, remarks = in_another_form(here, fit, FAMILY, further, means)
    assert found is not None and remarks == ()
    assert (found.name, found.other) == ("ir_drift", "ir_emissivity")
    parameters = found.here.case.parameters
    assert parameters["ir_drift.rate"] == 0.0 and "ir_drift.rate" not in parameters.free
    assert parameters["ir_emissivity.slope"] == pytest.approx(3.0, rel=0.05)
    assert found.trial.effects == ("ir_emissivity",) and found.trial.refused == "" and found.trial.gain > 0.0
    assert found.trial.estimate["ir_emissivity.slope"] == parameters["ir_emissivity.slope"] and found.fit.f < fit.f
    assert found.trial.achieved_drop == pytest.approx(fit.f - found.fit.f) and found.trial.score.family == ("ir_emissivity", "ir_drift")


def test_where_both_are_there_both_stay() -> None:
    """Another form alone is then better than the earlier one, and worse than both."""
    here, fit, further, means = begun(**BOTH)
    assert stand_ins.by_another(here, "ir_drift", "ir_emissivity", means) is not None
    assert in_another_form(here, fit, FAMILY, further, means) == (None, ())


def test_what_was_taken_back_and_what_cannot_be_do_not_stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    here, fit, further, means = begun(**OTHER_ALONE)
    assert in_another_form(here, fit, FAMILY, further, means, ("ir_emissivity",)) == (None, ())
    scores = tuple(replace(s, vetoed="below nothing" if s.effect == "ir_emissivity" else s.vetoed) for s in here.ranking.scores)
    vetoed = replace(here, ranking=replace(here.ranking, scores=scores))
    assert in_another_form(vetoed, fit, FAMILY, further, means) == (None, ())
    cheap = replace(here, case=replace(here.case, cheap=True))
    assert in_another_form(cheap, fit, FAMILY, further, means) == (None, ()), "of coupons all were refitted"

    def fails(*_: Any) -> Any:
        raise NumericsError("no equilibrium")

    monkeypatch.setattr(earlier_form, "by_another", fails)
    none, (words,) = in_another_form(here, fit, FAMILY, further, means)
    assert none is None
    assert words == "whether ir_emissivity in the stead of ir_drift leaves less is not known: its fit failed (no equilibrium)"


def closed(asked: list[Any], monkeypatch: pytest.MonkeyPatch) -> Closed:
    """A loop over data that hold two effects, and what it has asked."""

    def instead(here: Traced, fit: FitResult, families: Any, *rest: Any) -> Any:
        asked.append((families, rest[-1]))
        assert len(asked) < 9, "forms come and go"
        found, remarks = in_another_form(here, fit, families, *rest)
        return found, (*remarks, "asked")

    monkeypatch.setattr(loop, "in_another_form", instead)
    case, fit = fitted(case_of(5, **{"ir_drift.rate": 1.5e-3, "ir_emissivity.slope": 2.0}))
    return close_loop(case, fit, refitting(case.model), 3, None)


def test_the_loop_asks_with_the_families_of_what_was_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    found = closed(asked, monkeypatch)
    assert set(found.accepted) == {"ir_drift", "ir_emissivity"} and found.remarks[:2] == ("asked", "asked")
    first = families_of(accepted_trials(found.rounds[:1]))
    assert [families for families, _ in asked] == [{}, first] and set(first) == set(found.rounds[0].accepted)


def test_the_loop_takes_the_other_form_and_not_the_further_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """Were the second effect only another form of the first one, it would stand for it, and the first one not be asked again."""
    monkeypatch.setattr(earlier_form, "stand_ins", lambda here, name, family: tuple(n for n in ("ir_drift", "ir_emissivity") if n != name))
    monkeypatch.setattr(stand_ins, "compared", lambda *_: SimpleNamespace(convinces=False))
    asked: list[Any] = []
    found = closed(asked, monkeypatch)
    first, second = (r.accepted[0] for r in found.rounds[:2])
    assert {first, second} == {"ir_drift", "ir_emissivity"}
    assert first in found.dropped and found.accepted == (second,)
    (refused,) = (t for t in found.rounds[1].trials if t.refused.startswith("needless"))
    assert refused.refused == f"needless where {second} stands for {first}" and refused.effects == (second,)
    assert found.rounds[1].trials[-1].refused == "" and found.rounds[1].after is not None
    assert f"{second} stands for {first}: beside it {second} would be needless" in found.remarks
    assert first not in {s.effect for r in found.rounds[2:] for s in r.traced.ranking.scores}, "it does not come and go"
