"""A hardening of no listed form on a body: told as a curve, with the other parameters where they were."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from thermofit.cli.printing import unlisted_lines
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import any_form
from thermofit.diagnose.any_form import of_any_form, or_any_form
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.loop import Closed, Round
from thermofit.diagnose.trial import Trial
from thermofit.effects.catalogue import effect, effects
from thermofit.effects.hardening_curve import N, yield_stress
from thermofit.report.html.gather import unlisted_words
from thermofit.report.unlisted import curve_of, in_words, with_any_form

CURVE = effect("hardening_curve")
STEPS = tuple(p.name for p in CURVE.amplitudes)
FREE = ("E", "M_y0", "M_yinf", "H_exp", "kappa")


@pytest.fixture(autouse=True)
def law_that_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """How the law is fitted beside the curve is asked in `test_curve_and_law`."""
    monkeypatch.setattr(any_form, "fitted_law", lambda end, *_: (end, ""))


def test_it_names_nothing_and_is_no_candidate() -> None:
    assert [e.name for e in effects() if e.last] == ["hardening_curve"]
    from thermofit.diagnose.case import Case

    model: Any = SimpleNamespace()
    case = Case(model, Parameters.of({}), (CURVE, effect("lamp")), (), frozenset())
    assert case.dormant() == (effect("lamp"),)


def test_steps_follow_any_smooth_curve() -> None:
    """A bump of 8 MPa over 0.012 at 0.03 of 0.18, to a hundredth where the steps are; the level is that at first yield, and steps begin at
    nothing there."""
    strain = np.linspace(0.0, 0.18, 400)
    wanted = 8.0 * np.exp(-(((strain - 0.03) / 0.012) ** 2))
    for reach, most, rms in ((0.18, 0.9, 0.25), (0.09, 0.06, 0.015)):
        columns = np.stack([yield_stress(strain, 0.0, 0.0, None, *np.eye(N + 1)[k], reach) for k in range(N + 1)], axis=1)
        found = columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
        assert np.abs(found - wanted).max() < most and np.sqrt(np.mean((found - wanted) ** 2)) < rms
        assert columns[0] == pytest.approx(np.eye(N + 1)[0], abs=1e-15)
        assert np.linalg.cond(columns) < 1e3


def traced(du: float, cheap: bool = False, known: Any = (CURVE,), on: bool = False, alone: float | None = None) -> Any:
    """A trace whose displacements are at `du` times their noise, by a fit to them alone at `alone` times (None: there is none, nan: it
    fails); temperatures are far beyond theirs."""

    def mechanics(start: Parameters, label: str, to_beat: float) -> Any:
        assert alone is not None and label == "nothing added on displacements"
        if np.isnan(alone):
            raise NumericsError("no equilibrium")
        return start, SimpleNamespace(f=200.0 * alone**2)

    channels = (SimpleNamespace(channel="du", n=200), SimpleNamespace(channel="dtheta", n=100))
    residual = np.concatenate([np.full(200, du), np.full(100, 5.0)])
    values = {"hardening_curve.level": 2.0} if on else {}
    case = SimpleNamespace(
        known=known,
        cheap=cheap,
        parameters=Parameters.of({"M_y0": 130.0, **values}, FREE),
        model=SimpleNamespace(comparisons=channels),
        largest_strain=0.18,
        mechanics=None if alone is None else mechanics,
    )
    rows = SimpleNamespace(channel=np.repeat([0, 1], [200, 100]))
    return SimpleNamespace(
        case=case, columns=SimpleNamespace(residual=residual), rows=rows, problem=SimpleNamespace(may_be_left=np.zeros(300))
    )


def means(asked: list[Parameters]) -> Any:
    def refit(start: Parameters, label: str, exponents: bool = False) -> Any:
        assert label.startswith("hardening_curve")
        asked.append(start)
        return start, SimpleNamespace(f=(300.0, 200.0, 250.0, 140.0, 80.0, 80.0)[(len(asked) - 1) % 6], converged=True)

    return SimpleNamespace(refit=refit)


@pytest.mark.parametrize(
    ("here", "why"),
    [
        (traced(1.2), "displacements are at their floor, whatever temperatures are"),
        (traced(9.0, cheap=True), "coupons have a law over their state"),
        (traced(9.0, known=(effect("lamp"),)), "the driver does not know it"),
        (traced(9.0, on=True), "it is on"),
        (traced(9.0, alone=1.0), "a fit to the displacements alone leaves nothing, and temperatures drew the law away"),
        (traced(9.0, alone=1.1), "it leaves less than an effect has to take"),
    ],
)
def test_when_it_is_not_asked(here: Any, why: str) -> None:
    asked: list[Parameters] = []
    assert of_any_form(here, None, means(asked)) == ([], None), why  # type: ignore[arg-type]
    assert not asked


def test_it_is_fitted_with_the_hardening_law_held(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Trial((any_form.hidden("hardening_curve"),), None, {}, {}, 0.0, "")
    ends: list[Any] = []

    def judged(here: Any, fit: Any, scores: Any, end: Any, means: Any) -> Any:
        ends.append(end)
        return told, ("there", "fit")

    monkeypatch.setattr(any_form, "judged_trial", judged)
    asked: list[Parameters] = []
    trials, winner = of_any_form(traced(9.0), None, means(asked))  # type: ignore[arg-type]
    assert asked[0].free == ("E", "kappa", *STEPS)
    assert [p["hardening_curve.range"] for p in asked[:4]] == [0.18, 0.09, 0.045, 0.09], "the best of three, then"
    assert asked[3].free == (*asked[0].free, "hardening_curve.range"), "with the steps where they are wanted"
    assert len(asked) == 6 and ends[0][0] is asked[4] and ends[0][1].f == 80.0, "on as long as it falls"
    assert winner == (trials[0], ("there", "fit")) and trials[0].exponents == "the hardening law is held; fitted"
    by_themselves = of_any_form(traced(9.0, alone=1.2), None, means([]))  # type: ignore[arg-type]
    assert by_themselves == (trials, winner), "displacements alone ask for it"
    unknown = of_any_form(traced(9.0, alone=np.nan), None, means([]))[0][0]  # type: ignore[arg-type]
    assert unknown.exponents.endswith("whether displacements alone ask for it is not known: the fit to them failed (no equilibrium)")
    monkeypatch.setattr(any_form, "judged_trial", lambda *_: (replace(told, refused="no"), None))
    assert of_any_form(traced(9.0), None, means(asked))[1] is None  # type: ignore[arg-type]

    def fails(*_: Any) -> Any:
        raise NumericsError("no equilibrium")

    failed, none = of_any_form(traced(9.0), None, SimpleNamespace(refit=fails))  # type: ignore[arg-type]
    assert none is None and failed[0].refused == "the refit failed: no equilibrium" and failed[0].unjudged


def test_the_law_is_fitted_beside_the_curve_before_it_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Trial((any_form.hidden("hardening_curve"),), None, {}, {}, 0.0, "")
    judged: list[Any] = []
    monkeypatch.setattr(any_form, "judged_trial", lambda _h, _f, _s, end, _m: judged.append(end) or (told, ("there", "fit")))

    def fitted_law(end: Any, own: Any, model: Any, largest: float, refit: Any) -> Any:
        assert own is CURVE and largest == 0.18
        return refit(end[0].replace(M_yinf=300.0), "hardening_curve law 0"), "M_yinf = 300: fitted with it"

    monkeypatch.setattr(any_form, "fitted_law", fitted_law)
    asked: list[Parameters] = []
    ((trial,), _) = of_any_form(traced(9.0), None, means(asked))  # type: ignore[arg-type]
    assert judged[0][0] is asked[-1] and asked[-1]["M_yinf"] == 300.0
    assert trial.exponents == "M_yinf = 300: fitted with it; fitted"


@pytest.mark.parametrize(("fell", "fitted"), [(69.0, True), (71.0, False)])
def test_what_is_stored_is_fitted_with_the_curve(monkeypatch: pytest.MonkeyPatch, fell: float, fitted: bool) -> None:
    """With all that the curve has, from its end, and kept where it takes ten; never where temperatures are not fitted, or the study
    has it on already."""
    asked: list[Parameters] = []
    ends: list[Any] = []

    def refit(start: Parameters, label: str, exponents: bool = False) -> Any:
        asked.append(start)
        return start, SimpleNamespace(f=fell if label.endswith("stored_energy") else 80.0, converged=True)

    told = Trial((any_form.hidden("hardening_curve"),), None, {}, {}, 0.0, "")
    monkeypatch.setattr(any_form, "judged_trial", lambda _h, _f, _s, end, _m: ends.append(end) or (told, ("there", "fit")))
    stored = effect("stored_energy")
    ((trial,), _) = of_any_form(traced(9.0, known=(CURVE, stored)), None, SimpleNamespace(refit=refit))  # type: ignore[arg-type]
    assert asked[-1].free == (*asked[-2].free, "stored_energy.slope") and (ends[0][0] is asked[-1]) is fitted
    assert ("stored_energy.slope = 0 is fitted with it" in trial.exponents) is fitted
    count = len(asked)
    cold, warm = traced(9.0, known=(CURVE, stored)), traced(9.0, known=(CURVE, stored))
    cold.case.parameters = cold.case.parameters.with_free(("E", "M_y0"))
    warm.case.parameters = warm.case.parameters.replace(**{"stored_energy.slope": 0.3})
    for here in (cold, warm):
        of_any_form(here, None, SimpleNamespace(refit=refit))  # type: ignore[arg-type]
    assert not any("stored_energy.slope" in p.free for p in asked[count:])


@pytest.mark.parametrize(
    ("gain", "leaves", "apart", "asked", "wins"),
    [
        (None, True, True, True, "hardening_curve"),
        (0.4, False, True, False, "lamp"),
        (0.4, True, True, True, "hardening_curve"),
        (0.4, True, False, True, "lamp"),
        (0.9, True, True, True, "lamp"),
    ],
)
def test_it_wins_where_the_winner_leaves_more_than_it_takes(
    monkeypatch: pytest.MonkeyPatch, gain: float | None, leaves: bool, apart: bool, asked: bool, wins: str
) -> None:
    """And where held-out data tell it from the winner: else a name stands."""
    made: list[str] = []

    def trial(name: str, gain: float) -> Trial:
        return Trial((any_form.hidden(name),), Proof(2.0, 1.0, {}, gain, 0.01, 5), {}, {}, 0.0, "")

    def of_any_form(*_: Any) -> Any:
        made.append("asked")
        curve = trial("hardening_curve", 0.8)
        return [curve], (curve, ("end of the curve", "fit"))

    monkeypatch.setattr(any_form, "of_any_form", of_any_form)
    monkeypatch.setattr(any_form, "leaves_more_than_it_takes", lambda *_: leaves)
    gains = {"end": gain or 0.0, "end of the curve": 0.8}
    monkeypatch.setattr(any_form, "surely_better", lambda one, other: apart and gains[one] > gains[other])
    winner: Any = None if gain is None else (trial("lamp", gain), ("end", "fit"))
    nothing: Any = None
    trials, found = or_any_form(nothing, nothing, nothing, [], winner, nothing)
    assert bool(made) is asked and len(trials) == len(made)
    assert found is not None and found[0].effects == (wins,)


@pytest.mark.parametrize(
    ("name", "left", "asked"),
    [("rate_power", 2.0, True), ("thermal_softening", 2.0, True), ("backstress_first", 2.0, True), ("linear_hardening", 2.0, True),
     ("rate_power", 1.5, False), ("hill_anisotropy", 2.0, False), ("lamp", 2.0, False), ("elastic_degradation", 2.0, False)],
)  # fmt: skip
def test_it_is_asked_for_where_a_law_of_the_flow_leaves_more_than_a_tenth(
    monkeypatch: pytest.MonkeyPatch, name: str, left: float, asked: bool
) -> None:
    """Though it takes most: of 16 - 1 times the square of the noise in displacements 3 are left, or 1.25. What does not act on the flow
    stress is no law of another form."""
    made: list[str] = []

    def of_any_form(*_: Any) -> Any:
        made.append("asked")
        return [], None

    monkeypatch.setattr(any_form, "of_any_form", of_any_form)
    monkeypatch.setattr(any_form, "leaves_more_than_it_takes", lambda *_: False)
    nothing: Any = None
    winner: Any = (Trial((any_form.hidden(name),), Proof(2.0, 1.0, {}, 0.8, 0.01, 5), {}, {}, 0.0, ""), (traced(left), "fit"))
    here = traced(4.0)
    assert or_any_form(here, nothing, nothing, [], winner, here) == ([], winner) and bool(made) is asked


def test_what_is_at_its_floor_is_of_no_other_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """However little there was before."""
    winner: Any = (Trial((any_form.hidden("rate_power"),), None, {}, {}, 0.0, ""), (traced(1.01), "fit"))
    assert not any_form.of_another_form(traced(1.04), winner)


def test_a_fit_over_fewer_strains_begins_with_the_curve_of_the_best_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which is that of the first: half of the strains go on from it, and so does a quarter, for the half was worse."""
    told = Trial((any_form.hidden("hardening_curve"),), None, {}, {}, 0.0, "")
    monkeypatch.setattr(any_form, "judged_trial", lambda *_: (told, ("there", "fit")))
    monkeypatch.setattr(any_form, "freed_refit", lambda *_: (None, ""))
    found = {"hardening_curve.level": -2.0, "hardening_curve.step2": 5.0, "hardening_curve.step4": -3.0}
    begun: list[Parameters] = []

    def refit(start: Parameters, label: str, exponents: bool = False) -> Any:
        begun.append(start)
        at = start.replace(**found) if label.endswith(" 0") else start.replace(**{"hardening_curve.level": 50.0})
        return at, SimpleNamespace(f=50.0 if label.endswith(" 0") else 80.0, converged=True)

    of_any_form(traced(9.0), None, SimpleNamespace(refit=refit))  # type: ignore[arg-type]
    assert begun[0].free == begun[1].free == begun[2].free and not any(begun[0][n] for n in STEPS)
    strain = np.linspace(0.0, 0.18, 50)

    def curve(at: Parameters, reach: float) -> np.ndarray:
        return np.asarray(yield_stress(strain, 0.0, 0.0, None, *(at[n] for n in STEPS), reach))

    wanted = curve(begun[0].replace(**found), 0.18)
    for k, (reach, off) in enumerate(((0.18, 1e-12), (0.09, 0.06), (0.045, 1.0))):
        assert begun[k]["hardening_curve.range"] == reach
        if k:
            assert np.abs(curve(begun[k], reach) - wanted).max() < off


