"""Unlisted effects of coupons: a pulse of heat and a bump of the yield stress that the catalogue does not know, and files of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_case import BUMP, FREE, POWER, PULSE, TRUTH, case_of
from refits import refitting

from thermofit.core.parameters import Parameters
from thermofit.diagnose import unlisted_loop
from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import close_loop
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import Unlisted, other_kinds, structured, unlisted
from thermofit.diagnose.unlisted_loop import ended
from thermofit.effects.catalogue import load_effect
from thermofit.report.unlisted import effect_file, summary_of


def found_in(case: Case) -> tuple[Traced, Unlisted | None]:
    parameters, fit = refitting(case.model)(case.parameters, "joint")
    assert fit.converged
    here = traced(replace(case, parameters=parameters))
    return here, unlisted(here, structured(here, None), [s.effect for s in here.promising()])


def amount_of_file(folder: Path, here: Traced, found: Unlisted, again: Callable[[], Case]) -> tuple[float, Case, Parameters]:
    """The share of a reconstructed term that a fit with its effect file finds in a case made after the file is loaded; that case, and the
    parameters of the fit."""
    file = effect_file("a test", here, found)
    assert file is not None
    path = folder / f"{file.name}.py"
    path.write_text(file.text, encoding="utf-8")
    added, case = load_effect(path), again()
    parameters, fit = refitting(case.model)(here.case.parameters.with_free((*FREE, added.amplitude.name)), "with the file")
    assert fit.converged
    return parameters[added.amplitude.name], case, parameters


def test_nothing_planted_is_nothing_unlisted(tmp_path: Path) -> None:
    assert [found_in(case_of(tmp_path, seed))[1] for seed in range(3)] == [None] * 3


def test_a_pulse_of_heat(tmp_path: Path) -> None:
    """A drift of the camera resembles it and is taken back; window, power per volume, and a file that loads, fits to a scale of one and
    takes the misfit to the noise."""
    case = case_of(tmp_path, 1, pulse=True)
    refit = refitting(case.model)
    parameters, fit = refit(case.parameters, "joint")
    first = close_loop(replace(case, parameters=parameters), fit, refit, 3, None)
    closed, found = ended(first, refit, None, "auto")
    here = closed.last
    assert "ir_drift" in first.accepted and closed.accepted == ()
    assert found is not None and found.channel == "dtheta" and found.place is not None
    said = summary_of(here, found, None)
    assert said["where"] == {"record": "pull"} and said["unit"] == "mW/mm^3"
    assert found.field is not None and other_kinds(here.case, found.structure, found.field) == []  # no other history is weighed beside it
    assert said["when_s"] == pytest.approx(PULSE, abs=3.0)
    assert said["mean_in_window"] == pytest.approx(POWER, rel=0.15)
    assert said["after"]["held_out"]["dtheta"] < 0.5 * said["before"]["held_out"]["dtheta"]
    amount, again, parameters = amount_of_file(tmp_path, here, found, lambda: case_of(tmp_path, 1, pulse=True))
    assert amount == pytest.approx(1.0, abs=0.1)
    rows = here.rows.channel == here.case.channels.index("dtheta")
    assert np.mean(again.model.residual(parameters)[rows] ** 2) < 1.3 < 0.25 * np.mean(here.columns.residual[rows] ** 2)


def test_a_bump_of_the_yield_stress(tmp_path: Path) -> None:
    """The missing stress is a table over Lambda, and the file holds it."""
    here, found = found_in(case_of(tmp_path, 2, bump=True))
    assert found is not None and found.channel == "stress" and found.field is not None
    file = effect_file("a test", here, found)
    assert file is not None and "accumulated plastic strain" in file.words
    assert file.proof.gain > 0.5 * found.field.proof.gain > 0.2
    path = tmp_path / f"{file.name}.py"
    path.write_text(file.text, encoding="utf-8")
    act = load_effect(path).act
    inside, outside = (act(v, 1e-3, 293.0, None, 1.0) for v in (np.mean(BUMP), 0.5 * BUMP[0]))
    root = np.sqrt(TRUTH["F"] + TRUTH["H"])
    assert inside - outside == pytest.approx(10.0 * root * 1.04, rel=0.3)
    assert act(0.03, 1e-3, 293.0, None, 0.0) == 0.0
    assert act(0.03 + 1e-30j, 1e-3, 293.0, None, 1.0).imag != 0.0


@pytest.mark.parametrize("late", [1.2, -0.8])
def test_a_clock_that_runs_slow_or_fast(tmp_path: Path, late: float) -> None:
    """An error of it that grows over the test, which no effect of the catalogue has: told as such with its amount and as a file, and not as
    a heat, which a free power over time could always make of it."""
    case = case_of(tmp_path, 4, late=late)
    here, found = found_in(replace(case, known=tuple(e for e in case.known if e.name != "ir_lag")))
    assert found is not None and found.channel == "dtheta" and found.field is not None and found.place is not None
    assert found.field.basis.kind == "clock"
    said = summary_of(here, found, None)
    assert said["kind"] == "error of the clock of temperatures" and said["unit"] == "s" and said["where"] == {"record": "pull"}
    history = np.interp([30.0, 60.0, 90.0], said["over_time"]["time_s"], said["over_time"]["value"])
    assert history == pytest.approx(late * np.array([0.25, 0.5, 0.75]), abs=0.25)
    assert said["after"]["held_out"]["dtheta"] < 0.5 * said["before"]["held_out"]["dtheta"] + 0.5 * 0.01
    file = effect_file("a test", here, found)
    assert file is not None and "clock" in file.words
    assert amount_of_file(tmp_path, here, found, lambda: case_of(tmp_path, 4, late=late))[0] == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(("times", "seed"), [(3.0, 1616402), (10.0, 1616300)])
def test_a_clock_whose_error_has_no_sum_in_any_block(scripts: Any, times: float, seed: int) -> None:
    """Three times the smallest error that can be seen, where loads reverse within each block. Ten times, where the misfit looks like noise
    with a long memory: nothing had been said at seven times the noise."""
    row = scripts("operating_run").run_one("point", {"driver": "point", "kind": "ir_clock", "times": times, "knocked": True, "seed": seed})
    assert "ir_clock" in row["without"]
    assert row["accepted"] == [] and row["unlisted"] == "dtheta"


def test_a_misfit_of_cycles_that_no_term_takes_is_told(scripts: Any) -> None:
    """Elastic moduli that fall with flow, ten times the smallest that can be seen, and no effect like it in the catalogue. A stress over
    time turns with every reversal, so that held-out blocks ask for none. At four times the noise the loop had said nothing."""
    run = {"driver": "point", "kind": "elastic_degradation", "times": 10.0, "knocked": True, "seed": 1410301}
    row = scripts("operating_run").run_one("point", run)
    assert row["without"] == ["elastic_degradation"] and row["programme"] == "cycles"
    assert row["accepted"] == [] and row["unlisted"] == "stress" and row["where"] == {}
    assert row["after"]["stress"] > 3.0


def test_an_effect_that_a_law_over_the_state_does_not_need_only_resembled_it(scripts: Any) -> None:
    """A law of the rate, ten times the smallest that can be seen, and none in the catalogue: a yield stress that is another one under
    compression takes half of it, for the test flows back slowly. Beside a law over the rate it is not needed."""
    run = {"driver": "point", "kind": "rate_logarithmic", "times": 10.0, "knocked": True, "seed": 1602305}
    row = scripts("operating_run").run_one("point", run)
    assert row["without"] == ["rate_logarithmic", "rate_power"]
    assert row["accepted"] == [] and "tension_compression" in row["dropped"] and row["unlisted"] == "stress"


def test_what_accepted_effects_leave_stands_beside_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The residual of the base model says how much of it that is; none is asked of where nothing was accepted."""
    case = case_of(tmp_path, 1)
    refit = refitting(case.model)
    parameters, fit = refit(case.parameters, "joint")
    plain = close_loop(replace(case, parameters=parameters), fit, refit, 3, None)
    asked: list[Any] = []
    found = _Replaceable(None, "", (), ())

    def unlisted_there(*given: Any) -> Any:
        asked.append(given[3])
        return found

    monkeypatch.setattr(unlisted_loop, "unlisted", unlisted_there)
    monkeypatch.setattr(unlisted_loop, "in_their_stead", lambda *_, **__: ())
    for accepted in ((), ("ir_drift",)):
        _, said = ended(replace(plain, accepted=accepted), refit, None, "auto")
        assert said is not None and said.beside == accepted
    assert asked[0] is None and np.array_equal(asked[1], plain.first.columns.residual)


@dataclass(frozen=True)
class _Replaceable:
    """What the end of the loop asks of something unlisted."""

    field: Any
    remark: str
    resembles: tuple[str, ...]
    beside: tuple[str, ...]
    law: Any = None
    spot: Any = None
