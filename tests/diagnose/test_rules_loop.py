"""The rules of a turn of the loop and of its end, one at a time: which trials are made, who wins, what the base model takes back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import param
from thermofit.diagnose import loop as module
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.loop import (
    MOST_TRIED,
    TRIED_WHERE_CHEAP,
    Closed,
    against_base,
    backward_check,
    candidates,
    close_loop,
    is_held,
    next_round,
)
from thermofit.diagnose.rejudge import Rejudged
from thermofit.diagnose.score import Score
from thermofit.diagnose.trial import Trial, near_scan
from thermofit.report.findings import estimates_in_words, remark_of

GOOD = Proof(2.0, 1.0, {}, 0.5, 0.01, 5)
FIT: Any = None
MEANS: Any = None


def score(name: str, z: float = 9.0, family: tuple[str, ...] = (), **told: Any) -> Score:
    return replace(Score(name, z, 10.0, 0.0, {}, {}, 1.0, 0.0, "", (name, *family)), **told)


def trial(name: str, gain: float, refused: str = "", unjudged: bool = False, adrift: tuple[str, ...] = ()) -> Trial:
    return Trial(tuple(score(n) for n in name.split()), replace(GOOD, gain=gain), {}, {}, 0.0, refused, unjudged=unjudged, adrift=adrift)


def turned(
    monkeypatch: pytest.MonkeyPatch,
    gains: dict[str, float | None],
    *,
    cheap: bool = True,
    pair: float | None = None,
    room: int = 3,
    rivals: bool = True,
    same: tuple[str, ...] = (),
    left: bool = True,
    near: tuple[str, ...] = (),
    fitted: str = "",
    bounds: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
    adrift: str = "",
    family: tuple[str, ...] = (),
    leave: tuple[str, ...] = (),
    vetoed: str = "",
    weighted: dict[str, float] | None = None,
) -> tuple[list[str], Trial | None]:
    """A turn whose candidates are refitted to these gains (None: refused), a pair to `pair`; `same`: what cannot be told apart, by two
    standard errors, `near`: by one; `fitted`: those with one more parameter; `bounds`: what ends at a bound by candidate, "": before;
    `adrift`: those with an exponent that no fit has settled; `family`: effects alike, of which the first alone is a candidate; `leave`:
    those whose ends leave more than noise; `vetoed`: those that cannot be; `weighted`: gains where channels that hold what neither
    explains count for less, where these are others."""

    def of_family(name: str) -> tuple[str, ...]:
        return tuple(n for n in family if n != name) if name in family else ()

    def end(name: str) -> Any:
        return SimpleNamespace(
            name=name,
            excess=lambda f: f if name in leave else 0.0,
            case=SimpleNamespace(parameters=SimpleNamespace(free=("E",) * (1 + (name in fitted)))),
        )

    def refitted(here: Any, fit: Any, one: Score, means: Any) -> Any:
        gain = gains[one.effect]
        return (
            (trial(one.effect, 0.99, "no"), None)
            if gain is None
            else (
                replace(trial(one.effect, gain, adrift=("b",) * (one.effect in adrift)), scores=(one,)),
                (end(one.effect), SimpleNamespace(f=2.0)),
            )
        )

    def pairs(*_: Any) -> Any:
        both = trial("p q", 0.0 if pair is None else pair)
        return [both], None if pair is None else (both, (end("p q"), SimpleNamespace(f=2.0)))

    def apart(one: Any, other: Any, sure: float = 2.0) -> bool:
        return not {one.name, other.name} <= set(near if sure == 1.0 else (*near, *same))

    def better(one: Any, other: Any, sure: float = 2.0) -> bool:
        first, second = (told.get(t.name, gains[t.name]) or 0.0 for t in (one, other))
        return apart(one, other, sure) and first > second

    told = weighted or {}
    scores = [score(n, family=of_family(n), vetoed="no" if n in vetoed.split() else "") for n in gains]
    monkeypatch.setattr(module, "candidates", lambda _: [s for s in scores if s.effect not in family[1:]])
    monkeypatch.setattr(module, "tried", refitted)
    monkeypatch.setattr(module, "leaves_more_than_it_takes", lambda *_: left)
    monkeypatch.setattr(module, "best_pair", pairs)
    monkeypatch.setattr(module, "rivals", lambda *_: rivals)
    monkeypatch.setattr(module, "discriminated", apart)
    monkeypatch.setattr(module, "surely_better", better)
    monkeypatch.setattr(module, "ends_of_fit", lambda t, _: dict.fromkeys(bounds.get(getattr(t, "name", ""), ()), "at its bound"))
    here: Any = SimpleNamespace(case=SimpleNamespace(cheap=cheap), ranking=SimpleNamespace(scores=scores))
    trials, winner = next_round(here, FIT, MEANS, room)
    return [" ".join(t.effects) for t in trials], None if winner is None else winner[0]


def won(*given: Any, **also: Any) -> str:
    winner = turned(*given, **also)[1]
    return "" if winner is None else " ".join(winner.effects)


def test_the_largest_gain_wins_and_not_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    assert won(monkeypatch, {"a": 0.2, "b": 0.4, "c": None, "d": 0.3}) == "b"


def test_a_pair_wins_where_it_gains_more_than_the_best_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    assert won(monkeypatch, {"a": 0.4}, pair=0.41) == "p q" and won(monkeypatch, {"a": 0.4}, pair=0.39) == "a"
    assert won(monkeypatch, {"a": None}, pair=0.1) == "p q"


def test_a_pair_needs_room_for_two_and_something_that_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    assert won(monkeypatch, {"a": 0.4}, pair=0.9, room=1) == "a" and won(monkeypatch, {"a": 0.4}, pair=0.9, left=False) == "a"
    assert turned(monkeypatch, {"a": 0.4}, pair=0.9, room=0) == ([], None)


def test_of_a_body_all_that_could_gain_more_are_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    gains: dict[str, float | None] = {"a": 0.2, "b": 0.3, "c": 0.9, "d": 0.9}
    many, _ = turned(monkeypatch, gains, cheap=False, left=False)
    assert many == list(gains), "the third may be the cause for which the first two stand in"
    assert turned(monkeypatch, gains, cheap=False, left=False, rivals=False)[0] == ["a"], "no other could gain more"
    assert turned(monkeypatch, gains | {"a": None}, cheap=False, left=False, rivals=False)[0] == ["a", "b"], "until one is accepted"
    assert turned(monkeypatch, gains, cheap=True, left=False, rivals=False)[0] == list(gains), "of coupons all"


def test_of_a_body_the_family_of_a_winner_that_leaves_more_than_noise_is_refitted_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of it wins where it predicts held-out data better by more than a standard error; what it leaves is then asked."""
    gains: dict[str, float | None] = {"a": 0.4, "b": 0.5, "c": 0.6}
    own: Any = {"cheap": False, "left": False, "family": ("a", "b", "c"), "leave": ("a",)}
    tried, winner = turned(monkeypatch, gains, **own)
    assert tried == ["a", "b"] and winner is not None and winner.effects == ("b",), "b leaves no more than noise"
    assert turned(monkeypatch, gains, **own | {"leave": ()})[0] == ["a"], "nor does a"
    assert won(monkeypatch, gains, **own | {"leave": ("a", "b")}) == "c"
    assert won(monkeypatch, gains, **own | {"leave": ("a", "b"), "near": ("a", "b", "c")}) == "a", "within a standard error"
    assert won(monkeypatch, gains, **own | {"leave": ("a", "b"), "same": ("a", "b", "c")}) == "c"
    apart = own | {"leave": ("a", "b")}
    assert won(monkeypatch, gains, **apart, weighted={"b": 0.3, "c": 0.2}) == "a", "the larger gain lies in what neither explains"
    assert won(monkeypatch, gains | {"b": 0.3}, **apart, weighted={"b": 0.5, "c": 0.4}) == "b", "nor does the smaller one hinder"
    assert won(monkeypatch, gains | {"b": None, "c": 0.3}, **own) == "a" and won(monkeypatch, gains, **own | {"vetoed": "b"}) == "c"
    assert turned(monkeypatch, gains, **own | {"family": ("a",)}, rivals=False)[0] == ["a"]


