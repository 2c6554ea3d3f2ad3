"""Unlisted effects of coupons: a pulse of heat and a bump of the yield stress that the catalogue does not know, and files of both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from record_case import BUMP, FREE, POWER, PULSE, TRUTH, case_of
from refits import refitting

from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import close_loop
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import Unlisted, unlisted
from thermofit.diagnose.unlisted_loop import ended
from thermofit.effects.catalogue import load_effect
from thermofit.report.unlisted import effect_file, summary_of


def found_in(case: Case) -> tuple[Traced, Unlisted | None]:
    parameters, fit = refitting(case.model)(case.parameters, "joint")
    assert fit.converged
    here = traced(replace(case, parameters=parameters))
    return here, unlisted(here, None, [s.effect for s in here.promising()])


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
    assert said["when_s"] == pytest.approx(PULSE, abs=3.0)
    assert said["mean_in_window"] == pytest.approx(POWER, rel=0.15)
    assert said["after"]["held_out"]["dtheta"] < 0.5 * said["before"]["held_out"]["dtheta"]
    file = effect_file("a test", here, found)
    assert file is not None
    path = tmp_path / f"{file.name}.py"
    path.write_text(file.text, encoding="utf-8")
    added = load_effect(path)
    again = case_of(tmp_path, 1, pulse=True)
    parameters, fit = refitting(again.model)(here.case.parameters.with_free((*FREE, added.amplitude.name)), "with the file")
    assert fit.converged and parameters[added.amplitude.name] == pytest.approx(1.0, abs=0.1)
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
