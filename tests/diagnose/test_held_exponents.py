"""Held exponents: as if they were fitted beside a prior, and no more than that."""

from __future__ import annotations

from dataclasses import make_dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_bodies import NOMINAL

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.held_exponents import in_doubt, more_general, spread_of, with_held_exponents
from thermofit.effects.catalogue import EFFECTS, Effect, effect
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult
from thermofit.law.page import law_of

RATE = np.geomspace(1e-4, 1e-2, 300)
NAMES = ("M_y0", "rate_power.K")
EXPONENT = "rate_power.m"


def stress(x: np.ndarray) -> np.ndarray:
    """M_y0 + K ((1 + rate / 1e-3)^m - 1), MPa, by (M_y0, K, m)."""
    return np.asarray(x[0] + x[1] * ((1.0 + RATE / 1e-3) ** x[2] - 1.0))


def column(x: np.ndarray, k: int) -> np.ndarray:
    return np.asarray(stress(x + 1e-30j * np.eye(3)[k]).imag / 1e-30)


def fitted(at_bound: tuple[bool, bool] = (False, False)) -> tuple[FitResult, LinearModel]:
    """The optimum of noise of 1 MPa with m held at 0.2."""
    noise = np.random.default_rng(4).normal(size=RATE.size)
    truth = np.array([100.0, 20.0, 0.2])

    def residual(y: np.ndarray) -> np.ndarray:
        return np.asarray(stress(np.append(y, 0.2)) - stress(truth) - noise)

    infinite = np.full(2, np.inf)
    fit = minimise(Problem(residual, truth[:2], -infinite, infinite, np.array([100.0, 5.0]), NAMES))
    columns = np.stack([column(np.append(fit.x, 0.2), k) for k in (0, 1)], axis=1)
    model = LinearModel(fit.residual, columns)
    bound = np.array(at_bound)
    spread = model.covariance(NAMES, bound)
    return replace(fit, jacobian=columns, covariance=spread, sigma=spread.sigma, at_bound=bound), model


@pytest.mark.parametrize("u", [1e-3, 0.05, 50.0])
def test_it_is_as_if_the_exponent_were_fitted_beside_a_prior(u: float) -> None:
    """Against the inverse of the whole normal matrix, and by how much all would move with it; a prior much wider than what the data tell is
    that of a free exponent."""
    fit, model = fitted()
    own = column(np.append(fit.x, 0.2), 2)
    every = np.column_stack([model.columns, own])
    inverse = np.linalg.inv(every.T @ every + np.diag([0.0, 0.0, u**-2]))
    moved = -(inverse @ every.T @ model.residual)[:2]
    exact = inverse[:2, :2] + np.outer(moved, moved)
    assert u < 0.01 or np.all(np.abs(moved) > 1e-2 * np.sqrt(np.diag(inverse)[:2]))
    found = in_doubt(fit, model, u * own[:, None])
    assert found.covariance is not None and fit.covariance is not None and found.sigma is not None
    assert found.covariance.matrix_unit == pytest.approx(exact, rel=1e-8)
    assert found.covariance.correlation_parameters[0, 1] == pytest.approx(exact[0, 1] / np.sqrt(exact[0, 0] * exact[1, 1]), rel=1e-8)
    added = found.covariance.matrix - fit.covariance.matrix
    assert found.sigma**2 == pytest.approx(fit.covariance.sigma**2 + np.diag(added), rel=1e-12)


def test_noise_that_hangs_together_tells_less_of_the_exponent() -> None:
    """Four equal values count as one: the data's part of what is known of it is a quarter."""
    fit, model = fitted()
    own = 5.0 * column(np.append(fit.x, 0.2), 2)[:, None]
    at_rest = replace(model, residual=np.zeros(RATE.size))
    four = replace(at_rest, noise=lambda block: 4.0 * block)
    white, coloured = (in_doubt(fit, m, own).covariance for m in (at_rest, four))
    assert white is not None and coloured is not None and fit.covariance is not None
    added = [c.matrix_unit - fit.covariance.matrix_unit for c in (white, coloured)]
    assert added[1] == pytest.approx(4.0 * added[0], rel=0.01)


