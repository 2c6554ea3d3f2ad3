"""What was declared counts in the trace and in the loop: an amplitude that no error of a reading explains is refused, with the sentence."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from refits import fitted, refitting
from seen_field import case_of

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.before_after import before_after
from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.prepared import Prepared
from thermofit.diagnose.trace import Traced, traced
from thermofit.experiment.model import Prior
from thermofit.fit.result import FitResult
from thermofit.report.findings import diagnosis_summary
from thermofit.study.section import MeshSize

RATE = "ir_drift.rate"
PLANTED = 2e-3


def declared(seed: int, sigma: float | None) -> tuple[Traced, Closed]:
    """All effects traced, and the loop on a catalogue of the drift alone, which was declared to be none with that standard error."""
    case = case_of(seed, **{RATE: PLANTED})
    model = case.model if sigma is None else replace(case.model, priors=(Prior(RATE, 0.0, sigma),))
    refit = refitting(model)
    parameters, fit = refit(case.parameters, "joint")
    here = Case(model, parameters, case.known, case.spans, case.instruments)
    return traced(here), close_loop(replace(here, known=case.known[:1]), fit, refit, 3, None)


def of_drift(here: Traced):  # type: ignore[no-untyped-def]
    return next(s for s in here.ranking.scores if s.effect == "ir_drift")


def test_estimate_is_drawn_to_what_was_declared() -> None:
    """One step with a prior: the mean of estimate and declared value, each with the weight of its own error."""
    free, held = of_drift(declared(3, None)[0]), of_drift(declared(3, 1e-5)[0])
    here = declared(3, None)[0]
    s = here.problem.model.sensitive(here.problem.dormant["ir_drift"][1])
    weight = float((s * s).sum())
    assert held.estimate[RATE] == pytest.approx(free.estimate[RATE] * weight / (weight + 1e10), rel=1e-6)
    assert held.detectability == pytest.approx(free.detectability), "a prior is no datum by which the test would feel it"


def test_an_amplitude_within_the_error_of_the_reading_is_accepted() -> None:
    _, found = declared(3, PLANTED / 2.0)
    assert found.accepted == ("ir_drift",)


@pytest.mark.parametrize("times", [8.0, 40.0])
def test_an_amplitude_far_off_what_was_declared_is_refused_with_the_sentence(times: float) -> None:
    here, found = declared(3, PLANTED / times)
    assert found.accepted == ()
    score = of_drift(here)
    assert score.z > here.ranking.threshold
    said = here.why_not(score)
    assert "ir_drift.rate would be" in said and "off the declared 0 K/s" in said and "diagnosis.priors" in said
    assert all("ir_drift" not in s.family[1:] for s in here.ranking.scores), "what cannot be is in nobody's family"


def test_the_refit_is_judged_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect that one step did not take so far off is refused by where its refit ends."""
    monkeypatch.setattr("thermofit.diagnose.trace.improbable", lambda *_: "")
    _, found = declared(3, PLANTED / 8.0)
    trial = found.rounds[0].trials[0]
    assert found.accepted == () and trial.score.effect == "ir_drift"
    assert trial.refused.startswith("ir_drift.rate would be") and "8 times the standard error of 0.00025 K/s" in trial.refused


def leaning() -> Closed:
    """The loop on a drift and an effect that nobody knows, for which the drift and a reading (here of the conductivity) stand in."""
    case = case_of(3, **{RATE: 5e-4, "ir_emissivity.slope": 1.0})
    model = replace(case.model, priors=(Prior("kappa", 120.0, 0.003),))
    refit = refitting(model)
    parameters, fit = refit(case.parameters, "joint")
    return close_loop(Case(model, parameters, case.known[:1], case.spans, case.instruments), fit, refit, 3, None)


def test_a_reading_that_stands_in_for_something_else_does_not_refuse_an_effect_that_gains_without_it() -> None:
    found = leaning()
    trial = found.rounds[0].trials[0]
    assert found.accepted == ("ir_drift",) and trial.refused == ""
    assert trial.readings.startswith("with kappa held held-out error falls by 6")
    assert "kappa" in found.last.case.parameters.free, "the reading stays free"
    off = abs(found.last.case.parameters["kappa"] - 120.0) / 0.003
    assert off > 5.0, "beyond what its error explains: it still stands in for what nobody knows"


