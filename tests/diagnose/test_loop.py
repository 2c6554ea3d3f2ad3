"""The loop on a model of few numbers: what is planted is found, proved, added; nothing is added where nothing is."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import seen_field
from refits import fitted, refitting
from seen_field import BASE, N_S, N_T, SIGMA, TIME, case_of, field

from thermofit.core.errors import NumericsError
from thermofit.core.jsonable import json_text
from thermofit.core.parameters import Parameters
from thermofit.diagnose import loop
from thermofit.diagnose.backward import Means, held_out_of, without
from thermofit.diagnose.before_after import before_after, error_datasets
from thermofit.diagnose.case import Case, RefinedProblem
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.loop import Closed, candidates, close_loop, ranking_rows, rivals
from thermofit.diagnose.trace import Traced, at_end, traced
from thermofit.diagnose.trial import ends_of
from thermofit.effects.catalogue import effect
from thermofit.fit.result import FitResult
from thermofit.report.findings import round_row


def closed(seed: int, **planted: float) -> Closed:
    case, fit = fitted(case_of(seed, **planted))
    return close_loop(case, fit, refitting(case.model), 3, None)


def test_nothing_is_added_where_nothing_is_missing() -> None:
    assert [closed(seed).accepted for seed in range(6)] == [()] * 6


def test_planted_effect_is_named_added_and_estimated() -> None:
    found = closed(3, **{"ir_drift.rate": 1e-3})
    assert found.accepted == ("ir_drift",)
    trial = found.rounds[0].trials[0]
    assert trial.refused == "" and trial.proof is not None and trial.proof.gain > 2.0 * trial.proof.sigma
    assert trial.estimate["ir_drift.rate"] == pytest.approx(1e-3, abs=4.0 * trial.sigma["ir_drift.rate"])
    assert found.last.split is found.first.split, "before and after are compared on the same held-out data"
    table = before_after(found.first, found.last)
    for kind in ("fit", "held_out"):
        assert table["after"][kind]["theta"] < table["before"][kind]["theta"]
        assert table["after"][kind]["theta"] == pytest.approx(SIGMA, rel=0.05)
        sigma = table["after"][f"{kind}_sigma"]["theta"]
        assert sigma == pytest.approx(SIGMA / np.sqrt(2.0 * N_T * N_S), rel=0.5), "white noise is left"
        assert table["before"]["numerical"] == {}, "no error of a mesh was given"
    rows = ranking_rows(found.first, found.accepted)
    assert rows[0]["effect"] == "ir_drift" and rows[0]["accepted"]


def test_errors_stand_beside_both_floors() -> None:
    """A numerical error of a fifth of the noise everywhere that no parameter can make; the datasets are in units of the noise."""
    case, _ = fitted(case_of(3))
    error = traced(case).problem.model.projected(np.random.default_rng(2).normal(size=N_T * N_S))
    here = traced(case, 0.2 * error / np.sqrt(np.mean(error**2)))
    table = before_after(here, here)
    assert table["after"]["numerical"]["theta"] == pytest.approx(0.2 * SIGMA) and table["after"]["floor"]["theta"] == SIGMA
    kept = error_datasets(table)
    assert kept["error/channel"].value.tolist() == ["theta"] and kept["error/after/numerical"].value == pytest.approx([0.2])
    assert kept["error/after/held_out_sigma"].value * SIGMA == pytest.approx([table["after"]["held_out_sigma"]["theta"]])


def test_the_record_of_a_round_lets_it_be_run_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The air warms with a time constant of 40 s: the record holds where the round begins and ends, and the value of the exponent."""
    still = field

    def warming(p: Parameters) -> np.ndarray:
        tau = p["air_drift.time"]
        return np.asarray(still(p) + p["air_drift.rate"] * tau * (1.0 - np.exp(-TIME / tau))[:, None])

    monkeypatch.setattr(seen_field, "field", warming)
    case, fit = fitted(replace(case_of(3, **{"air_drift.rate": 0.02, "air_drift.time": 40.0}), known=(effect("air_drift"),)))
    found = close_loop(case, fit, refitting(case.model), 3, None)
    assert found.accepted == ("air_drift",)
    first, second = (json.loads(json_text(round_row(r))) for r in found.rounds)
    for end, free in (("before", ["kappa", "c0"]), ("after", ["kappa", "c0", "air_drift.rate", "air_drift.time"])):
        kept = first[end]
        there = Parameters.of(kept["parameters"], tuple(kept["free"]))
        assert kept["free"] == free and kept["f"] == pytest.approx(np.sum(case.model.residual(there) ** 2), rel=1e-9)
    assert first["before"]["parameters"]["c0"] == case.parameters["c0"]
    assert second["before"] == first["after"] and second["after"] is None, "the second round begins there, and adds nothing"
    (trial,) = first["tried"]
    value = trial["exponent_values"]["air_drift.time"]
    assert trial["exponents"] == "fitted" and value["value"] == first["after"]["parameters"]["air_drift.time"]
    assert value["value"] == pytest.approx(40.0, abs=4.0 * value["sigma"]) and value["unit"] == "s" and 0.0 < value["sigma"] < 5.0


