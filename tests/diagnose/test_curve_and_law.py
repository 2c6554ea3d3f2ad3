"""The hardening law beside a curve of any form: temperatures tell what of the sum is stored."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose import curve_and_law
from thermofit.diagnose.curve_and_law import (
    STEPS,
    curve_at,
    fitted_law,
    held_law,
    law_at,
    of_first_yield,
    of_hardening,
    stepped,
    with_the_same_sum,
)
from thermofit.effects.catalogue import effect
from thermofit.fit.linear_model import LinearModel
from thermofit.law.hardening import model2

CURVE = effect("hardening_curve")
NAMES = tuple(p.name for p in CURVE.amplitudes)
LARGEST = 0.16
BETA = 0.79
TRUTH = {"M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "c0": 2.22, "hardening_curve.range": LARGEST}
DRIVEN_OFF = {"M_yinf": 468.0, "H_exp": 4.7, "c0": 1.25}


def dissipation(p: Parameters) -> np.ndarray:
    """D over Lambda of model 2 in monotonic flow, MPa, as the module states it."""
    strain = np.linspace(0.0, LARGEST, curve_and_law.POINTS)
    left = np.exp(-p["H_exp"] * strain)
    h_alpha = (p["M_yinf"] - p["M_y0"]) * (1.0 - left)
    return law_at(p, LARGEST) + curve_at(p, CURVE, LARGEST) - left * ((1.0 - BETA) * p["M_y0"] + h_alpha)


def test_dissipation_beside_a_curve_is_that_of_the_law_and_the_curve() -> None:
    """With no curve it is the slope of what model 2 dissipates (4.22)."""
    numbers = (TRUTH["M_y0"], TRUTH["M_yinf"], TRUTH["H_exp"])
    strain, d = np.linspace(0.0, LARGEST, curve_and_law.POINTS), 1e-6
    alpha = (1.0 - np.exp(-TRUTH["H_exp"] * strain)) / TRUTH["H_exp"]
    after = [model2.hardening_variable(a, d, 1, *numbers)[0] for a in alpha]
    wanted = [model2.dissipated_energy(a, b, d, 1, BETA, *numbers) / d for a, b in zip(alpha, after, strict=True)]
    assert dissipation(Parameters.of(TRUTH)) == pytest.approx(np.array(wanted), rel=1e-4)


def total(p: Parameters) -> np.ndarray:
    """Yield stress of law and curve, MPa."""
    return np.asarray(law_at(p, LARGEST) + curve_at(p, CURVE, LARGEST))


class Bench:
    """A test whose displacements tell the sum of law and curve to 0.05 MPa, and whose temperatures the dissipation over c0 to 0.02."""

    def __init__(self) -> None:
        self.truth = Parameters.of(TRUTH)
        strain = np.linspace(0.0, LARGEST, curve_and_law.POINTS)
        self.onset = 40.0 * np.log(1.0 + np.exp((strain - 0.05) / 0.01)) / 11.0
        self.sum = law_at(self.truth, LARGEST) + self.onset
        self.warm = (dissipation(self.truth) + self.onset) / TRUTH["c0"]
        self.labels: list[str] = []
        self.fails: set[str] = set()

    def residual(self, p: Parameters) -> np.ndarray:
        return np.concatenate([(total(p) - self.sum) / 0.05, (dissipation(p) / p["c0"] - self.warm) / 0.02])

    def columns(self, p: Parameters, names: tuple[str, ...]) -> np.ndarray:
        d = {n: 1e-6 * max(abs(p[n]), 1.0) for n in names}
        both = [(self.residual(p.replace(**{n: p[n] + d[n]})), self.residual(p.replace(**{n: p[n] - d[n]}))) for n in names]
        return np.stack([(up - down) / (2.0 * d[n]) for n, (up, down) in zip(names, both, strict=True)], axis=1)

    def linearised(self, p: Parameters, names: tuple[str, ...]) -> Any:
        return self.residual(p), self.columns(p, names)

    def refit(self, start: Parameters, label: str) -> Any:
        """c0 and the curve by Gauss-Newton, with the law held."""
        self.labels.append(label)
        if label in self.fails:
            raise NumericsError("no equilibrium")
        p, names = start, ("c0", *NAMES)
        for _ in range(8):
            step = LinearModel(self.residual(p), self.columns(p, names)).free_step
            p = p.replace(**{n: p[n] + float(d) for n, d in zip(names, step, strict=True)})
        r = self.residual(p)
        return p, SimpleNamespace(f=float(r @ r), residual=r, jacobian=self.columns(p, names), message="")

    def begun(self) -> Any:
        start = self.truth.replace(**DRIVEN_OFF)
        return self.refit(with_the_same_sum(self.truth, start, CURVE, LARGEST).with_free(("c0", *NAMES)), "begun")


def test_temperatures_bring_a_law_back_that_a_wrong_form_has_driven_off() -> None:
    """From 1.6 times its saturation and 0.43 times its rate, with c0 a fifth off; c0 follows, though only the law was asked."""
    test = Bench()
    begun = test.begun()
    assert begun[0]["c0"] < 0.8 * TRUTH["c0"]
    model: Any = test
    (found, fit), words = fitted_law(begun, CURVE, model, LARGEST, test.refit)
    for name, off in (("M_yinf", 0.01), ("H_exp", 0.02), ("c0", 0.005)):
        assert found[name] == pytest.approx(TRUTH[name], rel=off), name
    assert fit.f < 0.01 * begun[1].f and len(test.labels) < STEPS and test.labels[1] == "hardening_curve law 0"
    assert found["M_y0"] == TRUTH["M_y0"] and words.startswith("M_yinf = 29") and words.endswith(": fitted with it")
    again, words = fitted_law((found, fit), CURVE, model, LARGEST, test.refit)
    assert again[0] is found and words.endswith(": fitted with it"), "at rest it takes no step"


def test_a_law_that_does_not_settle_says_so_and_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    test = Bench()
    model: Any = test
    begun = test.begun()
    test.fails = {f"hardening_curve law {k}" for k in range(STEPS)}
    end, words = fitted_law(begun, CURVE, model, LARGEST, test.refit)
    assert end is begun and words == "M_yinf = 468, H_exp = 4.7: not settled: steps of it cannot be run (no equilibrium)"
    assert test.labels.count("hardening_curve law 0") == len(curve_and_law.PARTS)
    assert fitted_law(begun, CURVE, model, LARGEST, lambda at, _: (at, begun[1]))[1].endswith("not settled: no step of it leaves less")
    monkeypatch.setattr(curve_and_law, "STEPS", 1)
    test.fails = set()
    end, words = fitted_law(begun, CURVE, model, LARGEST, test.refit)
    assert end[1].f < begun[1].f and words.endswith("not settled after 1 steps")

    def no_run(*_: Any) -> Any:
        raise NumericsError("no equilibrium")

    monkeypatch.setattr(test, "linearised", no_run)
    end, words = fitted_law(begun, CURVE, model, LARGEST, test.refit)
    assert end is begun and words.endswith("not settled: the run of its derivatives failed (no equilibrium)")
    bare = (begun[0], SimpleNamespace(f=1.0, jacobian=None, message="the last run failed"))
    assert fitted_law(bare, CURVE, model, LARGEST, test.refit)[1].endswith("has no derivatives (the last run failed)")


def test_steps_are_short_and_keep_the_order_of_the_law() -> None:
    """No number changes by more than a half at once, and M_yinf stays above M_y0."""
    test = Bench()
    begun = test.begun()
    tried: list[Parameters] = []

    def refit(at: Parameters, label: str) -> Any:
        tried.append(at)
        return at, SimpleNamespace(f=np.inf)

    step = {"M_yinf": -2000.0, "H_exp": 5.0}
    assert stepped(begun, step, CURVE, LARGEST, refit, 0) == (None, "")
    for at, part in zip(tried, curve_and_law.PARTS, strict=True):
        assert at["M_yinf"] == pytest.approx(468.0 * curve_and_law.FARTHEST**-part)
        assert total(at) == pytest.approx(total(begun[0]), abs=1.5), "the curve keeps the sum"
    low = (begun[0].replace(M_yinf=150.0), begun[1])
    tried.clear()
    stepped(low, step, CURVE, LARGEST, refit, 0)
    assert [at["M_yinf"] > TRUTH["M_y0"] for at in tried] == [True], "a step below M_y0 is none"


def test_not_where_temperatures_are_not_fitted_or_the_law_has_no_such_number() -> None:
    test = Bench()
    model: Any = test
    begun = test.begun()
    cold = (begun[0].with_free(("E", *NAMES)), begun[1])
    assert fitted_law(cold, CURVE, model, LARGEST, test.refit) == (cold, "")
    bare = (begun[0].replace(M_yinf=0.0, H_exp=0.0), begun[1])
    assert of_hardening(bare[0]) == () and fitted_law(bare, CURVE, model, LARGEST, test.refit) == (bare, "")


def test_numbers_of_first_yield_are_no_numbers_of_hardening() -> None:
    p = Parameters.of(TRUTH)
    assert held_law(p) == ("M_y0", "M_yinf", "H_exp") and of_first_yield(p) == ("M_y0",) and of_hardening(p) == ("M_yinf", "H_exp")
    assert all(param(n).name == n for n in held_law(p))
    rounded = p.replace(M_y0=167.84760355437984, M_yinf=448.3539406852076, H_exp=6.3074919065048)
    assert of_first_yield(rounded) == ("M_y0",), "what rounding makes is no change"