@pytest.mark.parametrize(("now", "asked"), [(1.5, False), (1.7, True)])
def test_a_form_that_is_listed_and_takes_nine_tenths_is_the_form(monkeypatch: pytest.MonkeyPatch, now: float, asked: bool) -> None:
    """Of 16 - 1 times the square of the noise in displacements 1.25 or 1.89 are left; temperatures do not count."""
    made: list[str] = []

    def of_any_form(*_: Any) -> Any:
        made.append("asked")
        return [], None

    monkeypatch.setattr(any_form, "of_any_form", of_any_form)
    nothing: Any = None
    first = traced(4.0)
    or_any_form(traced(now), nothing, nothing, [], None, first)
    assert bool(made) is asked
    or_any_form(first, nothing, nothing, [], None, first)
    assert len(made) == 1 + asked, "where nothing was added yet it is asked"


def test_strains_over_which_it_cannot_be_run_are_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Trial((any_form.hidden("hardening_curve"),), None, {}, {}, 0.0, "")
    monkeypatch.setattr(any_form, "judged_trial", lambda *_: (told, ("there", "fit")))

    def refit(start: Parameters, label: str, exponents: bool = False) -> Any:
        if label.endswith(" 2"):
            raise NumericsError("no equilibrium")
        return start, SimpleNamespace(f=100.0, converged=True)

    trials, winner = of_any_form(traced(9.0), None, SimpleNamespace(refit=refit))  # type: ignore[arg-type]
    assert winner is not None and not trials[0].unjudged
    assert trials[0].exponents.endswith("; 1 of 3 ranges of strain could not be run (no equilibrium)")