def test_a_parameter_at_its_bound_stays_there_and_one_that_is_open_stays_open() -> None:
    fit, model = fitted((False, True))
    own = column(np.append(fit.x, 0.2), 2)[:, None]
    found = in_doubt(fit, model, own)
    assert found.sigma is not None and fit.sigma is not None and fit.covariance is not None
    assert found.sigma[1] == fit.sigma[1] and found.sigma[0] > fit.sigma[0]
    held = replace(fit, covariance=replace(fit.covariance, sigma=np.array([np.inf, 1.0])))
    assert in_doubt(held, model, own).sigma is not None and np.isinf(in_doubt(held, model, own).sigma[0])  # type: ignore[index]


def test_an_exponent_may_be_anywhere_among_the_values_that_are_tried() -> None:
    case: Any = SimpleNamespace(parameters=Parameters.of({"rate_power.m": 0.1, "second_hardening.b": 20.0, "latent_heat.rounding": 0.2}))
    assert spread_of("rate_power.m", case) == pytest.approx(0.1 * np.log(10.0) / np.sqrt(12.0)), "of a size by its logarithm: 0.1 to 1"
    assert spread_of("latent_heat.rounding", case) == pytest.approx(0.1), "a single value: half of its size"


def closed(model: Any, names: tuple[str, ...] = ("rate_power",)) -> Any:
    """A loop that has added a law of the rate whose exponents are held."""
    from thermofit.diagnose.loop import Closed

    fit, linear = fitted()
    parameters = Parameters.of({"rate_power.K": 20.0, "rate_power.m": 0.2, "rate_power.reference": 1e-3, "M_y0": 100.0}, NAMES)
    here: Any = SimpleNamespace(case=SimpleNamespace(parameters=parameters, model=model), problem=SimpleNamespace(model=linear))
    return Closed((), here, here, fit, names, (), None, None)  # type: ignore[arg-type]


def test_the_loop_says_which_intervals_hang_on_what_is_held() -> None:
    asked = []

    def linearised(_: Any, names: tuple[str, ...]) -> Any:
        asked.append(names)
        return None, np.stack([column(np.array([100.0, 20.0, 0.2]), 2), np.zeros(RATE.size)], axis=1)

    found = with_held_exponents(closed(SimpleNamespace(linearised=linearised)))
    assert asked == [(EXPONENT, "rate_power.reference")]
    assert found.fit.sigma[1] > 2.0 * fitted()[0].sigma[1]  # type: ignore[index]
    (said,) = found.remarks
    assert said.startswith("rate_power.m = 0.2, rate_power.reference = 0.001: held") and "most of all rate_power.K +- " in said
    small = SimpleNamespace(linearised=lambda *_: (None, 1e-6 * linearised(None, ())[1]))
    assert with_held_exponents(closed(small)).remarks == (), "nothing hangs on it in the digits that are shown"
    asked.clear()
    nothing = closed(SimpleNamespace(linearised=linearised), ())
    assert with_held_exponents(nothing) is nothing and asked == []


def test_where_their_columns_cannot_be_run_a_remark_says_that_they_count_as_exact() -> None:
    def fails(*_: Any) -> Any:
        raise NumericsError("no equilibrium")

    found = with_held_exponents(closed(SimpleNamespace(linearised=fails)))
    assert found.remarks == ("rate_power.m, rate_power.reference count as exact: the run of their derivatives failed (no equilibrium)",)
    assert found.fit.sigma is not None and found.fit.sigma == pytest.approx(fitted()[0].sigma)


CASE = make_dataclass("CASE", ["parameters", "model", "known"])
SOFTENS = {"thermal_softening.slope": 1e-3, "softening_power.amount": 0.0, "softening_power.exponent": 1.7}


def of_softening(known: tuple[Effect, ...] = (), model: Any = None) -> Any:
    """A case whose yield stress falls in proportion to the temperature; of so few kelvins no power is asked for."""
    return SimpleNamespace(parameters=NOMINAL.replace(**SOFTENS).with_free(NAMES[:1]), known=known, model=model)


def test_a_softening_in_proportion_is_a_power_with_an_exponent_that_is_held() -> None:
    """Where the test is not asked for the power; one per cent of the yield stress per 10 K is a tenth per 100 K."""
    ((there, names),) = more_general(of_softening(), ("thermal_softening",))
    assert names == ("softening_power.exponent",)
    assert (there["thermal_softening.slope"], there["softening_power.exponent"]) == (0.0, 1.0)
    assert there["softening_power.amount"] == pytest.approx(0.1, rel=1e-12)
    law, own, other = law_of(there), effect("thermal_softening"), effect("softening_power")
    for theta in (280.0, 293.15, 310.0):
        before = own.act(0.05, 1e-3, theta, law, 1e-3, 293.15)
        assert other.act(0.05, 1e-3, theta, law, there["softening_power.amount"], 1.0) == pytest.approx(before, rel=1e-9)


