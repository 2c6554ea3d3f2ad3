"""Small unlisted terms beside which the parameters of the material stay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refits import fitted, refitting
from strip import SIGMA, numerical, strip_case

from thermofit.diagnose import small_term as module
from thermofit.diagnose import whole_loop
from thermofit.diagnose.beside_source import BesideSource
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.small_term import moves_nothing
from thermofit.diagnose.trace import traced
from thermofit.diagnose.unlisted import WORTH, Unlisted
from thermofit.diagnose.unlisted_loop import ended


def looped(offset: Callable[[np.ndarray], np.ndarray]) -> tuple[Closed, Unlisted]:
    """The end of a loop that has accepted nothing on a strip whose camera has an offset over time, and what is missing there."""
    case, fit = fitted(strip_case(4, offset=offset))
    here = traced(case, numerical())
    closed, found = ended(
        Closed((), here, here, fit, (), (), refitting(case.model), numerical()), refitting(case.model), numerical(), "auto"
    )
    assert found is not None and found.field is not None
    return closed, replace(found, field=replace(found.field, proof=replace(found.field.proof, gain=0.9 * WORTH)))


def to_and_fro(time: np.ndarray) -> np.ndarray:
    """An offset that no block shows, K."""
    return np.asarray(0.3 * SIGMA * np.sin(2.0 * np.pi * time / 60.0))


def moved(closed: Closed, errors: float) -> BesideSource:
    """Parameters beside a term: the first of the material by so many of its standard errors, all others by nothing."""
    values = {n: closed.last.case.parameters[n] for n in closed.last.case.parameters.free}
    first = next(iter(values))
    sigma = {n: 0.1 * abs(v) for n, v in values.items()}
    return BesideSource({**values, first: values[first] - errors * sigma[first]}, sigma)


def test_a_small_term_that_moves_no_parameter_is_none() -> None:
    closed, found = looped(to_and_fro)
    assert moves_nothing(closed, found, moved(closed, 1.9))
    assert not moves_nothing(closed, found, moved(closed, 2.1)), "a parameter of the material moves by it"
    assert not moves_nothing(closed, None, moved(closed, 0.0))
    assert not moves_nothing(closed, found, None)
    assert not moves_nothing(closed, found, BesideSource({}, {}, "a run failed")), "what it moves is not known"
    assert not moves_nothing(closed, replace(found, field=None), moved(closed, 0.0))
    assert found.field is not None
    large = replace(found, field=replace(found.field, proof=replace(found.field.proof, gain=1.1 * WORTH)))
    assert not moves_nothing(closed, large, moved(closed, 0.0)), "held-out data surely gain by it"


def test_what_blocks_show_is_told_whatever_it_moves() -> None:
    closed, found = looped(lambda time: 3.0 * SIGMA * (time > 60.0))
    assert [s.blocks.channel for s in module.standing(closed.last, closed.numerical)] == [found.channel]
    assert not moves_nothing(closed, found, moved(closed, 0.0))


def test_a_coupon_has_no_such_term() -> None:
    """Of its parameters all are few data's."""
    closed, found = looped(to_and_fro)
    cheap = replace(closed, last=replace(closed.last, case=replace(closed.last.case, cheap=True)))
    assert not moves_nothing(cheap, found, moved(closed, 0.0))


@pytest.mark.parametrize("still", [True, False])
def test_the_end_of_the_loop_asks(still: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors are told anew without the term, which a remark names."""
    closed, found = looped(to_and_fro)
    asked, beside = list[Unlisted | None](), moved(closed, 0.0 if still else 3.0)

    def errors(now: Closed, missing: Unlisted | None, how: str) -> Closed:
        asked.append(missing)
        return now

    monkeypatch.setattr(whole_loop, "close_loop", lambda *_: closed)
    monkeypatch.setattr(whole_loop, "ended", lambda *_: (closed, found))
    monkeypatch.setattr(whole_loop, "with_all_errors", errors)
    monkeypatch.setattr(whole_loop, "beside_source", lambda _, missing, budget: beside if missing is not None else None)
    prepared: Any = type("P", (), {"case": None, "fit": None, "refit": None, "numerical": None})()
    monkeypatch.setattr(whole_loop, "replace", lambda of, **new: of if of is prepared else replace(of, **new))
    study: Any = SimpleNamespace(diagnosis=SimpleNamespace(held_out="auto", max_effects=3))
    end = whole_loop.looped(study, prepared)
    if still:
        assert end.missing is None and end.beside is None and asked == [found, None]
        (words,) = end.closed.remarks[len(closed.remarks) :]
        assert words.startswith("theta: offset of the infrared camera (") and "no parameter of the material moves by it" in words
    else:
        assert end.missing is found and end.beside is beside and asked == [found] and end.closed.remarks == closed.remarks
