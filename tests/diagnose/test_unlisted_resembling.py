"""Listed effects that together resemble an unlisted source are taken back; what was really there stays."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refits import fitted, refitting
from scipy.stats import norm
from strip import MODEL, numerical, spot, strip_case

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose import unlisted_loop
from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import Closed, Round
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.trial import Trial
from thermofit.diagnose.unlisted import HALF, Unlisted, structured
from thermofit.diagnose.unlisted_field import BEHIND
from thermofit.diagnose.unlisted_loop import ended, in_their_stead, one_spot_instead, trace_without
from thermofit.fit.result import FitResult

AMPLITUDES = {"ir_drift": "ir_drift.rate", "ir_emissivity": "ir_emissivity.slope", "stored_energy": "stored_energy.slope"}
SPOT = spot(30.0, -5.0, 8.0, (40.0, 75.0))


def with_accepted(seed: int, names: tuple[str, ...], spotted: bool, **planted: float) -> Closed:
    """A loop that has accepted the named effects, whatever is in the data."""
    return accepting(fitted(strip_case(seed, SPOT if spotted else None, **planted))[0], names, numerical())


def accepting(case: Case, names: tuple[str, ...], error: np.ndarray | None = None) -> Closed:
    """The loop from the optimum of a case that has accepted the named effects."""
    first, refit = traced(case, error), refitting(case.model)
    start = case.parameters.with_free((*case.parameters.free, *(AMPLITUDES[n] for n in names)))
    parameters, fit = refit(start, "accepted")
    last = traced(replace(case, parameters=parameters), error, split=first.split)
    scores = {s.effect: s for s in first.ranking.scores}
    rounds = tuple(Round(first, (Trial((scores[n],), None, {}, {}, 0.0, ""),), (n,)) for n in names)
    return Closed(rounds, first, last, fit, names, (), refit, error)


def test_what_together_resembles_a_source_is_taken_back_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where what they leave no longer asks for a field of its own."""
    closed = with_accepted(2, tuple(AMPLITUDES), spotted=True)
    assert len(in_their_stead(closed, structured(closed.last, numerical()))) >= 2, (
        "in the stead of one alone the others would still be in the way"
    )
    asked, seen = [], counting(monkeypatch)

    def silent_at_first(here: Traced, *rest: object) -> Unlisted | None:
        asked.append(rest)
        return None if len(asked) == 1 else true(here, *rest)  # type: ignore[arg-type]

    true = unlisted_loop.unlisted
    monkeypatch.setattr(unlisted_loop, "unlisted", silent_at_first)
    end, found = ended(closed, closed.refit, numerical(), "auto")
    assert found is not None and found.place is not None and not end.accepted
    assert len({id(here) for here in seen}) == len(seen) > 1 and seen[-1] is end.last, "each state is asked once"
    assert set(found.resembles) == set(AMPLITUDES) and set(end.dropped) == set(AMPLITUDES)
    assert found.place.size == pytest.approx(30.0, rel=0.15)


def counting(monkeypatch: pytest.MonkeyPatch) -> list[Traced]:
    """The states of which the end of a loop asks what channels hold structure."""
    asked: list[Traced] = []
    monkeypatch.setattr(unlisted_loop, "structured", lambda here, error: asked.append(here) or structured(here, error))
    return asked