def test_the_winner_is_named_with_what_predicts_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    winner = turned(monkeypatch, {"a": 0.2, "b": 0.4, "c": 0.3}, left=False, same=("a", "b"))[1]
    assert winner is not None and winner.score.family == ("b", "a")
    winner = turned(monkeypatch, {"a": 0.2, "b": 0.4, "c": None}, left=False, same=("c", "b"))[1]
    assert winner is not None and winner.score.family == ("b",), "what was refused is no alternative"


def test_of_refits_within_one_standard_error_the_simpler_one_wins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of equally simple ones that with the largest gain, and one that predicts worse by more does not; of a body the largest gain."""
    gains: dict[str, float | None] = {"a": 0.35, "b": 0.4, "c": 0.37, "d": 0.38, "e": None}
    own: Any = {"left": False, "near": ("a", "b", "c", "e"), "same": ("d",), "fitted": "b"}
    winner = turned(monkeypatch, gains, **own)[1]
    assert winner is not None and winner.effects == ("c",) and winner.score.family == ("c", "a", "b", "d")
    assert won(monkeypatch, gains, **own | {"fitted": "abc"}) == "b", "all as simple"
    assert won(monkeypatch, gains, **own | {"fitted": "ac"}) == "b"
    assert won(monkeypatch, gains, **own, cheap=False) == "b"


def test_of_refits_within_one_standard_error_one_that_drives_nothing_to_a_bound_wins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Be it the less simple one; what was at its bound before counts for none of them."""
    gains: dict[str, float | None] = {"a": 0.35, "b": 0.4}
    own: Any = {"left": False, "near": ("a", "b"), "fitted": "b"}
    assert won(monkeypatch, gains, **own, bounds={"a": ("E",)}) == "b" and won(monkeypatch, gains, **own, bounds={"b": ("E",)}) == "a"
    assert won(monkeypatch, gains, **own, bounds={"": ("E",), "a": ("E",)}) == "a"
    assert won(monkeypatch, gains, **own | {"near": ()}, bounds={"b": ("E",)}) == "b", "not at the price of the prediction"
    assert won(monkeypatch, gains, **own, adrift="a") == "b", "nor one with an exponent adrift"
    apart: Any = {"left": False, "fitted": "b", "same": ("a", "b")}
    assert won(monkeypatch, gains, **apart) == "b" and won(monkeypatch, gains, **apart, adrift="b") == "a", "told apart for sure"