def test_a_curve_that_has_not_settled_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Trial((any_form.hidden("hardening_curve"),), None, {}, {}, 0.0, "")
    monkeypatch.setattr(any_form, "judged_trial", lambda *_: (told, ("there", "fit")))
    left = iter(100.0 * 0.9**k for k in range(20))

    def refit(start: Parameters, label: str, exponents: bool = False) -> Any:
        return start, SimpleNamespace(f=next(left), converged=True)

    trials, _ = of_any_form(traced(9.0), None, SimpleNamespace(refit=refit))  # type: ignore[arg-type]
    assert trials[0].exponents.endswith("; not settled after 5 further refits")


def test_beside_it_only_what_temperatures_show_is_asked() -> None:
    """Of what a curve leaves in displacements any effect would take some."""
    from thermofit.diagnose.any_form import beside_any_form
    from thermofit.diagnose.score import Ranking

    names = ("dic_scale", "lamp", "force_offset", "clamp_drift", "ir_drift")
    ranking = Ranking(tuple(any_form.hidden(n) for n in names), 3.0, ())

    @dataclass(frozen=True)
    class Ranked:
        ranking: Ranking

    here: Any = Ranked(ranking)
    assert [s.effect for s in beside_any_form(here, ("hardening_curve",)).ranking.scores] == ["lamp", "clamp_drift", "ir_drift"]
    assert beside_any_form(here, ("second_hardening",)) is here