@pytest.mark.parametrize("accepted", [("latent_heat",), ("rate_logarithmic",), ("second_hardening",), ()])
def test_other_effects_have_no_such_exponent(accepted: tuple[str, ...]) -> None:
    assert more_general(of_softening(), accepted) == []


@pytest.mark.parametrize(
    "own",
    [replace(effect("modulus_by_temperature"), name="made_up"), replace(effect("thermal_softening"), name="made_up", act=lambda *_: 1.0)],
)
def test_laws_of_other_slots_and_those_that_do_nothing_have_none(own: Effect, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EFFECTS, "made_up", own)
    assert more_general(of_softening(), ("made_up",)) == []


def test_a_power_that_the_test_is_asked_for_is_no_held_exponent() -> None:
    assert more_general(of_softening((effect("softening_power"),)), ("thermal_softening",)) == []


def test_the_loop_holds_what_another_power_would_change() -> None:
    """Beside the exponents of what was accepted."""
    asked = []

    def linearised(parameters: Parameters, names: tuple[str, ...]) -> Any:
        asked.append((parameters["softening_power.amount"], names))
        return None, np.stack([RATE / RATE.max()] * len(names), axis=1)

    one = closed(None, ("rate_power", "thermal_softening"))
    softens = NOMINAL.replace(**SOFTENS, **{n: one.last.case.parameters[n] for n in (EXPONENT, "rate_power.reference")})
    one.last.case = CASE(softens.with_free(NAMES), SimpleNamespace(linearised=linearised), ())
    found = with_held_exponents(one)
    assert asked == [(0.0, (EXPONENT, "rate_power.reference")), (pytest.approx(0.1), ("softening_power.exponent",))]
    assert found.fit.sigma[0] > fitted()[0].sigma[0]  # type: ignore[index]
    assert "softening_power.exponent = 1: held" in found.remarks[0]


def test_the_whole_loop_asks_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    from thermofit.diagnose import whole_loop

    monkeypatch.setattr(whole_loop, "close_loop", lambda *_: SimpleNamespace(numerical=None, refit=None))
    monkeypatch.setattr(whole_loop, "ended", lambda one, *_: (one, None))
    monkeypatch.setattr(whole_loop, "with_stand_ins", lambda one: one)
    monkeypatch.setattr(whole_loop, "with_combined", lambda _: "combined")
    monkeypatch.setattr(whole_loop, "with_held_exponents", lambda one: f"{one} beside exponents")
    monkeypatch.setattr(whole_loop, "with_held_law", lambda one, missing: f"{one} and a law beside {missing}")
    monkeypatch.setattr(whole_loop, "with_other_forms", lambda one, how: f"{one} or another ({how})")
    monkeypatch.setattr(whole_loop, "with_form_of_heat", lambda one: f"{one} and a heat")
    monkeypatch.setattr(whole_loop, "with_pulled", lambda one: f"{one} pulled")
    monkeypatch.setattr(whole_loop, "with_slowest_rate", lambda one: f"{one} to the slowest rate")
    monkeypatch.setattr(whole_loop, "with_exchanged", lambda one: f"{one}, exchanged")
    monkeypatch.setattr(
        whole_loop, "with_quiet", lambda one, missing: SimpleNamespace(said=f"{one}, quiet beside {missing}", last="the end", budget=2)
    )
    monkeypatch.setattr(whole_loop, "beside_source", lambda here, missing, budget: (here, missing, budget))
    study: Any = SimpleNamespace(diagnosis=SimpleNamespace(held_out="auto", max_effects=2))
    found: Any = SimpleNamespace(case=None, fit=None, refit=None, numerical=None)
    looped: Any = whole_loop.looped(study, found)
    assert looped.beside == ("the end", None, 2) and (
        looped.closed.said
        == "combined beside exponents and a law beside None or another (auto) and a heat pulled to the slowest rate, exchanged, "
        "quiet beside None"
    )