def base(
    monkeypatch: pytest.MonkeyPatch,
    gains: dict[int, float],
    tests: dict[str, Proof] | None = None,
    fails: bool = False,
    moves: bool = False,
) -> Closed:
    """What stays of three accepted effects that together gain so much, by their number; standard error 0.01, or 0.0005 where they move a
    parameter of the material far."""

    def here(count: int) -> Any:
        split, columns = SimpleNamespace(held_out=()), SimpleNamespace(residual=None)
        problem = SimpleNamespace(model=SimpleNamespace(noise=None))
        return SimpleNamespace(count=count, split=split, rows=None, problem=problem, columns=columns)

    def drop(last: Any, name: str, means: Any) -> Any:
        if fails:
            raise NumericsError("no run")
        return here(last.count - 1), f"fit of {last.count - 1}"

    monkeypatch.setattr(module, "held_out_of", lambda t: t.count)
    monkeypatch.setattr(module, "compared", lambda before, after, *_: replace(GOOD, gain=gains[after], sigma=0.0005 if moves else 0.01))
    monkeypatch.setattr(module, "proof_of_refit", lambda first, last, name: (tests or {}).get(name))
    monkeypatch.setattr(module, "without", drop)
    monkeypatch.setattr(module, "moves_material", lambda *_: moves)
    refit: Any = None
    return against_base(Closed((), here(0), here(3), FIT, ("a", "b", "c"), (), refit, None), "auto")


