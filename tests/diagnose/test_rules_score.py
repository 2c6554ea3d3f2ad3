"""The rules of scores, one at a time: what is alike, what stands above chance and mesh, what cannot be."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from seen_field import case_of

from thermofit.diagnose import trace
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.score import Columns, Score, drop_of, indistinguishable, likeness, named_from, ranked, threshold_of, veto
from thermofit.diagnose.trace import Traced, information, traced
from thermofit.fit.linear_model import LinearModel

E1, E2, E3 = np.eye(12)[:, :3].T
NOTHING = np.zeros((12, 0))


def at(cosine: float) -> np.ndarray:
    """A column with this cosine to E1."""
    return cosine * E1 + np.sqrt(1.0 - cosine**2) * E2


@pytest.mark.parametrize(("cosine", "alike"), [(0.89, False), (-0.89, False), (0.91, True), (-0.91, True)])
def test_effects_are_alike_above_nine_tenths(cosine: float, alike: bool) -> None:
    columns = {"ir_drift": (("ir_drift.rate",), 3.0 * E1[:, None]), "ir_gain": (("ir_gain.gain",), 0.1 * at(cosine)[:, None])}
    found = ranked(Columns(LinearModel(0.01 * E3, NOTHING), columns))
    assert all((len(s.family) == 2) is alike for s in found.scores)
    both = np.stack([3.0 * E1, 0.1 * at(cosine), E3], axis=1)
    assert (indistinguishable(both, {"ir_drift": [0], "ir_gain": [1]}) is not None) is alike


def test_likeness_is_that_of_the_nearest_directions() -> None:
    """A plane holds the direction, whatever spans it; sizes do not count."""
    plane = np.stack([E2 + 5.0 * E3, E1 + E2], axis=1)
    found = likeness({"one": 7.0 * (E1 - 5.0 * E3)[:, None], "other": plane})
    assert found["one", "other"] == pytest.approx(1.0)


def test_likeness_is_beyond_the_fitted_parameters() -> None:
    """What both share is fitted: nothing alike is left."""
    columns = {"ir_drift": (("ir_drift.rate",), (E1 + 9.0 * E3)[:, None]), "ir_gain": (("ir_gain.gain",), (E2 + 9.0 * E3)[:, None])}
    assert all(len(s.family) == 1 for s in ranked(Columns(LinearModel(0.01 * E1, E3[:, None]), columns)).scores)


def test_what_cannot_be_is_in_no_family() -> None:
    """An emissivity below nothing, which acts as the drift does."""
    columns = {
        "ir_drift": (("ir_drift.rate",), 100.0 * at(0.99)[:, None]),
        "radiation": (("radiation.emissivity",), 100.0 * E1[:, None]),
    }
    up, down = (ranked(Columns(LinearModel(sign * 5.0 * E1, NOTHING), columns)) for sign in (-1.0, 1.0))
    assert [s.effect for s in down.scores] == ["ir_drift", "radiation"] and down.scores[1].vetoed
    assert down.scores[0].family == ("ir_drift",) and {len(s.family) for s in up.scores} == {2}


@pytest.mark.parametrize(("value", "vetoed"), [(-0.019, False), (-0.021, True), (1.019, False), (1.021, True)])
def test_an_estimate_two_standard_errors_beyond_its_bounds_cannot_be(value: float, vetoed: bool) -> None:
    """An emissivity is between 0 and 1."""
    assert bool(veto({"radiation.emissivity": value}, {"radiation.emissivity": 0.01})) is vetoed


def test_a_fall_by_an_estimate_that_cannot_be_is_none() -> None:
    columns = Columns(LinearModel(5.0 * E1, NOTHING), {})
    assert drop_of(columns, ("radiation.emissivity",), 100.0 * E1[:, None]) == -1.0
    assert drop_of(columns, ("ir_drift.rate",), 100.0 * E1[:, None]) == pytest.approx(25.0)


def test_the_threshold_is_passed_by_chance_in_one_of_twenty_tests() -> None:
    """One direction, or the same three times: 1.96. Of n independent ones: 1 - 0.95^(1/n) for each, however often one is asked. An effect
    of two Params counts by its chi-square."""
    one, two, drawn = E1[:, None], E2[:, None], 0.04
    assert threshold_of([]) == pytest.approx(1.959964) and threshold_of([one, 3.0 * one, one]) == pytest.approx(1.959964, abs=drawn)
    every = np.eye(20)

    def sidak(n: int) -> float:
        return float(norm.isf(0.5 * (1.0 - 0.95 ** (1.0 / n))))

    assert threshold_of([one, two]) == pytest.approx(sidak(2), abs=drawn)
    assert threshold_of([*(every[:, [k]] for k in range(11)), *[every[:, [0]]] * 30]) == pytest.approx(sidak(11), abs=drawn)
    assert threshold_of([every[:, 2 * k : 2 * k + 2] for k in range(10)]) == pytest.approx(sidak(10), abs=drawn)


def test_rows_that_hang_together_widen_the_standard_error() -> None:
    """What is left has the sign of the column in the first half: two groups that err as one each."""
    column = np.array([1.0, -1.0] * 6)
    left = np.where(np.arange(12) < 6, 3.0, -3.0) * column
    groups = np.repeat([0, 1], 6)
    columns = {"ir_drift": (("ir_drift.rate",), column[:, None])}
    model = LinearModel(left, NOTHING)
    plain, grouped = (ranked(Columns(model, columns, g)).scores[0].sigma["ir_drift.rate"] for g in (None, groups))
    assert plain == pytest.approx(12.0**-0.5) and grouped == pytest.approx(np.sqrt(2.0 * 2.0 * 18.0**2) / 12.0)


def test_correlated_noise_widens_the_standard_error() -> None:
    columns = {"ir_drift": (("ir_drift.rate",), E1[:, None])}
    plain, nine = (ranked(Columns(LinearModel(E1, NOTHING, n), columns)).scores[0] for n in (None, lambda v: 9.0 * v))
    assert nine.sigma["ir_drift.rate"] == pytest.approx(3.0 * plain.sigma["ir_drift.rate"]) and nine.z == pytest.approx(plain.z / 3.0)


GOOD = Proof(2.0, 1.0, {}, 0.5, 0.01, 5)
LIKELY = Score("a", 9.0, 41.0, 10.0, {}, {}, 1.0, 0.0, "", ("a",))


def why_not(score: Score = LIKELY, proofs: dict[str, Proof] | None = None, unjudged: dict[str, str] | None = None) -> str:
    here: Any = SimpleNamespace(
        unjudged=unjudged or {}, ranking=SimpleNamespace(threshold=3.0), proofs={"a": GOOD} if proofs is None else proofs
    )
    return Traced.why_not(here, score)


@pytest.mark.parametrize(
    ("said", "given"),
    [
        ("", {}),
        ("not judged: no run", {"unjudged": {"a": "no run"}}),
        ("cannot be", {"score": replace(LIKELY, vetoed="cannot be")}),
        ("not significant (z 2.90, threshold 3.00)", {"score": replace(LIKELY, z=2.9)}),
        ("the error of mesh and time steps alone looks as large", {"score": replace(LIKELY, predicted_drop=39.0)}),
        ("weaker than others", {"proofs": {}}),
        ("held-out error falls by 50.00 % +- 30.00 %: not enough", {"proofs": {"a": replace(GOOD, sigma=0.3)}}),
        ("held-out error rises by 50.00 % +- 1.00 %", {"proofs": {"a": replace(GOOD, gain=-0.5)}}),
    ],
)
def test_why_an_effect_is_not_worth_a_refit(said: str, given: dict[str, Any]) -> None:
    """Four times what the error of mesh and steps explains is asked, among others."""
    found = why_not(**given)
    assert found.startswith(said) and bool(found) is bool(said)


@pytest.mark.parametrize(
    ("threshold", "numerical", "size", "expected"),
    [(3.0, 0.0, 1.0, 4.449), (6.0, 0.0, 1.0, 6.0), (3.0, 25.0, 1.0, 10.0), (3.0, 0.0, 200.0, np.sqrt(120.0 + 2.0))],
    ids=["sure on held-out data", "above chance", "above the mesh", "worth an effect"],
)
def test_the_size_from_which_an_effect_is_named(threshold: float, numerical: float, size: float, expected: float) -> None:
    """In standard errors: 2 + sqrt(6), the threshold, sqrt(4 x 25), or the root of 0.003 r.r + 2 with r.r = 40000."""
    assert named_from(LinearModel(size * E1, NOTHING), 0.1, 0.01, numerical, threshold) == pytest.approx(0.1 * expected, rel=1e-3)


def test_half_of_what_a_row_tells_is_even() -> None:
    """The only row that a parameter is felt in has half of the weight and its part of the other half, whatever the size of the column."""
    assert information(1e9 * E1[:, None]) == pytest.approx(0.5 / 12.0 + 0.5 * E1)


def test_all_strong_effects_are_asked_of_held_out_data_eight_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drift and an emissivity, both of them planted and far above the threshold."""
    case = case_of(5, **{"ir_drift.rate": 1.5e-3, "ir_emissivity.slope": 2.0})
    here = traced(case)
    strong = [s.effect for s in here.ranking.scores if s.z > here.ranking.threshold and not s.vetoed]
    assert len(strong) >= 2 and set(here.proofs) == set(strong) and trace.PROVED_AT_MOST == 8
    monkeypatch.setattr(trace, "PROVED_AT_MOST", 1)
    assert set(traced(case).proofs) == {strong[0]}


