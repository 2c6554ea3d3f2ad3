"""What was accepted is judged again: each reason to doubt it, and what takes it back, one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from coupon_sets import looped, pulled_record, study_of

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose import backward
from thermofit.diagnose import rejudge as module
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.rejudge import Rejudged, ends_of_fit, exponents_again, rejudged, suspicion
from thermofit.effects.catalogue import effect

GOOD = Proof(2.0, 1.0, {}, 0.5, 0.01, 5)
BAD = replace(GOOD, gain=0.01)
ON = {"second_hardening.Q": 30.0, "backstress_first.C": 5000.0}
MEANS: Any = None


def at(values: Mapping[str, float], sigma: float = 1e-3, accepted: tuple[str, ...] = ("second_hardening", "backstress_first")) -> Any:
    """A trace and its fit with E and the amplitudes of accepted effects free; `sigma`: their relative standard error."""
    amplitudes = tuple(effect(n).amplitude.name for n in accepted)
    parameters = Parameters.of({"E": 200e3, **ON, **values}, ("E", *amplitudes))
    fit = SimpleNamespace(names=parameters.free, sigma=np.abs(parameters.vector()) * sigma + 1e-9, at_bound=[False] * 3)
    bounds = {"E": (150e3, 250e3)}
    case = SimpleNamespace(parameters=parameters, bounds=lambda n: bounds.get(n, (param(n).lower, param(n).upper)), pose=frozenset())
    here = SimpleNamespace(
        case=case,
        rows=None,
        split=SimpleNamespace(held_out=()),
        problem=SimpleNamespace(model=SimpleNamespace(noise=None)),
        columns=SimpleNamespace(residual=None),
    )
    return here, fit


def judged(
    monkeypatch: pytest.MonkeyPatch,
    values: Mapping[str, float],
    proof: Proof = BAD,
    *,
    then: Mapping[str, float] | None = None,
    before: Mapping[str, str] | None = None,
    elsewhere: Proof | None = None,
    fails: bool = False,
) -> tuple[list[str], Rejudged]:
    """Effects without which it was fitted, and what is left of two that end at these values; without one of them they end at `then`."""
    asked = []

    def without(here: Any, name: str, _: Any) -> Any:
        asked.append(name)
        if fails:
            raise NumericsError("no equilibrium")
        left = tuple(
            n for n in ("second_hardening", "backstress_first") if effect(n).amplitude.name in here.case.parameters.free and n != name
        )
        return at(then or {}, accepted=left)

    monkeypatch.setattr(module, "without", without)
    for name, told in (("held_out_of", None), ("compared", proof), ("proof_of_refit", elsewhere)):
        monkeypatch.setattr(backward, name, lambda *_, told=told: told)
    return asked, rejudged(*at(values), ("second_hardening", "backstress_first"), before or {}, MEANS)


def test_what_has_a_value_of_its_own_is_not_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, found = judged(monkeypatch, {})
    assert asked == [] and found.dropped == () and found.remarks == ()


def test_an_earlier_effect_that_ends_at_its_bound_is_taken_back_where_it_is_not_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, found = judged(monkeypatch, {"second_hardening.Q": -998.0})
    assert asked == ["second_hardening"] and found.dropped == ("second_hardening",)
    assert found.remarks[0].startswith("second_hardening is taken back: second_hardening.Q ends at its bound: -998 MPa")
    assert found.here.case.parameters.free == ("E", "backstress_first.C")
    asked, found = judged(monkeypatch, {"second_hardening.Q": -998.0}, GOOD)
    assert asked == ["second_hardening"] and found.dropped == () and found.remarks == (), "needed: it stays, and the answer says so"
    assert judged(monkeypatch, {"second_hardening.Q": -998.0}, GOOD, elsewhere=BAD)[1].dropped == ("second_hardening",), "a test decides"


def test_an_effect_that_has_become_nothing_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    here, fit = at({})
    fit.sigma = np.array([1.0, 14.0, 1.0])
    assert suspicion(here, fit, "second_hardening", {}) == ""
    fit.sigma = np.array([1.0, 16.0, 1.0])
    assert "second_hardening.Q = 30 +- 16 is not away from 0 any more" in suspicion(here, fit, "second_hardening", {})
    assert suspicion(here, fit, "backstress_first", {}) == ""
    asked, found = judged(monkeypatch, {"backstress_first.C": 1e-10})
    assert asked == ["backstress_first"] and found.dropped == ("backstress_first",)


def test_what_drives_the_base_model_to_a_bound_is_asked_for_the_latest_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """It goes where E comes off its bound without it; what was at its bound before is no effect's fault."""
    asked, found = judged(monkeypatch, {"E": 249.9e3})
    assert asked == ["backstress_first"] and found.dropped == ("backstress_first",) and "E ends at its bound" in found.remarks[0]
    asked, found = judged(monkeypatch, {"E": 249.9e3}, then={"E": 249.9e3})
    assert asked == ["backstress_first", "second_hardening"] and found.dropped == (), "nothing is won without them"
    assert judged(monkeypatch, {"E": 249.9e3}, GOOD)[1].dropped == ()
    assert judged(monkeypatch, {"E": 249.9e3}, before={"E": "at its bound"})[0] == []


