"""The rules of refits on the known motion, one at a time: when they are asked for, of which effects, how far an effect is missed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from thermofit.core.parameters import Parameters
from thermofit.diagnose import rescored
from thermofit.diagnose.rescored import asked_of, missed
from thermofit.diagnose.rescored import enough as one_step_is_enough
from thermofit.diagnose.score import Columns
from thermofit.diagnose.trace import Traced
from thermofit.fit.linear_model import LinearModel

N = 200


def here_of(beyond: float, numerical: np.ndarray | None = None, **drops: float) -> Any:
    """A residual of 200 rows whose square sum is so much above 200, and effects with these predicted drops; "cannot" is vetoed."""
    scores = tuple(SimpleNamespace(effect=n, predicted_drop=d, vetoed="it cannot be" if n == "cannot" else "") for n, d in drops.items())
    residual = np.full(N, np.sqrt((N + beyond) / N))
    here = SimpleNamespace(columns=SimpleNamespace(residual=residual), ranking=SimpleNamespace(scores=scores))
    here.problem = SimpleNamespace(may_be_left=numerical)
    here.excess = lambda f: Traced.excess(cast(Traced, here), f)
    return here


@pytest.mark.parametrize(
    ("beyond", "drops", "enough"),
    [(79.0, {}, True), (81.0, {}, False), (100.0, {"lamp": 49.0}, False), (100.0, {"lamp": 51.0}, True), (100.0, {"cannot": 99.0}, False)],
    ids=["chance", "more than chance", "less than half", "half", "an estimate that cannot be"],
)
def test_one_step_is_enough_where_it_takes_half_of_what_is_more_than_chance(beyond: float, drops: dict[str, float], enough: bool) -> None:
    """Four standard deviations of the square sum: 4 sqrt(2 x 200) = 80."""
    assert bool(one_step_is_enough(here_of(beyond, **drops))) is enough


def test_what_the_error_of_mesh_and_steps_would_make_is_not_missing() -> None:
    """Of a square sum 200 beyond noise 130 may be left of the mesh."""
    for made, more in ((np.full(N, np.sqrt(0.65)), True), (np.full(N, np.sqrt(0.5)), False), (np.zeros(N), False)):
        assert bool(one_step_is_enough(here_of(200.0, made))) is more


@pytest.mark.parametrize(("taken", "whole"), [(True, 800.0), (False, 600.0)])
def test_what_a_source_explains_counts_without_what_mesh_and_steps_may_leave(
    monkeypatch: pytest.MonkeyPatch, taken: bool, whole: float
) -> None:
    """Of a square sum of 1000 the source leaves 200, an end 400. The mesh may leave 200, if no parameter has taken it up."""
    monkeypatch.setattr(rescored, "shown_rows", lambda _: np.ones(N, dtype=bool))
    alike, other = np.ones(N), np.tile([1.0, -1.0], N // 2)
    problem = Columns(LinearModel(np.zeros(N), alike[:, None]), {}, numerical=alike if taken else other)
    here: Any = SimpleNamespace(problem=problem, protected=SimpleNamespace(with_source=200.0))
    here.columns, there = SimpleNamespace(residual=np.full(N, np.sqrt(5.0))), SimpleNamespace()
    there.columns = SimpleNamespace(residual=np.full(N, np.sqrt(2.0)))
    assert rescored.share_of_source(here, cast(Any, there)) == pytest.approx(600.0 / whole)


def test_asked_are_the_strong_those_that_cannot_be_and_the_unfelt_that_no_held_out_test_judges() -> None:
    def score(name: str, z: float, vetoed: str = "") -> Any:
        return SimpleNamespace(effect=name, z=z, vetoed=vetoed)

    scores = (
        score("lamp", 9.0, "far"),
        score("ir_drift", 8.0),
        score("ir_gain", 7.0),
        score("air_drift", 1.0),
        score("radiation", 1.0, "x"),
    )
    ranking = SimpleNamespace(scores=scores, threshold=3.0, unfelt=("clamp_drift", "second_hardening"))
    proofs = {"ir_drift": SimpleNamespace(on=""), "ir_gain": SimpleNamespace(on="second")}
    here: Any = SimpleNamespace(ranking=ranking, proofs=proofs)
    assert [s.effect for s in asked_of(here)] == ["ir_drift", "lamp", "radiation", "clamp_drift"]


@pytest.mark.parametrize(("sigma", "expected"), [(0.4, 2.0), (0.2, 4.0), (0.1, 4.0)])
def test_temperatures_miss_an_effect_by_the_root_of_the_rise_over_what_noise_does_together(sigma: float, expected: float) -> None:
    """A rise of 16; a standard error twice that of independent noise, 1 / 5, makes four of it, a smaller one changes nothing."""
    parameters = Parameters.of({"c0": 2.3, "ir_drift.rate": 0.02}).with_free(("c0", "ir_drift.rate"))
    begun: list[Parameters] = []

    def minimised(start: Parameters, label: str) -> Parameters:
        begun.append(start)
        return start

    model = SimpleNamespace(residual=lambda p: np.array([5.0 if p["ir_drift.rate"] == 0.0 else 3.0]))
    warm = SimpleNamespace(minimised=minimised, model=model)
    there: Any = SimpleNamespace(case=SimpleNamespace(parameters=parameters, heated=lambda _: warm))
    fit: Any = SimpleNamespace(names=("c0", "ir_drift.rate"), jacobian=np.diag([2.0, 5.0]), sigma=np.array([9.0, sigma]))
    assert missed(there, "ir_drift", fit) == pytest.approx(expected)
    assert begun[0].free == ("c0",) and begun[0]["ir_drift.rate"] == 0.0
