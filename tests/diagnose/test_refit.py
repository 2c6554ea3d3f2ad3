"""The exponent of an effect is looked for with everything else fitted at each of its values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.parameters import Parameters, param
from thermofit.core.slots import Slots
from thermofit.diagnose import refit
from thermofit.diagnose.refit import EXPONENTS, WORTH, Fitted, JointFit, as_strong, walked
from thermofit.fit.settings import Settings

NAME = "rate_logarithmic.reference"


def searched(best: float, begin: float, runs: float = np.inf) -> tuple[float, list[float]]:
    """The search on a bowl in the logarithm with its bottom at `best`, and the values that it tried; above `runs` the model fails."""
    tried: list[float] = []

    def at(value: float) -> Fitted:
        tried.append(value)
        way = float(np.log(best / value))
        return Fitted(way**2 if value < runs else np.inf, Parameters.of({NAME: value}), way)

    return walked(at, begin, NAME)[NAME], tried


@pytest.mark.parametrize(("best", "begin", "expected"), [(3e-5, 1e-2, [1e-2, 1e-3, 1e-4]), (3e-4, 1e-6, [1e-6, 1e-5, 1e-4])])
def test_the_search_walks_down_the_scan_until_a_step_stays_within_it(best: float, begin: float, expected: list[float]) -> None:
    """From there a fit with the exponent free goes on; no value on the other side is tried."""
    found, tried = searched(best, begin)
    assert tried == pytest.approx(expected) and found == pytest.approx(expected[-1])


def test_a_value_that_is_near_enough_is_the_only_one() -> None:
    assert searched(2e-4, 1e-4) == (1e-4, [1e-4])


def test_the_search_ends_at_the_edge_of_the_scan() -> None:
    assert searched(1e-9, 1e-6) == (1e-6, [1e-6])


def test_the_search_turns_back_where_a_step_promised_too_much() -> None:
    rises = {1e-4: 1.0, 1e-3: 2.0}
    found = walked(lambda v: Fitted(rises[round(v, 9)], Parameters.of({NAME: v}), 5.0), 1e-4, NAME)
    assert found[NAME] == 1e-4


def test_a_value_at_which_the_model_fails_is_passed_over() -> None:
    found, tried = searched(1e-4, 1e-2, runs=5e-3)
    assert found == pytest.approx(1e-4) and tried == pytest.approx([1e-2, 1e-3, 1e-4])
    tried.clear()
    walked(lambda v: tried.append(v) or Fitted(np.inf, Parameters.of({NAME: v}), 0.0), 1e-4, NAME)  # type: ignore[func-returns-value]
    assert len(tried) == len(param(NAME).scan)


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
    [
        *[(NAME, 1e-6, 0.4e-6, False), (NAME, 1e-6, 0.6e-6, True), (NAME, 1e-6, np.nan, True), ("lamp.start", 40.0, 30.0, False)],
        *[("backstress_first.gamma", 100.0, 60.0, True), ("initial_gradient.tilt", 1.0, 0.9, False)],
        *[("latent_heat.centre", 0.02, 0.015, False), ("second_hardening.b", 60.0, 20.0, False)],
    ],
)
def test_an_exponent_that_the_data_hardly_determine_is_held(name: str, value: float, sigma: float, vague: bool) -> None:
    """Only of positive quantities: a time has no size of its own."""
    parameters = Parameters.of({"E": 7e4, name: value}, ("E", name))
    fit: Any = SimpleNamespace(converged=True, names=("E", name), sigma=np.array([1e9, sigma]))
    assert refit.undetermined_exponents(parameters, fit) == ((name,) if vague else ())


@pytest.mark.parametrize("exponents", [False, True])
@pytest.mark.parametrize(("cheap", "settles"), [(False, False), (False, True), (True, False)])
def test_exponents_that_do_not_settle_are_held(exponents: bool, cheap: bool, settles: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a run costs something: at the values that they have come to, with all others fitted once more."""
    fits: list[tuple[tuple[str, ...], str]] = []
    worths: list[float] = []
    most_of: list[int] = []
    label = f"error of the force{EXPONENTS}"

    def minimised(self: JointFit, start: Parameters, model: Any, name: str, most: int, worth: float = 0.0) -> tuple[Parameters, Any]:
        fits.append((start.free, name))
        most_of.append(most)
        worths.append(worth)
        end = start.replace(**{NAME: 2e-5}) if NAME in start.free else start
        return end, SimpleNamespace(converged=settles or NAME not in start.free, sigma=None, f=110.0)

    monkeypatch.setattr(JointFit, "minimised_on", minimised)
    monkeypatch.setattr(refit, "covariance_of", lambda model, fit: (None, ""))
    model: Any = SimpleNamespace(cheap=cheap, comparisons=[SimpleNamespace(n=60), SimpleNamespace(n=40)])
    fitting = JointFit(SimpleNamespace(slots=Slots()), SimpleNamespace(), model, SimpleNamespace())  # type: ignore[arg-type]
    start = Parameters.of({"E": 7e4, "rate_logarithmic.C": 0.01, NAME: 1e-4}, ("E", "rate_logarithmic.C", NAME))
    found, fit = fitting(start, label, exponents=exponents)
    of_each = refit.EXPONENT_EVALUATIONS if exponents else fitting.at_most
    assert set(most_of) == {of_each * (refit.OFTEN if cheap else 1)}, "whatever the label says"
    assert found[NAME] == 2e-5
    assert worths == [0.0 if cheap else WORTH, 0.0][: len(worths)], "a crawl along the valley of an exponent ends, others do not"
    if cheap or settles:
        assert fits == [(start.free, label)] and found.free == start.free
    else:
        assert fits[1:] == [(("E", "rate_logarithmic.C"), f"{label} held")]
        assert found.free == ("E", "rate_logarithmic.C") and fit.converged


