"""The backward check: an effect goes where an exponent of another one, held when that was added, makes up for it; else it stays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from refits import refitting
from seen_field import N_T, TIME, Y, case_of

from thermofit.core.parameters import Parameters
from thermofit.diagnose.backward import Means, compensated, still_needed
from thermofit.diagnose.case import Case, Refit
from thermofit.diagnose.trace import Traced, traced
from thermofit.effects.catalogue import effect
from thermofit.fit.result import FitResult

HELD = 60.0
"""Start of the lamp at which the loop holds it, s."""
LAMP, DRIFT = "lamp.absorbed", "ir_drift.rate"


def warmed(start: float) -> np.ndarray:
    """What a lamp that is on from `start` does to the temperature, with a soft beginning."""
    return np.asarray(3.0 * np.logaddexp(0.0, (TIME - start) / 3.0))


GAP = (warmed(45.0) - warmed(HELD)) / 15.0
WAVE = np.sin(np.linspace(0.0, 40.0, N_T))


def at_the_end(monkeypatch: pytest.MonkeyPatch, shape: np.ndarray, **planted: float) -> tuple[Traced, Means, list[str]]:
    """A loop's last state with a lamp whose start is held and an effect of a shape in time accepted before it; labels of later refits."""

    def field(p: Parameters) -> np.ndarray:
        warm = 300.0 / p["c0"] * (1.0 - np.exp(-TIME / 30.0))[:, None] * (1.0 - (Y / (0.3 * p["kappa"])) ** 2)
        return np.asarray(297.0 + warm + (p[LAMP] * warmed(p["lamp.start"]) + p[DRIFT] * shape)[:, None])

    monkeypatch.setattr("seen_field.field", field)
    case = case_of(5, **planted)
    begin = case.parameters.replace(**{"lamp.start": HELD}).with_free(("kappa", "c0", DRIFT, LAMP))
    plain, labels = refitting(case.model), []

    def refit(start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        labels.append(label)
        return plain(start, label)

    parameters, _ = plain(begin, "joint")
    known = (effect("ir_drift"), effect("lamp"))
    here = traced(Case(case.model, parameters, known, case.spans, case.instruments))
    kept: Refit = refit
    return here, Means(kept, None, "auto"), labels


def test_an_effect_that_stood_in_for_a_held_exponent_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    here, means, labels = at_the_end(monkeypatch, GAP, **{LAMP: 0.02, "lamp.start": 45.0})
    assert still_needed(here, "ir_drift"), "with the start held it is missed"
    found = compensated(here, "ir_drift", ["lamp"], means)
    assert found is not None and labels == ["without ir_drift exponents"]
    last, fit = found
    assert last.case.parameters[DRIFT] == 0.0 and DRIFT not in fit.names and fit.converged
    assert last.case.parameters["lamp.start"] == pytest.approx(45.0, abs=1.0)
    assert last.case.parameters[LAMP] == pytest.approx(0.02, rel=0.03)
    assert compensated(replace(here, case=replace(here.case, cheap=True)), "ir_drift", ["lamp"], means) is None


def test_an_effect_that_no_exponent_resembles_is_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    here, means, labels = at_the_end(monkeypatch, WAVE, **{LAMP: 0.02, "lamp.start": HELD, DRIFT: 0.05})
    assert compensated(here, "ir_drift", ["lamp"], means) is None and labels == []
    assert compensated(here, "ir_drift", [], means) is None


def test_an_effect_that_an_exponent_only_resembles_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """A refit is made, and the held-out error rises without the effect."""
    here, means, labels = at_the_end(monkeypatch, 4.0 * GAP + 0.4 * WAVE, **{LAMP: 0.02, "lamp.start": HELD, DRIFT: 0.08})
    assert compensated(here, "ir_drift", ["lamp"], means) is None and labels == ["without ir_drift exponents"]
