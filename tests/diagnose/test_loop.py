"""The loop on a model of few numbers: what is planted is found, proved, added; nothing is added where nothing is."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import before_after, close_loop, ranking_rows
from thermofit.diagnose.structure import Span
from thermofit.effects.catalogue import effect
from thermofit.fit.covariance import covariance
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult
from thermofit.fit.settings import Settings
from thermofit.identify.model import StageModel
from thermofit.identify.prediction import Errors
from thermofit.measure.comparison import plain
from thermofit.measure.observation import FieldObservation

N_T, N_S, SIGMA = 80, 30, 0.02
TIME = np.linspace(0.0, 120.0, N_T)
Y = np.linspace(-20.0, 20.0, N_S)
KNOWN = tuple(effect(name) for name in ("ir_drift", "ir_gain", "ir_emissivity"))
BASE = Parameters.of({"kappa": 120.0, "c0": 2.3})


def field(p: Parameters) -> np.ndarray:
    """A temperature (n_t, n_s) that depends on two parameters of the law and, bluntly, on three instruments."""
    warm = 300.0 / p["c0"] * (1.0 - np.exp(-TIME / 30.0))[:, None] * (1.0 - (Y / (0.3 * p["kappa"])) ** 2)
    seen = 297.0 + warm * (1.0 + p["ir_gain.gain"]) + p["ir_drift.rate"] * TIME[:, None]
    return np.asarray(seen + p["ir_emissivity.slope"] * 0.002 * (TIME[:, None] / 120.0) ** 3 * (1.0 + Y / 40.0) * warm)


def case_of(seed: int, **planted: float) -> Case:
    random = np.random.default_rng(seed)
    value = field(BASE.replace(**planted)) + SIGMA * random.normal(size=(N_T, N_S))
    xy = np.stack([np.zeros(N_S), Y], axis=1)
    shape = (N_T, N_S, 1)
    seen = FieldObservation("theta", TIME, xy, value[:, :, None], np.full(shape, SIGMA), np.ones(shape[:2], dtype=bool), "K")

    def errors(p: Parameters) -> Errors:
        return {"theta": field(p)[:, :, None] - seen.value}

    def linearise(p: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        columns = []
        for name in names:
            h = 1e-5 * param(name).scale
            columns.append((field(p.replace(**{name: p[name] + h})) - field(p.replace(**{name: p[name] - h}))) / (2.0 * h))
        return errors(p), {"theta": np.stack(columns, axis=-1)[:, :, None, :]}

    model = StageModel(errors, (plain(seen),), {"theta": seen}, "", linearise=linearise)
    instruments = frozenset(name for e in KNOWN for name in e.names)
    spans = (Span("loading", 0.0, 60.0), Span("cooling", 60.0, 120.0))
    return Case(model, BASE.with_free(("kappa", "c0")), KNOWN, spans, instruments)


def refitting(model: StageModel):  # type: ignore[no-untyped-def]
    def refit(start: Parameters, label: str) -> tuple[Parameters, FitResult]:
        names = start.free
        problem = Problem(
            lambda x: model.residual(start.with_vector(x)),
            start.vector(),
            np.array([param(n).lower for n in names]),
            np.array([param(n).upper for n in names]),
            np.array([param(n).scale for n in names]),
            names,
            lambda x: model.linearised(start.with_vector(x), names),
        )
        fit = minimise(problem, "least-squares", Settings(f_tolerance=0.01))
        spread = covariance(fit.jacobian, fit.residual, names, fit.at_bound)
        from dataclasses import replace

        return start.with_vector(fit.x), replace(fit, covariance=spread, sigma=spread.sigma)

    return refit


def closed(seed: int, **planted: float):  # type: ignore[no-untyped-def]
    case = case_of(seed, **planted)
    refit = refitting(case.model)
    parameters, fit = refit(case.parameters, "joint")
    here = Case(case.model, parameters, case.known, case.spans, case.instruments)
    return close_loop(here, fit, refit, 3, None)


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
    rows = ranking_rows(found.first, found.accepted)
    assert rows[0]["effect"] == "ir_drift" and rows[0]["accepted"]


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
