"""The exponent of an effect is looked for with everything else fitted at each of its values."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose import refit
from thermofit.diagnose.refit import EXPONENTS, JointFit, as_strong, profiled

NAME = "rate_logarithmic.reference"


def searched(best: float, begin: float) -> tuple[Parameters, list[float]]:
    """The search on a bowl in the logarithm with its bottom at `best`, and the values that it tried."""
    tried: list[float] = []

    def at(value: float) -> tuple[float, Parameters]:
        tried.append(value)
        return (np.log10(value) - np.log10(best)) ** 2, Parameters.of({NAME: value})

    return profiled(at, begin, NAME), tried


@pytest.mark.parametrize(("best", "begin"), [(3e-5, 1e-2), (4e-4, 1e-4), (2e-3, 1e-6)])
def test_search_walks_down_the_scan_and_takes_the_vertex(best: float, begin: float) -> None:
    found, tried = searched(best, begin)
    assert found[NAME] == pytest.approx(best, rel=1e-6)
    assert len(tried) == len(set(tried)) <= len(param(NAME).scan) + 1


def test_search_ends_at_the_edge_of_the_scan() -> None:
    assert searched(1e-8, 1e-6)[0][NAME] == pytest.approx(1e-6)


def test_a_value_at_which_the_model_fails_is_passed_over() -> None:
    def at(value: float) -> tuple[float, Parameters]:
        return (float("inf") if value > 1e-3 else abs(np.log(value / 1e-4))), Parameters.of({NAME: value})

    assert profiled(at, 1e-3, NAME)[NAME] == pytest.approx(1e-4)


def test_another_exponent_starts_as_strong_as_before() -> None:
    """The power law of exponent one is linear in the rate: at ten times the reference rate ten times the amplitude does the same."""
    rate = np.geomspace(1e-4, 1e-2, 30)
    flow = (np.full(30, 0.01), rate, np.full(30, 1e-3))
    start = Parameters.of({"rate_power.K": 5.0, "rate_power.m": 1.0, "rate_power.reference": 1e-3})
    moved = as_strong(start, "rate_power.reference", 1e-2, flow, 2)
    assert moved["rate_power.K"] == pytest.approx(50.0, rel=1e-9) and moved["rate_power.reference"] == 1e-2
    weak = Parameters.of({"rate_logarithmic.C": 0.02, NAME: 1e-4})
    there = as_strong(weak, NAME, 1e-3, flow, 2)
    ratio = 0.02 * np.log1p(rate / 1e-4) / (there["rate_logarithmic.C"] * np.log1p(rate / 1e-3))
    assert ratio.min() < 1.0 < ratio.max()


def test_exponents_of_other_slots_leave_the_amplitude() -> None:
    start = Parameters.of({"lamp.absorbed": 0.1, "lamp.start": 5.0})
    flow = (np.array([0.01]), np.array([1e-3]), np.array([1e-3]))
    assert as_strong(start, "lamp.start", 50.0, flow, 2)["lamp.absorbed"] == 0.1


def test_free_names_may_come_from_a_generator() -> None:
    found = Parameters.of({"E": 7e4}, ("E", NAME)).with_free(n for n in ("E", "nu"))
    assert found.free == ("E", "nu")


@pytest.mark.parametrize(
    ("name", "value", "sigma", "vague"),
    [(NAME, 1e-6, 0.4e-6, False), (NAME, 1e-6, 0.6e-6, True), (NAME, 1e-6, np.nan, True), ("lamp.start", 40.0, 30.0, False)],
)
def test_an_exponent_that_the_data_hardly_determine_is_held(name: str, value: float, sigma: float, vague: bool) -> None:
    """Only of those that are logarithms: a time has no size of its own."""
    parameters = Parameters.of({"E": 7e4, name: value}, ("E", name))
    fit: Any = SimpleNamespace(converged=True, names=("E", name), sigma=np.array([1e9, sigma]))
    assert refit.undetermined_exponents(parameters, fit) == ((name,) if vague else ())


@pytest.mark.parametrize("label", ["error of the force", f"rate_logarithmic reference{EXPONENTS}"])
@pytest.mark.parametrize(("cheap", "settles"), [(False, False), (False, True), (True, False)])
def test_exponents_that_do_not_settle_are_held(label: str, cheap: bool, settles: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a run costs something: at the values that they have come to, with all others fitted once more."""
    fits: list[tuple[tuple[str, ...], str]] = []

    def minimised(self: JointFit, start: Parameters, model: Any, name: str, most: int, **_: Any) -> tuple[Parameters, Any]:
        fits.append((start.free, name))
        end = start.replace(**{NAME: 2e-5}) if NAME in start.free else start
        return end, SimpleNamespace(converged=settles or NAME not in start.free, sigma=None)

    monkeypatch.setattr(JointFit, "minimised_on", minimised)
    monkeypatch.setattr(refit, "covariance_of", lambda model, fit: (None, ""))
    model: Any = SimpleNamespace(cheap=cheap)
    fitting = JointFit(*[SimpleNamespace()] * 2, model, SimpleNamespace())  # type: ignore[arg-type]
    start = Parameters.of({"E": 7e4, "rate_logarithmic.C": 0.01, NAME: 1e-4}, ("E", "rate_logarithmic.C", NAME))
    found, fit = fitting(start, label)
    assert found[NAME] == 2e-5
    if cheap or settles:
        assert fits == [(start.free, label)] and found.free == start.free
    else:
        assert fits[1:] == [(("E", "rate_logarithmic.C"), f"{label} held")]
        assert found.free == ("E", "rate_logarithmic.C") and fit.converged


def test_how_well_an_exponent_is_known_is_asked_of_errors_that_know_the_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """White noise would know it to a tenth; as the noise hangs together, the data do not: it is held."""
    fits: list[str] = []

    @dataclass(frozen=True)
    class Fit:
        names: tuple[str, ...]
        sigma: np.ndarray
        converged: bool = True
        covariance: Any = None

    def minimised(self: JointFit, start: Parameters, model: Any, name: str, most: int, **_: Any) -> tuple[Parameters, Any]:
        fits.append(name)
        return start, Fit(start.free, 0.1 * start.vector())

    def spread(model: Any, fit: Fit) -> tuple[Any, str]:
        return SimpleNamespace(sigma=8.0 * fit.sigma), ""

    monkeypatch.setattr(JointFit, "minimised_on", minimised)
    monkeypatch.setattr(refit, "covariance_of", spread)
    model: Any = SimpleNamespace(cheap=False)
    fitting = JointFit(*[SimpleNamespace()] * 2, model, SimpleNamespace())  # type: ignore[arg-type]
    found, fit = fitting(Parameters.of({"E": 7e4, NAME: 1e-4}, ("E", NAME)), "rate")
    assert fits == ["rate", "rate held"] and found.free == ("E",)
    assert fit.sigma is not None and fit.sigma.tolist() == [pytest.approx(5.6e4)]