def test_the_latest_effects_go_until_what_stays_beats_the_base_model(monkeypatch: pytest.MonkeyPatch) -> None:
    found = base(monkeypatch, {3: 0.019, 2: 0.002, 1: 0.021})
    assert found.accepted == ("a",) and found.dropped == ("c", "b") and found.last.count == 1 and found.fit == "fit of 1"  # type: ignore[attr-defined,comparison-overlap]
    assert found.remarks[0].startswith("c is taken back: with a, b, c together held-out error falls by 1.90 %")
    assert base(monkeypatch, dict.fromkeys((1, 2, 3), -0.1)).accepted == ()
    assert base(monkeypatch, {3: 0.021}).accepted == ("a", "b", "c")
    assert base(monkeypatch, {3: 0.0021}, moves=True).accepted == ("a", "b", "c"), "little, beyond doubt, and it moves the material"


def test_a_held_out_test_that_all_together_do_not_predict_better_takes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The worst of them decides."""
    bad = replace(GOOD, gain=-0.2, on="second")
    found = base(monkeypatch, dict.fromkeys((1, 2, 3), 0.5), {"b": bad, "a": GOOD})
    assert found.accepted == ("a",) and "on second rises by 20.00 %" in found.remarks[0]


def test_what_cannot_be_taken_back_is_unjudged(monkeypatch: pytest.MonkeyPatch) -> None:
    found = base(monkeypatch, {3: 0.0}, fails=True)
    assert found.accepted == ("a", "b", "c") and "the fit without it failed: no run" in found.unjudged["c"]


def test_what_the_last_round_accepted_is_not_asked_whether_it_is_still_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has just been proved, and nothing came after it."""
    rounds: Any = tuple(SimpleNamespace(accepted=names) for names in (("a",), ("b", "c"), ()))
    refit: Any = None
    last: Any = "last"
    monkeypatch.setattr(module, "still_needed", lambda *_: False)
    monkeypatch.setattr(module, "is_held", lambda *_: False)
    monkeypatch.setattr(module, "proof_against", lambda *_: Proof(1.0, 1.0, {}, -0.1, 0.01, 5))
    monkeypatch.setattr(module, "without", lambda here, name, _: (f"{here} without {name}", None))
    found = backward_check(Closed(rounds, last, last, FIT, ("a", "b", "c"), (), refit, None), "auto")
    assert found.dropped == ("a",) and found.accepted == ("b", "c") and found.last == "last without a"  # type: ignore[comparison-overlap]
    monkeypatch.setattr(module, "is_held", lambda here, name: here == "last" and name == "a")
    found = backward_check(Closed(rounds, last, last, FIT, ("a", "b", "c"), (), refit, None), "auto")
    assert found.accepted == ("a", "b", "c") and found.last == "last", "a part of the law that a curve of any form was fitted beside"


def test_what_is_held_has_no_standard_error_in_the_verdict() -> None:
    """Beside a curve of any form the law is held, with what was added to it before."""
    values = {"H_lin": 278.9, "clamp_drift.rate": 0.02, "clamp_drift.apart": 0.001}
    closed: Any = SimpleNamespace(
        fit=SimpleNamespace(names=("clamp_drift.rate",), sigma=np.array([0.0003])),
        last=SimpleNamespace(case=SimpleNamespace(parameters=values)),
    )
    assert estimates_in_words(closed, "linear_hardening") == "H_lin 278.9 MPa, held"
    assert estimates_in_words(closed, "clamp_drift") == "rate 0.02 +- 0.0003 K/s, apart 0.001 K/s, held"
    closed.fit.sigma = None
    assert estimates_in_words(closed, "clamp_drift").startswith("rate 0.02 K/s, no standard error")


def test_an_effect_none_of_whose_amplitudes_is_fitted_is_held() -> None:
    def here(*free: str) -> Any:
        return SimpleNamespace(case=SimpleNamespace(parameters=SimpleNamespace(free=free)))

    assert is_held(here("M_y0", "hardening_curve.level"), "linear_hardening") and not is_held(here("H_lin"), "linear_hardening")
    assert not is_held(here("clamp_drift.apart"), "clamp_drift") and is_held(here("clamp_drift.time"), "clamp_drift")


@dataclass(frozen=True)
class Ranked:
    """A ranking of which only the scores count."""

    scores: tuple[Score, ...]