def test_a_refit_that_fails_leaves_the_exponents_it_began_with() -> None:
    start = Parameters.of({"air_drift.time": 60.0})
    _, fit = fitted(case_of(1))
    assert ends_of(["air_drift"], start, fit) == {"air_drift.time": (60.0, None)}


def test_two_effects_are_both_found() -> None:
    found = closed(5, **{"ir_drift.rate": 1.5e-3, "ir_emissivity.slope": 2.0})
    assert set(found.accepted) == {"ir_drift", "ir_emissivity"}


def test_what_a_fitted_parameter_imitates_is_not_an_effect() -> None:
    """A gain of the camera is one over c0 here: unfelt, never added."""
    found = closed(1, **{"ir_gain.gain": 0.05})
    assert "ir_gain" in found.first.ranking.unfelt or all(
        s.detectability < 0.05 for s in found.first.ranking.scores if s.effect == "ir_gain"
    )
    assert found.accepted == ()


def test_an_effect_that_does_not_stand_off_neutral_is_refused() -> None:
    found = closed(2, **{"ir_drift.rate": 1e-3})
    later = [row for r in found.rounds[1:] for row in ranking_rows(r.traced)]
    assert later and all(row["remark"] for row in later)


EXPONENT = "rate_logarithmic.reference"
DRIFTING = {"ir_drift.rate": 0.02}


def with_gain_as_noise(case: Case, near: float) -> tuple[Case, list[float]]:
    """A case that takes an error of the gain for noise once the drift is known to `near` K/s, and the drifts at which it was asked."""
    planted = case.model
    (plain_one,) = planted.comparisons
    asked: list[float] = []
    column = plain_one.residual(np.repeat(field(BASE)[:, :, None] - 297.0, 1, axis=2))
    sharp_model = replace(planted, comparisons=(plain_one.blurred(1e-3 * column[:, None]),))

    def sharper(parameters: Parameters) -> RefinedProblem | None:
        asked.append(parameters["ir_drift.rate"])
        if abs(parameters["ir_drift.rate"] - 0.02) > near:
            return None
        fit = refitting(sharp_model)
        return RefinedProblem(sharp_model, None, fit, fit, np.zeros(plain_one.n))

    return replace(case, refined_at=sharper), asked


def test_the_loop_turns_to_the_problem_that_knows_its_errors_when_it_is_near() -> None:
    """Not before the drift is in; then once, with the error at first told again by that problem, and the ranking as it was at first."""
    case, asked = with_gain_as_noise(case_of(5, **{"ir_drift.rate": 0.02}), 1e-3)
    case, fit = fitted(case)
    plain_end = close_loop(replace(case, refined_at=None), fit, refitting(case.model), 3, None)
    found = close_loop(case, fit, refitting(case.model), 3, None)
    assert found.accepted == plain_end.accepted == ("ir_drift",)
    assert len(asked) == 2 and asked[0] == 0.0 and asked[1] == pytest.approx(0.02, rel=0.05)
    sharp_model = found.last.case.model
    assert found.last.case.refined_at is None and sharp_model is not case.model and found.first.case.model is sharp_model
    np.testing.assert_allclose(found.first.columns.residual, sharp_model.residual(case.parameters))
    assert found.first.ranking is found.rounds[0].traced.ranking and found.numerical is not None
    assert (
        found.refit is not None
        and found.last.columns.residual @ found.last.columns.residual < found.first.columns.residual @ found.first.columns.residual
    )