def test_what_is_the_cause_is_not_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drift of the camera that was planted leaves nothing, and a field in its stead is no better. What channels hold is asked once."""
    asked = counting(monkeypatch)
    closed = with_accepted(1, ("ir_drift",), spotted=False, **{"ir_drift.rate": 2e-3})
    assert in_their_stead(closed, structured(closed.last, numerical())) == ()
    end, found = ended(closed, closed.refit, numerical(), "auto")
    assert end.accepted == ("ir_drift",) and found is None and len(asked) == 1 and asked[0] is closed.last


def test_a_cause_beside_a_source_stays_and_what_resembles_goes() -> None:
    closed = with_accepted(8, ("ir_drift", "ir_emissivity"), spotted=True, **{"ir_drift.rate": 4e-3})
    assert in_their_stead(closed, structured(closed.last, numerical())) in ((), ("ir_emissivity",))
    end, found = ended(closed, closed.refit, numerical(), "auto")
    assert end.accepted == ("ir_drift",) and found is not None and found.resembles == ("ir_emissivity",)


def beside_one_spot(names: tuple[str, ...], heights: tuple[float, ...], **planted: float) -> Closed:
    """A loop that has accepted effects beside a source as wide as the strip, and a sink where there are two, on the model's own cells."""

    def source(x: np.ndarray, y: np.ndarray, time: float) -> np.ndarray:
        along = sum(sign * norm.pdf(y, height, 3.0) for sign, height in zip((0.3, -0.3), heights, strict=False))
        return np.asarray((1.0 + np.sin(2.0 * np.pi * time / 55.0)) * along + 0.0 * x)

    case, fit = fitted(strip_case(3, source, lab=MODEL, **planted))
    sharp: Any = SimpleNamespace(model=case.model, doubts={})
    told = replace(case, refined_at=lambda parameters, beside=None: sharp)
    return replace(accepting(told, names), base=fit)


@pytest.mark.parametrize(("heights", "stays"), [((8.0,), False), ((12.0, -14.0), True)], ids=["source", "source and sink"])
def test_what_answers_is_taken_back_where_one_spot_is_all_without_it(heights: tuple[float, ...], stays: bool) -> None:
    """A drift that was planted leaves less than a tenth of the excess, and what else was accepted counts as a part of that answer, unless
    one spot is all that is missing without it. Beside a sink none is. The drift itself is needed beside any field."""
    closed = beside_one_spot(("ir_drift", "ir_emissivity"), heights, **{"ir_drift.rate": 4e-3})
    found = unlisted_loop.unlisted(closed.last, structured(closed.last, None), ())
    assert found is not None
    blocks = found.structure.blocks
    assert found.structure.excess < BEHIND * blocks.excess(closed.first.columns.residual)
    end, found = ended(closed, closed.refit, None, "auto")
    assert found is not None and "ir_drift" in end.accepted
    assert end.accepted == (("ir_drift", "ir_emissivity") if stays else ("ir_drift",))
    assert found.resembles == (() if stays else ("ir_emissivity",)) and found.beside == end.accepted
    assert (found.spot is None) is stays
    if found.spot is not None:
        assert found.spot.beside == end.accepted and found.parameters == found.spot.parameters and found.place is not None
        assert found.spot.field is not None and found.spot.field.basis.grid.y[0] == pytest.approx(8.0, abs=0.5)


