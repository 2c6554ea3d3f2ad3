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
from thermofit.fit.budget import NOISE, QUIET, Budget
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
    here: Any = SimpleNamespace(case=Body(**own | case), rows=None, problem=SimpleNamespace(model=SimpleNamespace(left=at)))
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