@dataclass(frozen=True)
class Shown:
    """A trace of which only this counts."""

    case: Any
    ranking: Ranked
    unjudged: Mapping[str, str]
    promising: Any
    columns: Any
    whole: bool = True


def looped(
    monkeypatch: pytest.MonkeyPatch, trials: list[Trial], winner: Any, most: int, gone: tuple[str, ...] = (), asked: list[Any] | None = None
) -> Closed:
    """A loop of one round with these trials, at a trace that promises a rival and could not run a lamp; `gone`: what is taken back after
    it. `asked` takes the effects that each round asks for, and what is judged again."""
    said: list[Any] = [] if asked is None else asked

    def turn(here: Any, *_: Any) -> Any:
        said.append(tuple(s.effect for s in here.ranking.scores))
        return next(turns)

    def judged(here: Any, fit: Any, accepted: tuple[str, ...], before: Any, means: Any) -> Rejudged:
        said.append((accepted, before))
        return Rejudged(here, fit, gone, tuple(f"{n} is gone" for n in gone))

    here: Any = Shown(
        case=SimpleNamespace(refined_at=None, parameters=None),
        ranking=Ranked((score("e"), score("rival"))),
        unjudged={"lamp": "no run"},
        promising=lambda: (score("rival"),),
        columns=SimpleNamespace(residual=np.ones(2)),
    )
    turns = iter([(trials, winner and (winner, (here, FIT))), ([trial("late", 0.1, "no run", unjudged=True)], None)])
    monkeypatch.setattr(module, "traced", lambda *_, **__: here)
    monkeypatch.setattr(module, "rescored", lambda t: t)
    monkeypatch.setattr(module, "next_round", turn)
    monkeypatch.setattr(module, "rejudged", judged)
    monkeypatch.setattr(module, "exponents_again", lambda here, fit, earlier, means: said.append(("again", earlier)) or Rejudged(here, fit))
    monkeypatch.setattr(module, "released", lambda *_: SimpleNamespace(trials=(), accepted=None))
    monkeypatch.setattr(module, "leaves_more_than_it_takes", lambda *_: True)
    monkeypatch.setattr(module, "by_displacements", lambda _here, _fit, _means, _trials, winner: ([], winner))
    monkeypatch.setattr(module, "or_any_form", lambda _here, _fit, _means, _trials, winner, _first: ([], winner))
    monkeypatch.setattr(module, "beside_any_form", lambda here, _: here)
    monkeypatch.setattr(module, "ends_of_fit", lambda *_: {"E": "at its bound"})
    monkeypatch.setattr(module, "backward_check", lambda closed, _: replace(closed, remarks=("backward",)))
    monkeypatch.setattr(module, "against_base", lambda closed, _: replace(closed, remarks=(*closed.remarks, "base")))
    case: Any = None
    refit: Any = None
    return close_loop(case, FIT, refit, most, None)


def test_what_is_accepted_is_judged_again_and_what_was_taken_back_is_not_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    found = looped(monkeypatch, [], trial("e", 0.5), 3, ("e",), asked)
    assert found.accepted == () and found.dropped == ("e",) and found.remarks == ("backward", "base")
    assert asked == [("e", "rival"), (("e",), {"E": "at its bound"}), ("again", []), ("rival",)], "what is new was asked in its round"
    assert looped(monkeypatch, [], trial("e", 0.5), 3).dropped == ()


