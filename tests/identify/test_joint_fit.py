"""The joint fit of a diagnosis on a small body: by parts, with exponents looked for, held where the data do not determine them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from virtual_pulls import SIZE, TRUTH, pulled, study

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import refit
from thermofit.diagnose.refit import EXPONENTS, JointFit, failed_in_words
from thermofit.experiment.fields import Measured
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.observe.comparison import plain
from thermofit.observe.observation import FieldObservation
from thermofit.records.staging import Job
from thermofit.study.study import Study

RATE = {"rate_logarithmic.C": 0.02, "rate_logarithmic.reference": 1e-3}
BASIC = ("M_y0", "M_yinf", "c0")
STARTS = {**{n: v for n, v in TRUTH.items() if not n.startswith("theta")}, "M_y0": 134.0, "c0": 2.6}


@lru_cache(maxsize=1)
def case() -> Study:
    return study("stages: {plastic: {method: gauss-newton}}\n", STARTS)


@lru_cache(maxsize=1)
def data() -> Measured:
    return pulled(RATE)


def fit_of(tmp_path: Path, free: tuple[str, ...], *, by_parts: bool = True) -> JointFit:
    settings = joint_settings(case(), free, data())
    joint = Joint(case(), data(), settings, SIZE)
    job = Job("close-loop", tmp_path / "close-loop.h5", {}, {})
    return JointFit(case(), settings, joint.model, job, parts=joint if by_parts else None)


def start(free: tuple[str, ...], **values: float) -> Parameters:
    return Parameters.of({**TRUTH, "M_y0": 134.0, "c0": 2.6, **values}, free)


def test_parts_lead_to_the_optimum_of_all_together(tmp_path: Path) -> None:
    """Displacements alone, then temperatures alone on their motion: what they leave, the joint fit does in few coupled runs."""
    there, fit = fit_of(tmp_path / "parts", BASIC)(start(BASIC, **RATE), "joint")
    plain, straight = fit_of(tmp_path / "whole", BASIC, by_parts=False)(start(BASIC, **RATE), "joint")
    assert fit.converged and fit.sigma is not None and fit.names == BASIC
    assert fit.f == pytest.approx(straight.f, rel=2e-4) and fit.counts.forward <= straight.counts.forward
    for name, sigma in zip(BASIC, fit.sigma, strict=True):
        assert abs(there[name] - plain[name]) < 0.3 * sigma and abs(there[name] - TRUTH[name]) < 4.0 * sigma, name


@pytest.mark.parametrize("both", [False, True])
def test_the_first_fit_of_temperatures_begins_twice(tmp_path: Path, both: bool) -> None:
    """From an optimum one start is enough, but where that may be the wrong one of two."""
    joint = replace(fit_of(tmp_path, BASIC), both_starts=both)
    there, _ = joint(start(BASIC, **RATE), "joint")
    joint(there, "again")
    folders = [p.name for p in tmp_path.glob(".close-loop*")]
    assert any("again_temperatures_0" in name for name in folders)
    assert any("again_temperatures_1" in name for name in folders) is both


def test_the_motion_is_that_of_the_displacements_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What temperatures feel stays, however wrong; the rest is the optimum of the displacements. The same is not fitted twice."""
    fitting = fit_of(tmp_path, BASIC)
    begin = start(BASIC, **RATE, beta=0.2)
    found = fitting.moved(begin)
    assert found["c0"] == 2.6 and found["beta"] == 0.2 and found.free == BASIC
    model = fitting.parts.mechanics if fitting.parts is not None else None
    assert model is not None and found["M_y0"] == pytest.approx(TRUTH["M_y0"], rel=2e-3)
    rests, moved = (float(np.sum(model.residual(p) ** 2)) for p in (begin, found))
    assert moved < 0.5 * rests and moved == pytest.approx(sum(c.n for c in model.comparisons), rel=0.1)
    monkeypatch.setattr(JointFit, "minimised_on", None)
    assert fitting.moved(begin) == found
    assert fit_of(tmp_path / "whole", BASIC, by_parts=False).moved(begin) is begin


