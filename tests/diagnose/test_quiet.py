"""Histories that nothing tells: standard errors hold what they may make of the parameters, and a remark says what is likely."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import thermofit.diagnose.quiet as module
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.quiet import quiet, with_quiet
from thermofit.diagnose.unlisted_field import Basis, roughness
from thermofit.diagnose.unlisted_second import Second
from thermofit.experiment.missing import Grid
from thermofit.fit.budget import NOISE, QUIET, QUIET_EFFECT, Budget
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult

NAMES = ("E", "kappa", "beta")
N, M = 240, 8
DRAW = np.random.default_rng(3)
ROWS = {"du": np.arange(80), "dtheta": np.arange(80, N)}


def hats(kind: str, channel: str) -> Basis:
    """Hats of a kind over time whose columns are smooth, on the rows of a channel."""
    grid = Grid(np.linspace(0.0, 60.0, M), np.zeros(M, dtype=int), np.zeros(1), np.zeros(1))
    columns = np.cumsum(DRAW.normal(size=(len(ROWS[channel]), M)), axis=0) / 5.0
    return Basis(kind, "K", grid, np.arange(M), ROWS[channel], columns, roughness(grid, np.arange(M)))


KINDS = {"du": (hats("scale", "du"), hats("displacement", "du")), "dtheta": (hats("jaw_upper", "dtheta"), hats("heat", "dtheta"))}
HISTORY = np.array([0.0, 0.3, 0.9, 1.4, 1.2, 0.8, 0.5, 0.2])
SIZE = 0.4
CASE: Any = SimpleNamespace(parameters=Parameters.of(dict.fromkeys(NAMES, 1.0), NAMES))
JACOBIAN = np.zeros((N, 3))
JACOBIAN[:80, 0] = DRAW.normal(size=80)
# A conductivity does most of what the history of a jaw does.
JACOBIAN[80:, 1] = KINDS["dtheta"][0].columns @ (HISTORY + np.array([0.5, -0.5, 0.7, -0.5, -0.7, 0.5, 0.5, -0.5]))
JACOBIAN[80:, 2] = DRAW.normal(size=160)


@dataclass(frozen=True)
class Body:
    """What is asked of a case."""

    cheap: bool
    model: Any
    parameters: Parameters


def closed(size: float, seed: int = 5, **case: Any) -> Closed:
    """A joint fit at its optimum, of data to which the history of a jaw has added `size` of its own."""
    residual = np.random.default_rng(seed).normal(size=N)
    residual[80:] += size * KINDS["dtheta"][0].columns @ HISTORY
    start = LinearModel(residual, JACOBIAN)
    at = residual + JACOBIAN @ start.free_step
    spread = LinearModel(at, JACOBIAN).covariance(NAMES, np.zeros(3, dtype=bool))
    spread = replace(spread, matrix=spread.matrix_unit, sigma=spread.sigma_unit)
    made: dict[str, Any] = {"names": NAMES, "residual": at, "jacobian": JACOBIAN, "covariance": spread, "sigma": spread.sigma}
    made |= {"x": start.free_step, "at_bound": np.zeros(3, dtype=bool)}
    fit = FitResult(**{f: made.get(f) for f in FitResult.__dataclass_fields__})  # type: ignore[arg-type]
    own = {"cheap": False, "model": SimpleNamespace(missing=True), "parameters": CASE.parameters}
    problem = SimpleNamespace(model=SimpleNamespace(left=at), dormant={})
    here: Any = SimpleNamespace(case=Body(**own | case), rows=None, problem=problem, ranking=SimpleNamespace(scores=()))
    budget = Budget(NAMES, {NOISE: np.diag(spread.sigma)}, np.zeros(3, dtype=bool))
    return Closed((), here, here, fit, (), (), None, None, budget=budget)  # type: ignore[arg-type]


def test_an_error_of_the_mesh_is_no_history() -> None:
    """What may be left of the mesh's error does the same as a history: nothing is told of that, and the budget has it already."""
    fit = closed(SIZE).fit
    known, structure = LinearModel(fit.residual, JACOBIAN), module.structures(None, None, None, None)[1]  # type: ignore[arg-type]
    mesh = np.zeros((N, 1))
    mesh[80:, 0] = SIZE * KINDS["dtheta"][0].columns @ HISTORY
    bare, beside = (quiet(known, errors, CASE, structure) for errors in (np.zeros((N, 0)), mesh))  # type: ignore[arg-type]
    assert bare is not None and beside is not None and beside.covariance.shape == (3, 3)
    assert bare.likelihood["jaw_upper"] > 0.9 and sum(beside.likelihood.values()) < 0.3
    # Behind a term that is told stand its coefficients and the rows that hold them.
    longer = LinearModel(np.append(fit.residual, 0.0), np.pad(JACOBIAN, ((0, 1), (0, 1))) + np.pad([[1.0]], ((N, 0), (3, 0))))
    assert quiet(longer, mesh, CASE, structure).covariance == pytest.approx(beside.covariance, rel=0.02)  # type: ignore[arg-type, union-attr]