def test_where_nothing_is_left_the_base_model_is_where_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is fitted already; a refit from where effects have driven it may not find back. One spot is asked for beside it too."""
    closed = beside_one_spot(("ir_emissivity",), (8.0,))
    assert closed.base is not None and trace_without(closed, ("ir_emissivity",)) is closed.first
    end, found = ended(closed, no_refit, None, "auto")
    assert end.accepted == () and end.last is closed.first and end.fit is closed.base and end.dropped == ("ir_emissivity",)
    assert found is not None and found.resembles == ("ir_emissivity",) and found.beside == ()
    back = trace_without(replace(closed, base=None), ("ir_emissivity",))
    assert back.case.parameters.free == closed.first.case.parameters.free and not back.whole
    assert back.case.parameters["ir_emissivity.slope"] == param("ir_emissivity.slope").neutral
    others = replace(closed, accepted=("ir_drift", "ir_emissivity"))
    assert trace_without(others, ("ir_emissivity",)) is not closed.first, "what else was accepted stays"

    asked: list[Traced] = []
    of_displacements = replace(closed.first, case=replace(closed.first.case, moved=lambda parameters: parameters.replace(E=7.1e4)))

    def none(here: Traced, _: Unlisted) -> tuple[Unlisted | None, str]:
        asked.append(here)
        return None, "one spot leaves structure"

    monkeypatch.setattr(unlisted_loop, "as_spot", none)
    assert one_spot_instead(replace(closed, first=of_displacements), ("ir_emissivity",), found) is None and len(asked) == 1
    assert asked[0].case.parameters["E"] == 7.1e4, "a spot is asked for on the motion of the displacements alone"

    def fails(*_: object) -> Any:
        raise NumericsError("no run there")

    monkeypatch.undo()
    monkeypatch.setattr(unlisted_loop, "BEHIND", 1.0)  # so that it counts as an answer
    monkeypatch.setattr(unlisted_loop, "beside_spot", fails)
    anew, found = ended(closed, no_refit, None, "auto")
    assert anew.accepted == () and found is not None and found.spot is None
    assert any("sought anew: the run beside one spot failed (no run there)" in r for r in anew.remarks)
    monkeypatch.setattr(unlisted_loop, "trace_without", fails)
    stays, _ = ended(closed, no_refit, None, "auto")
    assert stays.accepted == ("ir_emissivity",)
    assert any(
        "whether ir_emissivity only resembles what is unlisted was not judged: a run failed (no run there)" in r for r in stays.remarks
    )


def test_where_the_base_model_does_not_settle_it_is_where_the_loop_began() -> None:
    """What is missing kept the first fit from settling as well. Beside other effects one that resembles stays then, and both are said."""
    closed = replace(beside_one_spot(("ir_emissivity",), (8.0,)), base=None)
    begun = closed.first.case.parameters

    def ends_elsewhere(start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        _, fit = refitting(closed.first.case.model)(start, label)
        return start.replace(kappa=1.1 * start["kappa"]), fit

    def crawls(start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        parameters, fit = ends_elsewhere(start, label)
        return parameters, replace(fit, converged=False, message="crawls")

    end, found = ended(closed, crawls, None, "auto")
    assert end.accepted == () and end.last.case.parameters.values == begun.values and end.last.case.parameters.free == begun.free
    assert end.last.columns.residual == pytest.approx(closed.first.columns.residual) and not end.fit.converged
    assert any("without ir_emissivity has not settled (crawls): traced from where the loop began" in r for r in end.remarks)
    assert found is not None and found.resembles == ("ir_emissivity",)
    settles, _ = ended(closed, ends_elsewhere, None, "auto")
    assert settles.accepted == () and settles.last.case.parameters["kappa"] == pytest.approx(1.1 * begun["kappa"])
    more = beside_one_spot(("ir_drift", "ir_emissivity"), (8.0,), **{"ir_drift.rate": 4e-3})
    stays, found = ended(more, crawls, None, "auto")
    assert stays.accepted == ("ir_drift", "ir_emissivity") and any("did not converge (crawls)" in r for r in stays.remarks)


def no_refit(*_: object) -> Any:
    """A refit that nobody should ask for."""
    pytest.fail("the base model is fitted")


def test_what_was_refused_or_is_not_worth_a_refit_explains_nothing() -> None:
    """A drift of the camera explains itself while it may still be tried. Had it been refused, it would explain nothing, however much its
    linear step takes: the term would be told as unlisted, with the drift as the listed effect that comes closest."""
    case, _ = fitted(strip_case(1, **{"ir_drift.rate": 2e-3}))
    here = traced(case, numerical())
    assert unlisted_loop.unlisted(here, structured(here, numerical()), ["ir_drift"]) is None
    found = unlisted_loop.unlisted(here, structured(here, numerical()), [])
    assert found is not None and found.listed[0] == "ir_drift" and found.listed[1] > HALF


def test_on_coupons_no_field_stands_in_the_stead_of_effects() -> None:
    """A stress over the time of a record follows all that is smooth."""
    closed = with_accepted(2, tuple(AMPLITUDES), spotted=True)
    coupon = replace(closed.last, case=replace(closed.last.case, cheap=True))
    assert in_their_stead(replace(closed, last=coupon), structured(closed.last, numerical())) == ()
