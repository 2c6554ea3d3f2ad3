"""The rules of pairs, one at a time: when they are asked, which are made, which of them are refitted and accepted."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.diagnose import pairs as module
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.pairs import (
    ON_KNOWN_MOTION,
    PARTNERS,
    REFITTED,
    Pair,
    best_pair,
    by_chance,
    leaves_more_than_it_takes,
    pairs_of,
    partners,
    stepped,
    worth_a_refit,
)
from thermofit.diagnose.score import Score
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.trial import Trial

GOOD = Proof(2.0, 1.0, {}, 0.5, 0.01, 5)
N = 200
FIT: Any = None
MEANS: Any = None


def score(name: str, z: float = 9.0, family: tuple[str, ...] = ()) -> Score:
    return Score(name, z, 0.0, 0.0, {}, {}, 1.0, 0.0, "", (name, *family))


def trial(gain: float = 0.5, drop: float = 0.0, refused: str = "", names: tuple[str, ...] = ("ir_drift", "ir_gain")) -> Trial:
    return Trial(tuple(score(n) for n in names), replace(GOOD, gain=gain), {}, {}, drop, refused)


def plain() -> Any:
    """A trace of N rows whose discretisation is exact."""
    here = SimpleNamespace(columns=SimpleNamespace(residual=np.zeros(N)), problem=SimpleNamespace(may_be_left=None))
    here.excess = lambda f: Traced.excess(cast(Traced, here), f)
    return here


@pytest.mark.parametrize(
    ("beyond", "taken", "asked"),
    [(79.0, 0.0, False), (81.0, 0.0, True), (1000.0, 499.0, True), (1000.0, 501.0, False)],
    ids=["chance", "more than chance", "less than half is taken", "more than half is taken"],
)
def test_pairs_are_asked_where_the_best_single_effect_leaves_more_than_it_takes(beyond: float, taken: float, asked: bool) -> None:
    """200 values: the square sum of noise scatters by 20."""
    here = plain()
    fit: Any = SimpleNamespace(f=N + beyond)
    assert leaves_more_than_it_takes(here, fit, [trial(drop=taken), trial(drop=0.5 * taken)]) is asked


def test_what_a_refused_effect_would_take_is_still_there() -> None:
    here = plain()
    fit: Any = SimpleNamespace(f=N + 1000.0)
    assert leaves_more_than_it_takes(here, fit, [trial(drop=900.0, refused="at its bound")])


def ranked(*scores: Score) -> Any:
    return SimpleNamespace(ranking=SimpleNamespace(scores=scores, threshold=3.0))


def test_partners_are_above_the_threshold_or_of_such_a_family() -> None:
    found = partners(ranked(score("a", 9.0, ("c",)), score("b", 2.9), score("c", 1.0), score("d", 3.1)))
    assert [s.effect for s in found] == ["a", "d", "c"]
    many = partners(ranked(*(score(str(k), 10.0 + k) for k in range(12))))
    assert [s.effect for s in many] == [str(k) for k in range(11, 11 - PARTNERS, -1)], "the strongest"


A, B, C = np.eye(3)[:, :, None]
"""Columns (3, 1) of length one."""


def pair_of(a: np.ndarray, b: np.ndarray, left: np.ndarray, names: tuple[str, str] = ("ir_drift", "radiation")) -> Pair | None:
    return stepped((score(names[0]), score(names[1])), (({"x": 1.0}, a), ({"y": 2.0}, b)), (a, b), left)


def test_a_joint_step_explains_what_both_do() -> None:
    """-0.02 (4, 0, 0) - 0.3 (2, 2, 0) + (0, 0, 5) is left: estimates 0.02 and 0.3, and all but 25 of the square sum."""
    a, b = 4.0 * A, 2.0 * (A + B)
    left = -(0.02 * a + 0.3 * b)[:, 0] + 5.0 * C[:, 0]
    found = pair_of(a, b, left)
    assert found is not None and found.settings == {"x": 1.0, "y": 2.0}
    assert found.scores[0].estimate == pytest.approx({"ir_drift.rate": 0.02})
    assert found.scores[1].estimate == pytest.approx({"radiation.emissivity": 0.3})
    assert found.drop == pytest.approx(float(left @ left) - 25.0)


@pytest.mark.parametrize(("size", "there"), [(0.99, True), (1.01, False), (-0.01, False)])
def test_a_pair_with_an_estimate_outside_its_bounds_is_none(size: float, there: bool) -> None:
    """An emissivity is between 0 and 1."""
    assert (pair_of(A, B, -(0.02 * A + size * B)[:, 0]) is not None) is there


def test_effects_that_act_alike_or_are_not_felt_are_no_pair() -> None:
    pairs = [pair_of(A, b, -(0.02 * A + 0.3 * b)[:, 0]) for b in (A + 1e-5 * B, 0.0 * B, A + 0.1 * B)]
    assert [found is not None for found in pairs] == [False, False, True]


def test_pairs_stand_at_their_best_exponents_the_largest_fall_first() -> None:
    """Of the second effect the second value of the exponent explains what is left; the third effect explains next to nothing."""
    left = -np.array([0.02, 0.03, 0.001])
    names = {"ir_drift": A, "ir_gain": C, "lamp": C}
    here = ranked(score("lamp", 7.0), score("ir_gain", 8.0), score("ir_drift", 9.0))
    here.scanned = {"ir_gain": (({"k": 1.0}, 0.5 * (A + C)), ({"k": 2.0}, B))}
    model = SimpleNamespace(left=left, projected=lambda block: block)
    here.problem = SimpleNamespace(model=model, dormant={n: (("",), c) for n, c in names.items()})
    found = pairs_of(here)
    assert {s.effect for s in found[0].scores} == {"ir_drift", "ir_gain"} and len(found) == 3
    assert found[0].settings == {"k": 2.0}
    looked_at = {frozenset(s.effect for s in p.scores): p.looked_at for p in found}
    assert {n for n, count in looked_at.items() if count == 2} == {frozenset(("ir_gain", other)) for other in ("ir_drift", "lamp")}
    assert looked_at[frozenset(("ir_drift", "lamp"))] == 1
    assert [p.drop for p in found] == sorted((p.drop for p in found), reverse=True)


def here_of(cheap: bool = True, heated: Any = None) -> Any:
    return SimpleNamespace(
        case=SimpleNamespace(cheap=cheap, heated=heated, parameters=None),
        rows=None,
        split=SimpleNamespace(held_out=(None,) * 5),
        problem=SimpleNamespace(model=SimpleNamespace(noise=None)),
        columns=SimpleNamespace(residual=None),
        together=(),
        against_source=False,
    )


PAIRS = [Pair((score(f"a{k}"), score(f"b{k}")), {}, 10.0 - k) for k in range(9)]


def of_pairs(
    monkeypatch: pytest.MonkeyPatch, gains: list[float | None], singles: dict[str, Any], beats: tuple[str, ...], drop: float = 100.0
) -> Any:
    """Best of pairs that are refitted to these gains (None: refused) and falls of the square sum, by chance 50; `beats`: names of single
    effects that a pair predicts better than."""
    left = iter(gains)

    def refitted(here: Any, fit: Any, scores: Any, settings: Any, means: Any) -> Any:
        gain, names = next(left), tuple(s.effect for s in scores)
        return (trial(0.9, refused="no", names=names), None) if gain is None else (trial(gain, drop, names=names), (here_of(), "fit"))

    def compare(one: Any, *_: Any) -> Proof:
        return replace(GOOD, sigma=0.01 if one in beats else 0.4)

    monkeypatch.setattr(module, "pairs_of", lambda _: PAIRS[: len(gains)])
    monkeypatch.setattr(module, "by_chance", lambda pairs, after, before: 50.0 if len(pairs) == len(gains) else 0.0)
    monkeypatch.setattr(module, "tried_together", refitted)
    monkeypatch.setattr(module, "held_out_of", lambda one: one)
    monkeypatch.setattr(module, "compared", compare)
    return best_pair(here_of(), FIT, {name: name for name in singles}, MEANS)  # type: ignore[misc]


def test_of_pairs_the_one_with_the_largest_gain_is_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    singles: Any = ()
    trials, best = of_pairs(monkeypatch, [0.2, None, 0.4, 0.3], singles, ())
    assert best[0].gain == 0.4 and len(trials) == 4


def test_beside_a_broad_source_no_further_pairs_of_heat_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "pairs_of", lambda _: PAIRS[:2])
    monkeypatch.setattr(module, "tried_together", lambda *_: (trial(0.4, names=("a0", "b0")), None))
    here = here_of()
    assert len(best_pair(here, FIT, {}, MEANS)[0]) == 2
    here.against_source = True
    assert best_pair(here, FIT, {}, MEANS) == ([], None)


def test_a_pair_has_to_predict_better_than_each_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    singles: Any = ("a1", "b1", "a0")
    trials, best = of_pairs(monkeypatch, [0.2, 0.4], singles, ("a0", "a1"))
    assert best[0].gain == 0.2 and trials[1].refused == "predicts held-out data no better than b1 alone"
    _, best = of_pairs(monkeypatch, [0.2, 0.4], singles, singles)
    assert best[0].gain == 0.4


def test_a_pair_that_chance_reaches_among_all_that_were_looked_at_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    singles: Any = ()
    trials, best = of_pairs(monkeypatch, [0.2, 0.4], singles, (), drop=49.0)
    assert best is None and all("by chance" in t.refused for t in trials)
    assert of_pairs(monkeypatch, [0.2, 0.4], singles, (), drop=51.0)[1][0].gain == 0.4


def test_chance_grows_with_the_pairs_and_values_that_were_looked_at_and_with_what_is_left() -> None:
    """Two more parameters: chi2 = -2 ln p, p = 0.05 over 40 pairs at 5 values each, 16.6; four times that where four times the noise is
    left."""

    def fit_of(count: int, f: float) -> Any:
        return SimpleNamespace(x=np.zeros(count), residual=np.zeros(108), f=f)

    pairs = [replace(PAIRS[0], looked_at=5)] * 40
    alone = -2.0 * np.log(0.05 / 200.0)
    assert by_chance(pairs, fit_of(8, 100.0), fit_of(6, 900.0)) == pytest.approx(alone)
    assert by_chance(pairs, fit_of(8, 400.0), fit_of(6, 900.0)) == pytest.approx(4.0 * alone)
    assert by_chance(pairs, fit_of(8, 50.0), fit_of(6, 900.0)) == pytest.approx(alone), "no less than the noise"
    assert by_chance(pairs[:1], fit_of(8, 100.0), fit_of(6, 900.0)) == pytest.approx(-2.0 * np.log(0.05 / 5.0))
    assert by_chance(pairs, fit_of(10, 98.0), fit_of(6, 900.0)) > 1.2 * alone, "four more take more"


def test_of_coupons_as_many_pairs_are_refitted_as_are_worth_it() -> None:
    assert worth_a_refit(here_of(), PAIRS) == PAIRS[:REFITTED]


def on_known_motion(
    monkeypatch: pytest.MonkeyPatch, convinces: bool, alone: dict[str, float] | None = None
) -> tuple[list[Pair], list[str]]:
    """Pairs of a body that are refitted: the third gains most; what was asked of temperatures, and what was compared."""
    asked = []

    def end(gain: float, name: str) -> Any:
        return SimpleNamespace(proof=replace(GOOD, gain=gain), held_out=name, left=None)

    def together(here: Any, heat: Any, scores: Any, settings: Any) -> Any:
        asked.append(scores[0].effect)
        return end({"a0": 0.2, "a1": 0.3, "a2": 0.4}.get(scores[0].effect, 0.9), scores[0].effect)

    def compare(one: Any, other: Any, *_: Any) -> Proof:
        asked.append(f"{one} {other}")
        return replace(GOOD, sigma=0.01 if convinces else 0.4)

    every = {n: 0.1 for k in range(9) for n in (f"a{k}", f"b{k}")} | {"b4": 0.2} if alone is None else alone
    monkeypatch.setattr(module, "shown_alone", lambda *_: {n: end(g, n) for n, g in every.items()})
    monkeypatch.setattr(module, "shown_together", together)
    monkeypatch.setattr(module, "compared", compare)
    return worth_a_refit(here_of(False, lambda _: "heat"), PAIRS), asked


def test_of_a_body_the_pair_that_temperatures_show_best_is_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it predicts better than the best single effect there; only the first are asked."""
    found, asked = on_known_motion(monkeypatch, True)
    assert found == [PAIRS[2]] and asked == ["a0", "a1", "a2", "b4 a2"] and len(asked) == ON_KNOWN_MOTION + 1
    assert on_known_motion(monkeypatch, False)[0] == []


def test_of_a_body_only_pairs_that_temperatures_show_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    assert on_known_motion(monkeypatch, True, {"a1": 0.1, "b1": 0.1, "a2": 0.1})[0] == [PAIRS[1]]
    assert on_known_motion(monkeypatch, True, {}) == ([], [])


def test_of_a_body_without_a_known_motion_no_pair_is_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: Any) -> Any:
        raise NumericsError("no run")

    assert worth_a_refit(here_of(False), PAIRS) == [] and worth_a_refit(here_of(False, lambda _: None), PAIRS) == []
    monkeypatch.setattr(module, "shown_alone", failing)
    assert worth_a_refit(here_of(False, lambda _: "heat"), PAIRS) == []