@pytest.mark.parametrize(("size", "hidden"), [(3.0, False), (1.5, True)])
def test_what_the_mesh_may_leave_in_a_channel_is_not_told_from_it(size: float, hidden: bool) -> None:
    """Eight rows of the first channel hold an effect of square 8 size^2, and the error of the mesh may leave 40 there, in a direction that
    the effect has nothing of; the other channel, where nothing acts, holds any excess."""
    effect, other = np.repeat([1.0, 0.0], [8, 4]), np.tile([1.0, -1.0], 6) * np.repeat([1.0, 0.0], [8, 4])
    residual = size * effect + np.repeat([0.0, 9.0], [8, 4])
    columns = {"ir_drift": (("ir_drift.rate",), 1e3 * effect[:, None])}
    channel = np.repeat([0, 1], [8, 4])
    (score,) = ranked(Columns(LinearModel(residual, NOTHING), columns, None, np.sqrt(5.0) * other, channel=channel)).scores
    assert score.predicted_drop == pytest.approx(8.0 * size**2)
    assert score.numerical_drop == pytest.approx(40.0 if hidden else 0.0)
    least = score.detectable / score.sigma["ir_drift.rate"]
    assert least >= np.sqrt(40.0) - 1e-9, "the least amplitude that can be named knows of it"