def test_what_no_run_of_the_last_round_could_judge_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither pairs, whose parts may be judged alone, nor what was judged and refused."""
    trials = [trial("a", 0.1, "failed", unjudged=True), trial("b c", 0.1, "failed", unjudged=True), trial("d", 0.1, "refused")]
    assert looped(monkeypatch, trials, None, 3).unjudged == {"lamp": "no run", "a": "failed"}
    assert looped(monkeypatch, trials, trial("e", 0.5), 3).unjudged == {"lamp": "no run", "late": "no run"}, "a later round may judge it"


def test_the_loop_ends_with_the_backward_check_and_then_the_base_model(monkeypatch: pytest.MonkeyPatch) -> None:
    assert looped(monkeypatch, [], None, 3).remarks == ("backward", "base")


@pytest.mark.parametrize(
    ("accepted", "f", "base", "goes"),
    [((), 101.0, 100.0, True), ((), 99.0, 100.0, False), (("a",), 101.0, 100.0, False), ((), 101.0, None, False)],
    ids=["stopped short", "went on", "something is added", "no optimum of the last problem"],
)
def test_where_nothing_is_added_in_the_end_the_answer_is_the_base_model_at_its_optimum(
    accepted: tuple[str, ...], f: float, base: float | None, goes: bool
) -> None:
    """A refit without what was taken back may stop short of it."""
    fits: Any = [SimpleNamespace(f=f), None if base is None else SimpleNamespace(f=base)]
    first: Any = "first"
    last: Any = "last"
    refit: Any = None
    found = Closed((), first, last, fits[0], accepted, (), refit, None, base=fits[1]).as_base()
    assert (found.last, found.fit) == (("first", fits[1]) if goes else ("last", fits[0]))


def test_what_was_worth_a_refit_when_the_loop_was_full_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    assert looped(monkeypatch, [], trial("e", 0.5), 1).open_ones == ("rival",)
    assert looped(monkeypatch, [], trial("e", 0.5), 2).open_ones == ()


def among(cheap: bool, promising: tuple[Score, ...], others: tuple[Score, ...] = ()) -> list[str]:
    """Candidates of a ranking with threshold 3; the later a promising one comes, the more it gains."""
    proofs = {s.effect: replace(GOOD, gain=0.1 * k) for k, s in enumerate(promising)}
    ranking = SimpleNamespace(scores=(*promising, *others), threshold=3.0)
    here: Any = SimpleNamespace(case=SimpleNamespace(cheap=cheap), promising=lambda: promising, proofs=proofs, ranking=ranking)
    return [s.effect for s in candidates(here)]


def test_candidates_of_a_body_are_the_first_and_those_with_the_largest_gains() -> None:
    found = among(False, tuple(score(n) for n in "abcdef"), (score("g"),))
    assert found == ["a", "f", "e", "d"] and len(found) == MOST_TRIED


def test_candidates_of_coupons_are_all_that_passes_families_first() -> None:
    others = (
        score("over", 8.0),
        score("numerical", 7.0, predicted_drop=3.9, numerical_drop=1.0),
        score("alike", 6.0, predicted_drop=3.9, numerical_drop=1.0),
        score("below", 2.9),
        score("impossible", 9.0, vetoed="outside its bounds"),
    )
    assert among(True, (score("a", 9.0, ("alike",)), score("b")), others) == ["a", "b", "alike", "over"]
    assert len(among(True, tuple(score(str(k)) for k in range(12)))) == TRIED_WHERE_CHEAP


@pytest.mark.parametrize(
    ("name", "value", "near"),
    [
        ("rate_logarithmic.reference", 2e-7, True),
        ("rate_logarithmic.reference", 5e-9, False),
        ("rate_logarithmic.reference", 0.2, False),
        ("backstress_second.gamma", 7500.0, False),
        ("backstress_second.gamma", 4000.0, True),
        ("thermal_softening.reference", 5.0, True),
    ],
)
def test_an_exponent_that_has_run_away_from_what_is_tried_is_not_held_there(name: str, value: float, near: bool) -> None:
    """Between the values that are tried, or one distance beyond: a factor where all are positive."""
    assert near_scan(param(name), value) is near


@pytest.mark.parametrize(
    ("gain", "refused", "words"),
    [
        (0.5, "", ""),
        (0.4, "", "less than a"),
        (0.6, "", "better than a by no more than a standard error"),
        (0.6, "at a bound", "at a bound"),
    ],
)
def test_why_a_trial_was_not_added(gain: float, refused: str, words: str) -> None:
    """The simplest of those that predict about as well is added: another one may have the larger gain, and its remark says so."""
    added = trial("a", 0.5)
    other = added if not words else trial("b", gain, refused)
    turn: Any = SimpleNamespace(trials=(other, added), accepted=("a",))
    assert remark_of(other, turn).startswith(words) and bool(remark_of(other, turn)) is bool(words)