def test_a_refit_that_fails_takes_nothing_back(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, found = judged(monkeypatch, {"second_hardening.Q": -998.0}, fails=True)
    assert asked == ["second_hardening"] and found.dropped == () and "the fit without it failed (no equilibrium)" in found.remarks[0]


def fitted_again(
    monkeypatch: pytest.MonkeyPatch,
    gains: Mapping[tuple[str, ...], float],
    *,
    cheap: bool = True,
    settles: bool = True,
    leaves: str = "",
    elsewhere: Proof | None = None,
) -> tuple[list[tuple[str, ...]], Rejudged]:
    """Exponents that were freed together, in turn, and what is left; `gains`: of the refits by the exponents that are free in them."""
    asked: list[tuple[str, ...]] = []
    here, fit = at({})
    here.case.cheap = cheap

    def refit(start: Any, names: tuple[str, ...], label: str, _: Any) -> Any:
        asked.append(names)
        there = start[0].replace(**dict.fromkeys(names, 77.0)).with_free((*start[0].free, *names))
        return (there, SimpleNamespace(converged=settles, names=there.free)), "fitted"

    def at_end(_: Any, end: tuple[Parameters, Any]) -> Any:
        there, _ = at({})
        there.case.parameters = end[0]
        return there

    def compare(_: Any, end: Any, *__: Any) -> Proof:
        return replace(GOOD, gain=gains.get(tuple(n for n in end if n not in here.case.parameters.free), 0.0))

    monkeypatch.setattr(module, "freed_refit", refit)
    monkeypatch.setattr(module, "held_out_of", lambda t: t.case.parameters.free)
    monkeypatch.setattr(module, "compared", compare)
    monkeypatch.setattr(module, "proof_of_refit", lambda *_: elsewhere)
    monkeypatch.setattr(module, "ends_of_fit", lambda t, _: {"E": "at its bound"} if leaves in t.case.parameters.free else {})
    means: Any = SimpleNamespace(refit=None, at_end=at_end)
    return asked, exponents_again(here, fit, ("second_hardening", "backstress_first"), means)


B, GAMMA = ("second_hardening.b",), ("backstress_first.gamma",)


def test_exponents_of_earlier_effects_are_asked_again_beside_later_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Together and one by one; the end that predicts best is taken, with a remark, and none that does not convince."""
    asked, found = fitted_again(monkeypatch, {B: 0.2, GAMMA: 0.4, B + GAMMA: 0.3})
    assert asked == [B + GAMMA, B, GAMMA]
    assert found.here.case.parameters.free[-1:] == GAMMA and found.here.case.parameters["backstress_first.gamma"] == 77.0
    assert found.remarks == ("backstress_first.gamma = 77: fitted beside the later effects, by which held-out error falls by 40 %",)
    best_first = fitted_again(monkeypatch, {B: 0.4, GAMMA: 0.2, B + GAMMA: 0.3})[1]
    assert best_first.here.case.parameters.free[-1:] == B, "the best, not the last"
    asked, found = fitted_again(monkeypatch, {B: 0.01, GAMMA: 0.015})
    assert "backstress_first.gamma" not in found.here.case.parameters.free and found.remarks == ()
    assert fitted_again(monkeypatch, {GAMMA: 0.4}, elsewhere=BAD)[1].remarks == (), "a held-out test decides"


def test_exponents_asked_again_that_do_not_settle_or_undo_another_parameter_stay_held(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fitted_again(monkeypatch, {B: 0.2}, settles=False)[1].remarks == ()
    assert fitted_again(monkeypatch, {B: 0.2, GAMMA: 0.1}, leaves=B[0])[1].here.case.parameters.free[-1:] == GAMMA


def test_of_a_body_all_are_asked_again_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where that is the better optimum it is taken, whatever it gains on held-out data; where it is none, or leaves a parameter without a
    value of its own, they stay held."""
    asked, found = fitted_again(monkeypatch, {}, cheap=False)
    assert asked == [B + GAMMA] and found.here.case.parameters.free[-2:] == B + GAMMA
    assert found.remarks == ("second_hardening.b = 77, backstress_first.gamma = 77: asked again beside the later effects; fitted",)
    assert fitted_again(monkeypatch, {}, cheap=False, leaves=B[0])[1].remarks == ()
    monkeypatch.setattr(module, "freed_refit", lambda *_: (None, "freeing them gains nothing"))
    here, fit = at({})
    here.case.cheap, means = False, cast(Any, SimpleNamespace(refit=None))
    assert exponents_again(here, fit, ("second_hardening",), means) == Rejudged(here, fit)


def test_an_effect_that_a_later_one_makes_needless_goes_before_the_next_round(tmp_path: Path) -> None:
    """Of a truth with two backstresses and no second hardening the loop ends with nothing at a bound."""
    law = {"backstress_first.C": 60e3, "backstress_first.gamma": 900.0, "backstress_second.C": 3000.0, "backstress_second.gamma": 8.0}
    found = looped(study_of(tmp_path), (pulled_record("p", 1e-3, 293.0, 5, 0.5, samples=90, **law),), tmp_path)
    assert found.accepted and ends_of_fit(found.last, found.fit) == {}
    assert float(np.sqrt(np.mean(found.last.columns.residual**2))) < 1.3