def test_an_error_of_the_mesh_that_a_parameter_has_taken_up_hides_nothing() -> None:
    """The rows of `test_what_the_mesh_may_leave_in_a_channel_is_not_told_from_it` that were hidden, beside a parameter whose column is the
    error: what may be left is what no parameter can make. Half of it, in another direction, may be."""
    effect, other = np.repeat([1.0, 0.0], [8, 4]), np.tile([1.0, -1.0], 6) * np.repeat([1.0, 0.0], [8, 4])
    third = np.tile([1.0, 1.0, -1.0, -1.0], 3) * np.repeat([1.0, 0.0], [8, 4])
    columns, channel = {"ir_drift": (("ir_drift.rate",), 1e3 * effect[:, None])}, np.repeat([0, 1], [8, 4])
    for error, left in ((np.sqrt(5.0) * other, 0.0), (np.sqrt(2.5) * (other + third), 20.0)):
        problem = Columns(LinearModel(1.5 * effect, 7.0 * other[:, None]), columns, None, error, channel=channel)
        (score,) = ranked(problem).scores
        assert score.numerical_drop == pytest.approx(left) and score.predicted_drop == pytest.approx(18.0)
        assert float(np.sum(problem.may_be_left**2)) == pytest.approx(left)


def test_an_error_of_the_mesh_below_chance_hides_nothing() -> None:
    """Eight rows whose declared noise is twice the true one hold less than their number; the mesh may leave 7, chance makes 8."""
    effect = np.ones(8)
    columns = {"ir_drift": (("ir_drift.rate",), 1e3 * effect[:, None])}
    numerical = np.sqrt(7.0 / 8.0) * np.tile([1.0, -1.0], 4)
    (score,) = ranked(Columns(LinearModel(0.5 * effect, np.zeros((8, 0))), columns, None, numerical, channel=np.zeros(8, dtype=int))).scores
    assert score.numerical_drop == pytest.approx(0.0)