@pytest.mark.parametrize(("amplitude", "reference"), [(0.01, 1e-5), (0.002, 1e-6)])
def test_an_exponent_is_looked_for_before_all_are_fitted(tmp_path: Path, amplitude: float, reference: float) -> None:
    """From a reference rate two or three decades off the search over its scan comes to the planted one, and the amplitude with it. A fit
    at its next value that began where the one before has ended would stop there: the search ended at 1e-6."""
    free = (*BASIC, *RATE)
    begin = start(free, **{"rate_logarithmic.C": amplitude, "rate_logarithmic.reference": reference})
    joint = fit_of(tmp_path, free)
    found, fit = joint(begin, f"rate_logarithmic reference{EXPONENTS}", exponents=True)
    folders = [p.name for p in tmp_path.glob(".close-loop*")]
    assert any("rate_logarithmic_reference_1_0" in name for name in folders), folders
    truth = joint.model.residual(Parameters.of({**TRUTH, **RATE}))
    assert fit.f < float(truth @ truth) * 1.001
    assert 1e-4 < found["rate_logarithmic.reference"] < 1e-2 and 0.005 < found["rate_logarithmic.C"] < 0.1


def test_an_exponent_that_does_not_settle_is_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The others are fitted with it at the value that it has come to; it is no longer among the fitted ones."""
    monkeypatch.setattr(refit, "EXPONENT_EVALUATIONS", 2)
    monkeypatch.setattr(JointFit, "approached", lambda self, start, label: start)
    free = (*BASIC, *RATE)
    joint = fit_of(tmp_path, free)
    begin = start(free, **{"rate_logarithmic.C": 0.01, "rate_logarithmic.reference": 1e-5})
    found, fit = joint(begin, f"rate_logarithmic reference{EXPONENTS}", exponents=True)
    assert fit.names == found.free == (*BASIC, "rate_logarithmic.C")
    assert fit.sigma is not None and len(fit.sigma) == 4 and np.all(np.isfinite(fit.sigma))
    assert fit.f <= float(np.sum(joint.model.residual(begin) ** 2))


def failing(fails: Any) -> StageModel:
    """A model of c0 and M_y0 in numpy that does not run where `fails` says so."""
    xy, value = np.zeros((1, 2)), np.linspace(1.0, 2.0, 9)[:, None, None]
    ones = np.ones(value.shape)
    seen = FieldObservation("theta", np.arange(9.0), xy, 2.0 * value + 130.0, 0.01 * ones, np.ones((9, 1), dtype=bool), "K")

    def errors(p: Parameters) -> Errors:
        if fails(p):
            raise NumericsError("the specimen cannot carry the force")
        return {"theta": p["c0"] * value + p["M_y0"] - seen.value}

    def linearise(p: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        columns = {"c0": value, "M_y0": ones}
        return errors(p), {"theta": np.stack([columns.get(n, 0.0 * ones) for n in names], axis=-1)}

    return StageModel(errors, (plain(seen),), {"theta": seen}, "", linearise=linearise)


def test_a_start_that_fails_is_counted_and_named(tmp_path: Path) -> None:
    """Temperatures start twice, an exponent is looked for from several amplitudes: one that fails is told of."""
    cold = failing(lambda p: abs(p["c0"] - 2.6) < 1e-9)  # the study's first value
    weak = failing(lambda p: p["rate_logarithmic.C"] < 0.015)
    history = SimpleNamespace(points=[SimpleNamespace(accumulated=np.array([[0.01 * k]])) for k in range(3)], time=np.arange(3.0))
    parts = SimpleNamespace(mechanics=weak, heat=lambda _: cold, histories=lambda _: (history,))
    free = ("M_y0", "c0", "rate_logarithmic.reference")
    job = Job("close-loop", tmp_path / "close-loop.h5", {}, {})
    joint = JointFit(case(), joint_settings(case(), free, data()), failing(lambda p: False), job, parts=parts)  # type: ignore[arg-type]
    found, _ = joint(start(free, c0=2.1, **{**RATE, "rate_logarithmic.C": 0.01}), "slope")
    assert found["c0"] == pytest.approx(2.0, abs=0.1)
    assert any(text.startswith("slope temperatures 1: the start failed (") for text in joint.failures)
    assert any("amplitude times 1: the start failed" in text and "rate_logarithmic.reference = 0.001" in text for text in joint.failures)
    (said,) = failed_in_words(joint.failures)
    assert said.startswith(f"{len(joint.failures)} of the starts of refits failed") and failed_in_words([]) == []