def test_errors_are_told_anew_for_the_next_effect() -> None:
    """Two planted ones: the problem that is told with the first of them is told again with the second, with what may be left of it."""
    case, _ = with_gain_as_noise(case_of(5, **{"ir_drift.rate": 0.02, "ir_emissivity.slope": 2.0}), 1e9)
    case, fit = fitted(case)
    sharper, told = case.refined_at, []
    assert sharper is not None

    def again(known: frozenset[str]) -> Any:
        def tell(parameters: Parameters) -> RefinedProblem | None:
            added = frozenset(n for n in parameters.free if n in ("ir_drift.rate", "ir_emissivity.slope"))
            found = sharper(parameters) if added - known else None
            if found is None:
                return None
            told.append(added)
            return replace(found, again=again(added), doubts={"mesh": np.full(N_T * N_S, float(len(added)))})

        return tell

    found = close_loop(replace(case, refined_at=again(frozenset())), fit, refitting(case.model), 3, None)
    assert set(found.accepted) == {"ir_drift", "ir_emissivity"} and [len(one) for one in told] == [1, 2]
    assert found.last.case.doubts["mesh"][0] == 2.0 and found.base is None, "the first optimum is none of this problem"


def test_the_loop_says_what_the_problem_that_knows_its_errors_leaves_undetermined() -> None:
    case, _ = with_gain_as_noise(case_of(5, **DRIFTING), 1e-3)
    case, fit = fitted(case)
    sharper = case.refined_at
    assert sharper is not None

    def holding(parameters: Parameters) -> RefinedProblem | None:
        sharp = sharper(parameters)
        if sharp is None:
            return None
        nearby = sharp.nearby
        return replace(sharp, nearby=lambda start, label, **_: nearby(start.with_free(n for n in start.free if n != "c0"), label))

    found = close_loop(replace(case, refined_at=holding), fit, refitting(case.model), 3, None)
    assert found.accepted == ("ir_drift",) and "c0" not in found.last.case.parameters.free
    (said,) = found.remarks
    assert said == f"held at c0 = {found.last.case.parameters['c0']:.3g}: free beside the error of the force, it does not settle"


