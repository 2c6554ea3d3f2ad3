"""Listed effects that together resemble an unlisted source are taken back; what was really there stays."""

from __future__ import annotations

from dataclasses import replace

import pytest
from refits import fitted, refitting
from strip import numerical, spot, strip_case

from thermofit.diagnose import unlisted_loop
from thermofit.diagnose.loop import Closed, Round
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.trial import Trial
from thermofit.diagnose.unlisted import HALF, Unlisted, structured
from thermofit.diagnose.unlisted_loop import ended, in_their_stead

AMPLITUDES = {"ir_drift": "ir_drift.rate", "ir_emissivity": "ir_emissivity.slope", "stored_energy": "stored_energy.slope"}
SPOT = spot(30.0, -5.0, 8.0, (40.0, 75.0))


def with_accepted(seed: int, names: tuple[str, ...], spotted: bool, **planted: float) -> Closed:
    """A loop that has accepted the named effects, whatever is in the data."""
    case, fit = fitted(strip_case(seed, SPOT if spotted else None, **planted))
    first, refit = traced(case, numerical()), refitting(case.model)
    start = case.parameters.with_free((*case.parameters.free, *(AMPLITUDES[n] for n in names)))
    parameters, fit = refit(start, "accepted")
    last = traced(replace(case, parameters=parameters), numerical(), split=first.split)
    scores = {s.effect: s for s in first.ranking.scores}
    rounds = tuple(Round(first, (Trial((scores[n],), None, {}, {}, 0.0, ""),), (n,)) for n in names)
    return Closed(rounds, first, last, fit, names, (), refit, numerical())


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