@pytest.fixture(autouse=True)
def _channels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two channels, each with a history and a term of any place."""
    channels = [SimpleNamespace(blocks=SimpleNamespace(channel=name)) for name in KINDS]
    monkeypatch.setattr(module, "structures", lambda *_: channels)
    monkeypatch.setattr(module, "errors_of", lambda *_: np.zeros((N, 0)))
    monkeypatch.setattr(module, "histories", lambda case, one, most: {b.kind: b for b in KINDS[one.blocks.channel][: most == 48]})
    monkeypatch.setattr(module, "broad_basis", lambda case, one: KINDS[one.blocks.channel][1])


def test_a_quiet_history_widens_what_it_moves() -> None:
    before = closed(SIZE)
    after = with_quiet(before, None)
    sigma, wider = before.fit.sigma, after.fit.sigma
    assert sigma is not None and wider is not None and after.budget is not None
    off = after.fit.x[1]
    assert abs(off) > 3.5 * sigma[1], "a conductivity takes it"
    assert wider[1] > 3.0 * sigma[1] and abs(off) < 2.0 * wider[1]
    assert wider[0] < 1.3 * sigma[0], "the other channel shows nothing"
    assert list(after.budget.parts) == [NOISE, QUIET] and after.budget.sigma == pytest.approx(wider)
    assert after.remarks[-1].startswith("intervals hold what a quiet change of the temperature of the upper jaw would make of")
    assert "most of all of kappa +-" in after.remarks[-1]


def test_both_channels_are_asked_and_terms_of_any_place_too(monkeypatch: pytest.MonkeyPatch) -> None:
    known = LinearModel(closed(0.0).fit.residual, JACOBIAN)
    asked = [quiet(known, np.zeros((N, 0)), CASE, one) for one in module.structures(None, None, None, None)]  # type: ignore[arg-type]
    assert [set(found.likelihood) for found in asked if found is not None] == [{"scale", "displacement"}, {"jaw_upper", "heat"}]
    monkeypatch.setattr(module, "histories", lambda *_, **__: {})
    monkeypatch.setattr(module, "broad_basis", lambda *_: None)
    one = closed(SIZE)
    assert quiet(known, np.zeros((N, 0)), CASE, None) is None and with_quiet(one, None) is one  # type: ignore[arg-type]


def _kappa(of: Closed) -> float:
    """The standard error of a conductivity."""
    assert of.fit.sigma is not None
    return float(of.fit.sigma[1])


def test_each_channel_adds_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    added = {"du": np.diag([4.0, 0.0, 0.0]), "dtheta": np.diag([9.0, 1.0, 0.0])}
    monkeypatch.setattr(module, "quiet", lambda known, errors, case, one: Second({}, added[one.blocks.channel]))
    before = closed(0.0)
    after = with_quiet(before, None).fit.sigma
    assert before.fit.sigma is not None and after is not None
    assert after == pytest.approx(np.sqrt(before.fit.sigma**2 + [13.0, 1.0, 0.0]))


def test_parameters_are_within_their_intervals() -> None:
    """Drawn again and again: with a history there standard errors hold how far off parameters are (rms), without one they stay."""
    begins = [closed(SIZE, seed) for seed in range(40)]
    ends = [with_quiet(one, None) for one in begins]
    off = np.array([one.fit.x[1] for one in begins])
    wide, wider = (np.array([_kappa(one) for one in of]) for of in (begins, ends))
    before, after = (float(np.sqrt(np.mean((off / s) ** 2))) for s in (wide, wider))
    assert before > 5.0 and 0.5 < after < 2.0, (before, after)
    chance = [(_kappa(one), with_quiet(one, None)) for one in (closed(0.0, seed) for seed in range(40))]
    assert sum(bool(end.remarks) for _, end in chance) <= 4, "of none it is said more often than chance has it"
    assert np.median([_kappa(end) / begin for begin, end in chance]) < 1.05


def test_only_of_a_body_whose_parameters_are_told_with_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    def beside(kind: str) -> Any:
        return SimpleNamespace(field=SimpleNamespace(basis=SimpleNamespace(kind=kind)))

    blind = replace(closed(SIZE), fit=replace(closed(SIZE).fit, covariance=None))
    flat = replace(closed(SIZE), fit=replace(closed(SIZE).fit, jacobian=None))
    for one in (closed(SIZE, cheap=True), blind, flat, closed(SIZE, model=SimpleNamespace(missing=None))):
        assert with_quiet(one, None) is one
    one = closed(SIZE)
    assert with_quiet(one, beside("heat")) is one, "parameters beside a heat have errors of their own"
    assert with_quiet(one, beside("displacement")) is not one, "a map is no cause beside which parameters are told"

    def fails(*_: Any, **__: Any) -> Any:
        raise NumericsError("no run")

    monkeypatch.setattr(module, "histories", fails)
    failed = with_quiet(one, None)
    assert failed.fit is one.fit and failed.remarks[-1].endswith("is not known: a run failed (no run)")


# Almost all of what a modulus that changes does, E does: one of two stretches of its rows shows the rest.
UNLOADED = np.arange(N) < 30
MODULUS = np.where(UNLOADED, 1.1, 0.9) * JACOBIAN[:, 0]
OTHERS = {"lamp": np.random.default_rng(9).normal(size=(N, 1)), "unfelt": np.zeros((N, 1))}
CHANGES = 15.0


def lacking(size: float, seed: int = 5, **without: Any) -> Closed:
    """A joint fit of data that hold an effect of that size which the model lacks; `without`: what replaces parts of the result."""
    begun = closed(0.0, seed)
    start = LinearModel(np.random.default_rng(seed).normal(size=N) - size * MODULUS, JACOBIAN)
    at = start.residual + JACOBIAN @ start.free_step
    dormant = {"elastic_degradation": (("degradation",), MODULUS[:, None]), **{n: ((n,), block) for n, block in OTHERS.items()}}
    here: Any = begun.last
    scores = tuple(SimpleNamespace(effect=name, vetoed="", z=6.0, predicted_drop=36.0) for name in dormant)
    here = SimpleNamespace(**vars(here) | {"problem": SimpleNamespace(model=SimpleNamespace(left=at), dormant=dormant), "scanned": {}})
    here.ranking = SimpleNamespace(scores=scores)
    return replace(begun, fit=replace(begun.fit, residual=at, x=start.free_step), last=here, **without)


def only_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "quiet_histories", lambda *_: [])


def _modulus(of: Closed) -> float:
    """The standard error of E."""
    assert of.fit.sigma is not None
    return float(of.fit.sigma[0])


def tried(gain: float, sigma: float, *effects: str) -> Any:
    return SimpleNamespace(trials=(SimpleNamespace(effects=effects, gain=gain, proof=SimpleNamespace(sigma=sigma)),))


def test_an_effect_that_takes_little_of_the_error_moves_what_a_few_rows_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    only_effects(monkeypatch)
    before = lacking(CHANGES)
    after = with_quiet(before, None)
    off = float(before.fit.x[0])
    assert after.budget is not None and after.fit.sigma is not None
    assert abs(off) > 8.0 * _modulus(before) and abs(off) < 2.0 * _modulus(after)
    assert after.fit.sigma[1:] == pytest.approx(before.fit.sigma[1:], rel=0.2), "the others are known as before"
    assert list(after.budget.parts) == [NOISE, QUIET_EFFECT] and after.budget.sigma == pytest.approx(after.fit.sigma)
    assert after.remarks[-1].startswith("intervals hold what elastic_degradation would make of the parameters, most of all of E +-")


def test_of_no_effect_it_is_said_no_more_often_than_by_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    only_effects(monkeypatch)
    ends = [(_modulus(one), with_quiet(one, None)) for one in (lacking(0.0, seed) for seed in range(40))]
    assert sum(bool(end.remarks) for _, end in ends) <= 2
    assert np.median([_modulus(end) / begin for begin, end in ends]) < 1.2


def test_what_a_refit_or_a_bound_rules_out_is_no_effect_that_may_be_there() -> None:
    assert set(module.not_refuted(lacking(CHANGES))) == {"elastic_degradation", *OTHERS}
    left = set(OTHERS)
    assert set(module.not_refuted(lacking(CHANGES, dropped=("elastic_degradation",)))) == left
    assert set(module.not_refuted(lacking(CHANGES, rounds=(tried(0.0, 1e-4, "elastic_degradation"),)))) == left
    for of_refit in (tried(0.001, 3e-4, "elastic_degradation"), tried(0.0, 1e-4, "elastic_degradation", "lamp")):
        assert "elastic_degradation" in module.not_refuted(lacking(CHANGES, rounds=(of_refit,)))
    early = (tried(0.0, 1e-4, "elastic_degradation"), tried(0.0, 1e-4, "lamp"))
    assert set(module.not_refuted(lacking(CHANGES, rounds=early))) == {"elastic_degradation", "unfelt"}, "the last round alone"
    vetoed = lacking(CHANGES)
    for score in vetoed.last.ranking.scores:
        score.vetoed = "below nothing" if score.effect == "lamp" else ""  # type: ignore[misc]
    assert set(module.not_refuted(vetoed)) == {"elastic_degradation", "unfelt"}


def test_what_the_mesh_could_make_is_no_effect() -> None:
    fit = lacking(CHANGES).fit
    known, effects = LinearModel(fit.residual, JACOBIAN), module.not_refuted(lacking(CHANGES))
    found = [module.quiet_effects(known, errors, effects) for errors in (np.zeros((N, 0)), CHANGES * MODULUS[:, None])]
    bare, beside = (one.likelihood["elastic_degradation"] for one in found if one is not None)
    assert bare > 0.99 and beside < 0.1
    assert module.quiet_effects(known, np.zeros((N, 0)), {"unfelt": module.QuietEffect((OTHERS["unfelt"],), 1.0)}) is None


def test_correlated_noise_and_many_tries_make_an_effect_less_likely() -> None:
    """Of two effects that take the same the one whose noise counts is likelier, and so is the one that was tried at one value only."""
    fit = lacking(CHANGES).fit
    known, none = LinearModel(fit.residual, JACOBIAN), np.zeros((N, 0))
    other = np.random.default_rng(4).normal(size=(N, 1))

    def of(first: module.QuietEffect, second: module.QuietEffect) -> dict[str, float]:
        found = module.quiet_effects(known, none, {"first": first, "second": second})
        assert found is not None and sum(found.likelihood.values()) > 0.9
        return dict(found.likelihood)

    whole, half = (module.QuietEffect((MODULUS[:, None],), counts) for counts in (1.0, 0.5))
    assert of(whole, whole)["first"] == pytest.approx(of(whole, whole)["second"])
    assert of(half, whole)["second"] > 0.99
    tried = module.QuietEffect((other, MODULUS[:, None], other, other), 1.0)
    assert of(tried, whole)["second"] == pytest.approx(4.0 * of(tried, whole)["first"], rel=0.1)
    end = lacking(CHANGES).last
    (score,) = (s for s in end.ranking.scores if s.effect == "lamp")
    score.predicted_drop = 144.0  # type: ignore[misc]
    end.scanned["lamp"] = (({}, other), ({}, OTHERS["lamp"]))  # type: ignore[index]
    found = module.not_refuted(replace(lacking(0.0), last=end))
    assert found["lamp"].counts == pytest.approx(0.25) and len(found["lamp"].blocks) == 2 and found["unfelt"].counts == 1.0