def test_what_is_said_of_it() -> None:
    """The curve with its standard error, grade `unlisted`, no trust."""
    matrix = np.diag(np.append(0.0, np.full(N + 1, 0.04)))
    spread: Any = SimpleNamespace(matrix=matrix)
    fit: Any = SimpleNamespace(names=("E", *STEPS), covariance=spread)
    values = {"hardening_curve.level": 1.0, "hardening_curve.step2": 8.0, "hardening_curve.range": 0.18}
    first = traced(9.0)
    last = SimpleNamespace(case=SimpleNamespace(parameters=Parameters.of(values), largest_strain=0.18))
    first.case.channels = ("du", "dtheta")
    trial = Trial((any_form.hidden("hardening_curve"),), None, {}, {}, 0.0, "")
    rounds = (Round(first, (trial,), ("hardening_curve",)),)
    closed = Closed(rounds, first, last, fit, ("hardening_curve", "lamp"), (), None, None)  # type: ignore[arg-type]
    curve = curve_of(closed, CURVE)
    assert curve["largest_MPa"] == pytest.approx(9.0, abs=1e-6) and curve["stress_MPa"][0] == pytest.approx(1.0)
    assert curve["sigma_MPa"][0] == pytest.approx(0.2) and curve["sigma_MPa"][-1] > 0.5
    summary = {"verdict": "added", "grade": "named", "trustworthy": True, "unlisted": None}
    told = with_any_form(summary, closed)
    assert told["grade"] == "unlisted" and told["trustworthy"] is False and told["unlisted"]["balance"] == "stress"
    assert in_words(told["unlisted"]).startswith("a yield stress over accumulated plastic strain, up to ")
    assert "beside lamp" in in_words(told["unlisted"])
    text = io.StringIO()
    unlisted_lines(Console(file=text, width=160), told["unlisted"])
    assert "unlisted  a yield stress over accumulated plastic strain, up to 9 MPa, in du" in text.getvalue()
    assert "is systematic" in unlisted_words(told["unlisted"])
    heat = {"verdict": "added; unlisted", "grade": "unlisted", "trustworthy": False, "unlisted": {"channel": "dtheta"}}
    assert with_any_form(heat, closed)["unlisted"] == {"channel": "dtheta"} and "hardening_curve" in with_any_form(heat, closed)
    assert with_any_form(summary, replace(closed, accepted=("lamp",))) is summary