def test_exponents_that_were_held_are_asked_again_beside_the_error_of_the_force(monkeypatch: pytest.MonkeyPatch) -> None:
    """A force that is taken as exact and wrong may have held them at the wrong place."""
    case, _ = with_gain_as_noise(case_of(5, **DRIFTING), 1e-3)
    case, fit = fitted(case)
    sharper, begun = case.refined_at, []
    assert sharper is not None

    def watched(parameters: Parameters) -> RefinedProblem | None:
        sharp = sharper(parameters)
        if sharp is None:
            return None
        nearby = sharp.nearby

        def near(start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
            begun.append(start.free)
            return nearby(start.with_free(n for n in start.free if n != EXPONENT), label)

        return replace(sharp, nearby=near)

    monkeypatch.setattr(loop, "vague_exponents", lambda case: (EXPONENT,))
    found = close_loop(replace(case, refined_at=watched), fit, refitting(case.model), 3, None)
    assert [EXPONENT in free for free in begun] == [True] and EXPONENT not in found.last.case.parameters.free
    assert found.remarks[0].startswith(f"held at {EXPONENT} = ")


@pytest.mark.parametrize(
    ("free", "asked"),
    [
        (("rate_logarithmic.C",), (EXPONENT,)),
        (("E",), ()),
        (("rate_logarithmic.C", EXPONENT), ()),
        (("lamp.absorbed",), ()),
        (("latent_heat.heat",), ()),
    ],
)
def test_held_exponents_are_those_of_effects_that_are_on(free: tuple[str, ...], asked: tuple[str, ...]) -> None:
    """Those with a size of their own that displacements show: of the heat balance they are free where that gains something."""
    known = tuple(effect(name) for name in ("rate_logarithmic", "lamp", "latent_heat"))
    case: Any = SimpleNamespace(parameters=Parameters.of({EXPONENT: 1e-4}, free), known=known)
    assert loop.vague_exponents(case) == asked


def test_the_loop_stays_with_the_plain_problem_where_it_is_never_near() -> None:
    case, asked = with_gain_as_noise(case_of(5, **{"ir_drift.rate": 0.02}), -1.0)
    case, fit = fitted(case)
    found = close_loop(case, fit, refitting(case.model), 3, None)
    assert found.accepted == ("ir_drift",) and len(asked) == 2 and found.last.case.model is case.model and found.numerical is None


def test_an_effect_whose_judgement_fails_is_refused_with_the_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    """The run at the end of its refit has no solution: the loop says so and goes on."""

    def failing(case: Case, *rest: Any) -> Traced:
        if case.parameters["ir_drift.rate"] != 0.0:
            raise NumericsError("no equilibrium at 12 s")
        return at_end(case, *rest)

    monkeypatch.setattr("thermofit.diagnose.backward.at_end", failing)
    found = closed(5, **DRIFTING)
    (trial,) = [t for t in found.rounds[0].trials if t.score.effect == "ir_drift"]
    assert trial.refused == "a run that judges it failed: no equilibrium at 12 s" and trial.proof is None
    assert "ir_drift" not in found.accepted


def test_where_nothing_further_can_be_asked_the_loop_ends_with_what_it_has_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """The run that asks all dormant effects has no solution beside the effect that was added."""

    def failing(case: Case, *rest: Any, **more: Any) -> Traced:
        if case.parameters["ir_drift.rate"] != 0.0:
            raise NumericsError("no equilibrium at 12 s")
        return traced(case, *rest, **more)

    for place in ("backward", "loop"):
        monkeypatch.setattr(f"thermofit.diagnose.{place}.traced", failing)
    found = closed(5, **DRIFTING)
    assert found.accepted == ("ir_drift",) and not found.last.whole and len(found.rounds) == 2
    assert dict(found.unjudged) == {"any further effect": "no equilibrium at 12 s"}


def test_the_end_of_a_refit_is_judged_without_asking_the_dormant_effects() -> None:
    """Held-out error, need and standard errors of a whole trace, at no run: only rounds and the end ask all effects."""
    case, fit = fitted(case_of(5, **DRIFTING))
    here = traced(case)
    light, whole = at_end(case, fit, here.split, here), traced(case, split=here.split, fit=fit)
    assert (
        light.columns.dormant == {} and not light.whole and whole.whole and set(whole.problem.dormant) == {e.name for e in case.dormant()}
    )
    for found in (light, whole):
        assert found.columns.residual is fit.residual and found.columns.fitted is fit.jacobian
        np.testing.assert_allclose(held_out_of(found), held_out_of(here), atol=1e-6)
    moved = replace(case, parameters=case.parameters.replace(c0=1.01 * case.parameters["c0"]))
    np.testing.assert_allclose(at_end(moved, fit, here.split, here).columns.residual, moved.model.residual(moved.parameters))
    assert [t.traced.whole for t in closed(5, **DRIFTING).rounds] == [True, True]


def test_the_loop_goes_on_where_the_error_of_the_force_cannot_be_told() -> None:
    case, fit = fitted(case_of(5, **DRIFTING))
    asked: list[Parameters] = []

    def failing(parameters: Parameters) -> RefinedProblem:
        asked.append(parameters)
        raise NumericsError("the finer run failed")

    found = close_loop(replace(case, refined_at=failing), fit, refitting(case.model), 3, None)
    assert found.accepted == ("ir_drift",) and len(asked) == 1 and found.last.case.model is case.model
    (said,) = found.remarks
    assert said.startswith("the force is taken as exact to the end") and "the finer run failed" in said


def test_the_loop_goes_on_where_the_motion_cannot_be_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(here: Traced) -> Traced:
        raise NumericsError("step 3 does not converge")

    monkeypatch.setattr("thermofit.diagnose.loop.rescored", failing)
    found = closed(5, **DRIFTING)
    assert found.accepted == ("ir_drift",) and len(found.remarks) == len(found.rounds)
    assert all("no effect was judged on the known motion" in said and "step 3" in said for said in found.remarks)


@pytest.mark.parametrize("then", ["fails", "agrees", "asks for it"])
def test_an_effect_that_is_no_longer_needed_goes_unless_the_fit_without_it_fails_or_asks_for_it(
    monkeypatch: pytest.MonkeyPatch, then: str
) -> None:
    """Both are planted, so that the refit asks for it by itself."""
    fails = then == "fails"
    monkeypatch.setattr("thermofit.diagnose.loop.still_needed", lambda *_: False)
    if then == "agrees":
        monkeypatch.setattr("thermofit.diagnose.loop.proof_against", lambda *_: Proof(1.0, 1.0, {}, -0.1, 0.01, 5))
    case, fit = fitted(case_of(5, **{"ir_drift.rate": 1.5e-3, "ir_emissivity.slope": 2.0}))
    refit = refitting(case.model)

    def failing(start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        if fails and label.startswith("without"):
            raise NumericsError("no start can be run")
        return refit(start, label)

    found = close_loop(case, fit, failing, 3, None)
    (first,), (second,) = (r.accepted for r in found.rounds[:2])
    assert {first, second} == {"ir_drift", "ir_emissivity"}
    if fails:
        assert found.accepted == (first, second) and found.dropped == ()
        (said,) = found.remarks
        assert said == f"{first} is no longer needed, but stays in: the fit without it failed (no start can be run)"
    elif then == "agrees":
        assert found.accepted == (second,) and found.dropped == (first,) and found.remarks == ()
    else:
        assert found.accepted == (first, second) and found.dropped == () and found.remarks == ()
    assert all(
        (effect(str(name)).amplitude.name in found.last.case.parameters.free) is (name in found.accepted) for name in (first, second)
    )


def test_an_effect_is_a_rival_while_its_linearised_gain_may_exceed_what_was_gained() -> None:
    here = traced(fitted(case_of(5, **DRIFTING))[0])
    (one,) = (name for name in here.proofs if name == "ir_drift")
    gain, sigma = here.proofs[one].gain, here.proofs[one].sigma
    assert sigma > 0.0
    assert rivals(here, one, gain + 1.9 * sigma) and not rivals(here, one, gain + 2.1 * sigma)


@pytest.mark.parametrize(
    ("warmed", "ahead", "order"),
    [
        ((), 0.9, ["ir_gain", "ir_drift", "ir_emissivity"]),
        (("ir_drift",), 0.9, ["ir_drift", "ir_gain", "ir_emissivity"]),
        (("ir_drift",), 1.1, ["ir_gain", "ir_drift", "ir_emissivity"]),
        (("ir_drift", "ir_gain"), 0.9, ["ir_gain", "ir_drift", "ir_emissivity"]),
    ],
    ids=["none refitted", "equal within the error", "beyond the error", "both refitted"],
)
def test_a_gain_shown_by_a_refit_comes_before_an_equal_one_of_the_linear_model(
    warmed: tuple[str, ...], ahead: float, order: list[str]
) -> None:
    """The linear model may promise as much by a long step, in which it does not hold."""
    here = traced(case_of(3, **{"ir_drift.rate": 4e-4}))
    like, proved = next(s for s in here.ranking.scores if s.effect == "ir_drift"), here.proofs["ir_drift"]
    sigma = 0.05 * proved.gain
    gains = {"ir_drift": proved.gain, "ir_gain": proved.gain + ahead * np.sqrt(2.0) * sigma, "ir_emissivity": 0.5 * proved.gain}
    scores = tuple(replace(like, effect=name, z=30.0) for name in gains)
    proofs = {name: replace(proved, gain=gain, sigma=sigma) for name, gain in gains.items()}
    told = replace(here, ranking=replace(here.ranking, scores=scores), proofs=proofs, warmed=warmed)
    assert [s.effect for s in told.promising()] == order


def test_the_effect_with_the_largest_gain_is_tried_though_two_with_an_equal_gain_come_first() -> None:
    here = traced(case_of(3, **{"ir_drift.rate": 4e-4}))
    like, proved = next(s for s in here.ranking.scores if s.effect == "ir_drift"), here.proofs["ir_drift"]
    told = {"ir_drift": (0.10, 0.045), "ir_gain": (0.06, 0.010), "ir_emissivity": (0.056, 0.001)}
    scores = tuple(replace(like, effect=name, z=30.0) for name in told)
    proofs = {name: replace(proved, gain=gain, sigma=sigma) for name, (gain, sigma) in told.items()}
    tied = replace(here, ranking=replace(here.ranking, scores=scores), proofs=proofs, warmed=("ir_gain", "ir_emissivity"))
    tied = replace(tied, case=replace(here.case, cheap=False))
    assert [s.effect for s in tied.promising()] == ["ir_gain", "ir_emissivity", "ir_drift"]
    assert [s.effect for s in candidates(tied)] == ["ir_gain", "ir_drift", "ir_emissivity"]


@pytest.mark.parametrize("fails", [False, True])
def test_an_effect_that_others_make_up_for_goes_unless_the_fit_without_it_fails(monkeypatch: pytest.MonkeyPatch, fails: bool) -> None:
    """What the refit without it answers is taken as it is; a failure keeps the effect, with a remark."""

    def answer(here: Traced, name: str, others: list[str], means: Means) -> tuple[Traced, FitResult]:
        assert name not in others and len(others) == 1
        if fails:
            raise NumericsError("no start can be run")
        return without(here, name, means)

    monkeypatch.setattr("thermofit.diagnose.loop.compensated", answer)
    found = closed(5, **{"ir_drift.rate": 1.5e-3, "ir_emissivity.slope": 2.0})
    (first,) = found.rounds[0].accepted
    assert (first in found.accepted) is fails and (found.dropped == ()) is fails
    assert list(found.remarks) == (
        [f"{first} may not be needed, but stays in: the fit without it failed (no start can be run)"] if fails else []
    )