@pytest.mark.parametrize(
    ("drawn", "held", "where"),
    [(500.0, 510.0, 1e-4), (500.0, 2000.0, 2e-5), (115.0, 118.0, 2e-5)],
    ids=["the way explains nothing", "it explains most", "little is left"],
)
@pytest.mark.parametrize("name", [NAME, "lamp.start"])
def test_exponents_that_temperatures_have_drawn_are_held_where_displacements_had_them(
    drawn: float, held: float, where: float, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit that does not settle is made again from its start where temperatures leave more than noise, unless the way explains half of
    what is left from there. Exponents that temperatures alone show are held where it has come to."""
    fits: list[str] = []

    def minimised(self: JointFit, start: Parameters, model: Any, label: str, most: int, worth: float = 0.0) -> tuple[Parameters, Any]:
        fits.append(label)
        if name in start.free:
            return start.replace(**{name: 2e-5}), SimpleNamespace(converged=False, sigma=None, f=drawn)
        return start, SimpleNamespace(converged=True, sigma=None, f=held if start[name] == 1e-4 else drawn)

    monkeypatch.setattr(JointFit, "minimised_on", minimised)
    monkeypatch.setattr(refit, "covariance_of", lambda model, fit: (None, ""))
    model: Any = SimpleNamespace(cheap=False, comparisons=[SimpleNamespace(n=60), SimpleNamespace(n=40)])
    fitting = JointFit(SimpleNamespace(slots=Slots()), SimpleNamespace(), model, SimpleNamespace())  # type: ignore[arg-type]
    found, fit = fitting(Parameters.of({"E": 7e4, name: 1e-4}, ("E", name)), "rate")
    of_motion = name == NAME
    assert found[name] == (where if of_motion else 2e-5) and found.free == ("E",) and fit.converged
    again = of_motion and drawn > 120.0
    assert fits == ["rate", *(["rate held at its start"] if again else []), *([] if again and where == 1e-4 else ["rate held"])]
    assert ((name, 1e-4) in fitting.told) == again, "from there they are not looked for again"


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
    model: Any = SimpleNamespace(cheap=False, comparisons=[SimpleNamespace(n=100)])
    fitting = JointFit(SimpleNamespace(slots=Slots()), SimpleNamespace(), model, SimpleNamespace())  # type: ignore[arg-type]
    found, fit = fitting(Parameters.of({"E": 7e4, NAME: 1e-4}, ("E", NAME)), "rate")
    assert fits == ["rate", "rate held"] and found.free == ("E",)
    assert fit.sigma is not None and fit.sigma.tolist() == [pytest.approx(5.6e4)]


def test_an_exponent_is_looked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a fit with it free has ended, the next one goes on from there; from elsewhere it is looked for, one side of it alone."""
    fits: list[tuple[str, tuple[str, ...], float]] = []
    best = 3e-6

    def minimised(self: JointFit, start: Parameters, model: Any, name: str, *_: Any, **__: Any) -> tuple[Parameters, Any]:
        fits.append((name, start.free, start[NAME]))
        there = start.replace(**{NAME: best}) if NAME in start.free else start
        way = float(np.log(best / there[NAME]))
        n = len(there.free)
        jacobian = np.vstack([np.zeros((1, n)), np.eye(n)])
        fit = SimpleNamespace(
            f=way**2, residual=np.append(-way, np.zeros(n)), jacobian=jacobian, names=there.free, converged=True, sigma=None
        )
        return there, fit

    def linearised(parameters: Parameters, names: tuple[str, ...]) -> tuple[None, np.ndarray]:
        assert names == (NAME,)
        return None, np.array([[1.0 / parameters[NAME]], [0.0], [0.0]])

    flow = (np.array([0.01]), np.array([1e-3]), np.array([1e-3]))
    monkeypatch.setattr(refit, "flow_of", lambda histories: flow)
    monkeypatch.setattr(refit, "covariance_of", lambda model, fit: (None, ""))
    monkeypatch.setattr(JointFit, "minimised_on", minimised)
    model: Any = SimpleNamespace(cheap=False, linearised=linearised)
    parts: Any = SimpleNamespace(mechanics=model, heat=lambda start: None, histories=lambda start: None)
    study: Any = SimpleNamespace(bounds=lambda name: (1e-9, 1e9), slots=Slots())
    fitting = JointFit(study, SimpleNamespace(), model, SimpleNamespace(), parts=parts)  # type: ignore[arg-type]
    start = Parameters.of({"E": 7e4, "rate_logarithmic.C": 0.01, NAME: 1e-4, "theta_ref": 297.0}, ("E", "rate_logarithmic.C", NAME))
    found, _ = fitting(start, f"rate{EXPONENTS}", exponents=True)
    assert [value for _, free, value in fits if NAME not in free] == pytest.approx([1e-4, 1e-5]), "towards its step, and no further"
    assert found[NAME] == best
    fits.clear()
    fitting(found, "lamp")
    assert all(NAME in free for _, free, _ in fits)
    fits.clear()
    fitting(start, "again")
    assert any(NAME not in free for _, free, _ in fits)


@pytest.mark.parametrize(
    ("converged", "square", "n", "starts"), [(False, 1.0, 0.5, 2), (True, 1.1, 0.5, 2), (True, 1.001, 0.5, 1), (False, 1.0, 0.9, 1)]
)
def test_refits_on_a_known_motion_end_where_what_is_left_is_not_worth_it(
    monkeypatch: pytest.MonkeyPatch, converged: bool, square: float, n: float, starts: int
) -> None:
    """Both starts of the temperatures, the second with what the first has reached to beat; the first alone where it began at an optimum, or
    leaves little more than the noise. Fits of all together end by their own rule."""
    asked: list[float] = []
    beaten: list[float] = []

    def ended(problem: Any, method: str, options: Settings, hooks: Any) -> Any:
        assert method == ("trust-region" if options.worth else "least-squares"), "temperatures on a known motion alone"
        asked.append(options.worth)
        beaten.append(options.to_beat)
        return SimpleNamespace(f=1.0, x=np.array([2.2]), converged=converged)

    same: Any = SimpleNamespace(converted=lambda fit: fit)
    monkeypatch.setattr(refit, "minimise", ended)
    monkeypatch.setattr(refit, "stage_problem", lambda study, settings, start, model: (None, same))
    monkeypatch.setattr(refit, "remembering", lambda model: model)
    monkeypatch.setattr(refit, "evaluation_key", lambda job, start: {})
    monkeypatch.setattr(refit, "checkpoint_folder", lambda job, name: name)
    monkeypatch.setattr(refit, "Checkpoint", lambda *_: None)
    warm: Any = SimpleNamespace(comparisons=[SimpleNamespace(n=n)], one_way=True, residual=lambda _: np.array([np.sqrt(square)]))
    study: Any = SimpleNamespace(setting=lambda name: None)
    settings: Any = SimpleNamespace(tolerance=1e-4, method="least-squares", free=("c0",), model_copy=lambda update: settings)
    parts: Any = SimpleNamespace(heat=lambda parameters: warm)
    job: Any = SimpleNamespace(path=Path("close-loop.h5"), stage="close-loop")
    fitting = JointFit(study, settings, warm, job, parts=parts)
    at = Parameters.of({"c0": 2.2}, ("c0",))
    heated = fitting.heated(at)
    assert heated is not None
    assert heated.minimised(at, "lamp on the known motion")["c0"] == 2.2
    together: Any = SimpleNamespace(comparisons=warm.comparisons, one_way=False, cheap=False)
    fitting.minimised_on(at, together, "all together", 12)
    assert asked == [*[WORTH] * starts, 0.0]
    assert beaten == [np.inf, *[1.0] * (starts - 1), np.inf]