def test_an_effect_whose_gain_rests_on_a_reading_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("thermofit.diagnose.trial.OWN_GAIN", 0.95)
    found = leaning()
    trial = found.rounds[0].trials[0]
    assert found.accepted == () and trial.refused.startswith("kappa would be ") and "held-out error falls by 6" in trial.readings


def test_a_reading_whose_second_refit_fails_refuses_with_both_reasons() -> None:
    case = case_of(3, **{RATE: 5e-4, "ir_emissivity.slope": 1.0})
    model = replace(case.model, priors=(Prior("kappa", 120.0, 0.003),))
    plain = refitting(model)

    def refit(start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        if label.endswith("readings"):
            raise NumericsError("it broke")
        return plain(start, label)

    parameters, fit = plain(case.parameters, "joint")
    found = close_loop(Case(model, parameters, case.known[:1], case.spans, case.instruments), fit, refit, 3, None)
    assert found.accepted == ()
    assert found.rounds[0].trials[0].refused.endswith("the refit with it held failed (it broke)")


@pytest.mark.parametrize(("times", "said"), [(2.9, False), (3.1, True), (50.0, True)])
def test_a_reading_that_the_joint_fit_drives_off_is_no_trusted_answer(times: float, said: bool) -> None:
    """Three standard errors are the limit, everything else is at its floor. Another declared value, where the fit left it, is not named."""
    case, fit = fitted(case_of(1))
    readings = (Prior("theta_air", 297.4, 0.1), Prior("theta_clamp", 296.7, 0.1))
    there = case.parameters.replace(theta_air=297.4 - 0.1 * times, theta_clamp=296.75)
    here = traced(replace(case, model=replace(case.model, priors=readings), parameters=there))
    refit = cast(Any, SimpleNamespace(failures=[]))
    found = Prepared(here.case, fit, refit, np.zeros(len(here.rows.time)), MeshSize(n_x=1, n_y=1, n_z=1))
    summary = diagnosis_summary(found, here)
    assert summary["trustworthy"] is not said and len(summary["doubts"]) == int(said)
    if said:
        (sentence,) = summary["doubts"]
        assert sentence.startswith("theta_air ends at ") and f", {times:.0f} times the standard error of 0.1 K off the declared" in sentence
        assert sentence in summary["remarks"] and sentence in summary["verdict"]


@pytest.mark.parametrize("taken", [True, False])
def test_an_error_of_the_mesh_that_the_parameters_have_taken_up_is_no_part_of_the_floor(taken: bool) -> None:
    """The residual is 1.7 times the noise; the mesh may leave an error of 1.7 times the noise, and only one that no parameter can make is
    left."""
    case, fit = fitted(case_of(1))
    plain = traced(case)
    column = plain.columns.fitted[:, 0] if taken else np.random.default_rng(7).normal(size=len(plain.rows.time))
    error = column * 1.7 * np.sqrt(len(column)) / np.linalg.norm(column)
    loud = replace(plain.columns, residual=1.7 * plain.columns.residual)
    here = replace(traced(case, error), columns=loud)
    assert here.answered is not taken
    refit = cast(Any, SimpleNamespace(failures=[]))
    summary = diagnosis_summary(Prepared(here.case, fit, refit, error, MeshSize(n_x=1, n_y=1, n_z=1)), here)
    assert summary["trustworthy"] is not taken
    told = np.array([row["numerical"] for row in summary["lack_of_fit"]])
    assert np.all(told < 1e-9) if taken else np.all(told > 2.0)
    table = before_after(here, here)["after"]
    assert all((value < 1e-6 * table["floor"][c]) is taken for c, value in table["numerical"].items())


def test_rows_of_priors_do_not_make_an_effect_felt() -> None:
    """What only its prior knows is unfelt."""
    case = case_of(1)
    blind = replace(case.model, priors=(Prior("ir_gain.gain", 0.0, 0.1), Prior(RATE, 0.0, 1.0)))
    here = traced(Case(blind, case.parameters, case.known, case.spans, case.instruments))
    columns = here.problem
    dead = np.zeros_like(columns.dormant["ir_drift"][1])
    dead[-1] = 1.0
    assert columns.model.sensitive(dead).shape[1] == 0 and columns.model.sensitive(columns.dormant["ir_drift"][1]).shape[1] == 1
