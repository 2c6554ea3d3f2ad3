"""Proof on held-out tests inside the loop: what carries over to another test is judged there, what belongs to one test is not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from refits import refitting
from seen_field import BASE, KNOWN, SIGMA, case_of

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.backward import still_needed
from thermofit.diagnose.before_after import before_after
from thermofit.diagnose.case import Case, OtherTest
from thermofit.diagnose.loop import Closed, close_loop, ranking_rows
from thermofit.diagnose.other_tests import other_test_of, unseen_columns_of
from thermofit.diagnose.proof_other_tests import held_out_words, predicted_unseen, unseen_rms
from thermofit.diagnose.trace import traced
from thermofit.experiment.protocol import Carried
from thermofit.experiment.residuals import Span
from thermofit.experiment.trust import doubts
from thermofit.report.findings import error_rows

DRIFT = {"ir_drift.rate": 1e-3}
ALL = frozenset(e.name for e in KNOWN)


def another(seed: int, judges: frozenset[str] = ALL, own: tuple[str, ...] = (), **planted: float) -> OtherTest:
    """A second test of the same specimen with noise of its own."""
    here = case_of(seed, **planted)

    def carried(free: Sequence[str]) -> Carried:
        return tuple(free), np.eye(len(free))

    def case(p: Parameters) -> Case:
        return replace(here, parameters=p)

    return OtherTest("second", case, carried, judges, own)


def started(test: OtherTest | None, seed: int = 3, **planted: float) -> tuple[Case, object, object]:
    """A case at the optimum of what it fits, its fit, and how to refit."""
    case = case_of(seed, **planted)
    refit = refitting(case.model)
    parameters, fit = refit(case.parameters, "joint")
    return replace(case, parameters=parameters, other_tests=() if test is None else (test,)), fit, refit


def closed(test: OtherTest | None, seed: int = 3, **planted: float) -> Closed:
    case, fit, refit = started(test, seed, **planted)
    return close_loop(case, fit, refit, 3, None)  # type: ignore[arg-type]


def test_an_effect_of_both_tests_is_proved_on_the_unseen_one() -> None:
    found = closed(another(11, **DRIFT), **DRIFT)
    trial = found.rounds[0].trials[0]
    assert found.accepted == ("ir_drift",) and trial.proof is not None and trial.proof.on == "second"
    assert found.first.proofs["ir_drift"].on == "second"
    table = before_after(found.first, found.last)
    before, after = (table[word]["held_out"]["theta@second"] for word in ("before", "after"))
    assert after == pytest.approx(SIGMA, rel=0.05) and before > 1.2 * after
    assert table["after"]["held_out_sigma"]["theta@second"] < 0.1 * after
    assert "theta@second" not in table["after"]["fit"] and "held-out theta@second" in error_rows(table)
    assert ranking_rows(found.first)[0]["held_out_on"] == "second" and held_out_words(found.last).startswith(
        "second, which no fit has seen"
    )


def test_load_phases_are_held_out_where_they_are_asked_for_and_there() -> None:
    case = case_of(3)
    assert traced(case).split.by == traced(case, how="blocks").split.by and "blocks of time and length" in traced(case).split.by
    assert held_out_words(traced(case, how="phases")) == "load phases loading, cooling"


def test_one_load_phase_falls_back_to_blocks_and_says_so() -> None:
    case = replace(case_of(3), spans=(Span("loading", 0.0, 120.0),))
    blocks, asked = traced(case, how="blocks"), traced(case, how="phases")
    assert held_out_words(asked) == f"{held_out_words(blocks)} (only one load phase)" and "only one" not in held_out_words(blocks)
    assert all(np.array_equal(a, b) for a, b in zip(asked.split.held_out, blocks.split.held_out, strict=True))


def test_a_declared_test_comes_before_load_phases_and_blocks() -> None:
    """It judges what carries over to it; what only the fitted test can show is left to phases or blocks, and the words say both."""
    for how, left in (("phases", "load phases loading, cooling"), ("blocks", "blocks of time and length")):
        here = traced(started(another(11, **DRIFT), **DRIFT)[0], how=how)
        assert here.proofs["ir_drift"].on == "second" and held_out_words(here).startswith("second, which no fit has seen; ")
        assert left in held_out_words(here).split("; ")[1]


def test_gain_on_the_unseen_test_is_that_of_the_refit() -> None:
    """The linear proof before and the refit after say the same of the test that neither saw."""
    test = another(11, **DRIFT)
    found = closed(test, **DRIFT)
    first, second = found.first, found.rounds[1].traced
    model = test.case(BASE).model
    for here in (first, second):
        assert predicted_unseen(here) == pytest.approx(model.residual(here.case.parameters), abs=0.02)
    mean = [float(np.mean(predicted_unseen(here) ** 2)) for here in (first, second)]
    proof = found.rounds[0].trials[0].proof
    assert proof is not None and proof.gain == pytest.approx(1.0 - mean[1] / mean[0], rel=1e-6)
    assert first.proofs["ir_drift"].gain == pytest.approx(proof.gain, abs=0.02)


def test_what_the_unseen_test_contradicts_is_refused() -> None:
    """A drift in the fitted test alone, said to be one that every test has."""
    found = closed(another(11), **DRIFT)
    assert found.accepted == () and found.first.proofs["ir_drift"].on == "second"
    row = next(r for r in ranking_rows(found.first) if r["effect"] == "ir_drift")
    assert "held-out error on second rises by" in row["remark"]


def test_what_belongs_to_the_fitted_test_is_judged_there() -> None:
    found = closed(another(11, ALL - {"ir_drift"}), **DRIFT)
    trial = found.rounds[0].trials[0]
    assert found.accepted == ("ir_drift",) and trial.proof is not None and trial.proof.on == ""
    assert ranking_rows(found.first)[0]["held_out_on"] == "rows of the fitted data"


def test_a_test_that_does_not_feel_an_effect_does_not_judge_it() -> None:
    """An emissivity that no warming shows: the unseen test is one at rest."""
    planted = {"ir_emissivity.slope": 2.0}
    test = another(11)
    still = replace(test, case=lambda p: test.case(p.replace(c0=1e6)))
    found = closed(still, **planted)
    proof = found.rounds[0].trials[0].proof
    assert found.accepted == ("ir_emissivity",) and proof is not None and proof.on == ""


def test_a_gain_below_its_uncertainty_leaves_it_to_the_fitted_rows() -> None:
    """The unseen test lacks something large of its own: there the error falls, but who knows by what."""
    found = closed(another(11, **DRIFT, **{"ir_emissivity.slope": 60.0}), **DRIFT)
    before, after = (float(np.sum(predicted_unseen(here) ** 2)) for here in (found.first, found.last))
    assert after < before
    proof = found.rounds[0].trials[0].proof
    assert found.accepted == ("ir_drift",) and proof is not None and proof.on == ""


def test_parameters_of_the_unseen_test_are_fitted_on_its_own_data() -> None:
    planted = {"ir_drift.rate": 4e-3}
    off, _, _ = started(another(11, **planted))
    own, _, _ = started(another(11, own=("ir_drift.rate",), **planted))
    assert unseen_rms(here := traced(off), here.unseen)[0]["theta@second"][0] > 3.0
    assert unseen_rms(here := traced(own), here.unseen)[0]["theta@second"][0] == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize("there", [True, False])
def test_an_accepted_effect_is_kept_where_the_unseen_test_needs_it(there: bool) -> None:
    """The backward check asks the unseen test too: what it shows is needed, what it does not show is not."""
    found = closed(None, **DRIFT)
    assert found.accepted == ("ir_drift",)
    case = replace(found.last.case, other_tests=(another(12, **(DRIFT if there else {})),))
    assert still_needed(traced(case), "ir_drift") is there


def failing(test: OtherTest, where: Callable[[Parameters], bool]) -> OtherTest:
    """A held-out test whose model fails at some parameters."""

    def case(p: Parameters) -> Case:
        if where(p):
            raise NumericsError("time step to t = 60 s failed")
        return test.case(p)

    return replace(test, case=case)


def test_a_held_out_test_that_cannot_be_run_ends_nothing_judges_nothing_and_is_said() -> None:
    """The rows of the fitted test judge, and the answer is not trusted."""
    found = closed(failing(another(11), lambda _: True), **DRIFT)
    proof = found.rounds[0].trials[0].proof
    assert found.accepted == ("ir_drift",) and proof is not None and proof.on == ""
    assert dict(found.last.unpredicted) == {"second": "time step to t = 60 s failed"}
    assert set(before_after(found.first, found.last)["after"]["held_out"]) == {"theta"}
    assert still_needed(found.last, "ir_drift")
    (said,) = doubts([], unpredicted=found.last.unpredicted)
    assert said == "held-out second was not predicted and judges nothing: time step to t = 60 s failed"


def test_an_effect_with_which_a_held_out_test_cannot_be_run_any_more_is_not_judged() -> None:
    off = {e.amplitude.name: e.amplitude.neutral for e in KNOWN}
    found = closed(failing(another(11, **DRIFT), lambda p: any(p[n] != v for n, v in off.items())), **DRIFT)
    trial = next(t for t in found.rounds[0].trials if t.effects == ("ir_drift",))
    assert found.accepted == () and trial.unjudged and "held-out second: time step to t = 60 s failed" in trial.refused
    assert "ir_drift" in found.unjudged and dict(found.last.unpredicted) == {}


def test_held_out_tests_are_compared_where_both_optima_predict_them() -> None:
    """One that the base model cannot be run through, and the model with the effect can."""
    found = closed(failing(another(11, **DRIFT), lambda p: p["ir_drift.rate"] == 0.0), **DRIFT)
    assert found.accepted == ("ir_drift",) and list(found.first.unpredicted) == ["second"] and dict(found.last.unpredicted) == {}
    table = before_after(found.first, found.last)
    assert set(table["before"]["held_out"]) == set(table["after"]["held_out"]) == {"theta"}


@pytest.mark.parametrize("by_sections", ["driven", "fails", "none"])
def test_a_held_out_test_whose_force_cannot_be_carried_is_driven_by_its_sections(by_sections: str) -> None:
    here = case_of(11)
    joint: Any = SimpleNamespace(model=here.model, known=KNOWN, spans=here.spans, each={"": here.model}, parts=None)

    @dataclass
    class Unseen:
        drive: str
        by_sections: Any = None
        label: str = "second"
        fit_own: tuple[str, ...] = ()

        def predicted(self, found: Parameters, identified: Sequence[str]) -> Parameters:
            return found

        def problem(self, *_: Any) -> Any:
            return joint

        def corrected(self, problem: Any, parameters: Parameters) -> Any:
            if self.drive == "force" or by_sections == "fails":
                raise NumericsError(f"{self.drive} fails")
            return problem

        def carried(self, free: Sequence[str], identified: Sequence[str]) -> Carried:
            return tuple(free), np.eye(len(free))

        def judges(self, known: Any) -> frozenset[str]:
            return ALL

    test: Any = Unseen("force", None if by_sections == "none" else Unseen("sections"))
    found = other_test_of(test, cast(Any, SimpleNamespace(free=here.parameters.free)), here.parameters, KNOWN)
    case = replace(here, other_tests=(found,))
    beyond, failed = unseen_columns_of(case, ("ir_drift",), {})
    if by_sections == "driven":
        assert [b.name for b in beyond] == ["second"] and set(beyond[0].dormant) == {"ir_drift"} and failed == {}
    else:
        reason = {"fails": "force fails; driven by its sections: sections fails", "none": "force fails"}[by_sections]
        assert beyond == () and failed == {"second": reason}
