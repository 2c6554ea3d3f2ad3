"""Effects that displacements alone are asked for, where what is missing has driven the mechanical parameters far off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import on_displacements as module
from thermofit.diagnose.on_displacements import by_displacements
from thermofit.diagnose.trial import Trial, nearer
from thermofit.effects.catalogue import effect

N = 1000
KNOWN = tuple(map(effect, ("rate_power", "rate_logarithmic", "second_hardening", "backstress_first", "lamp", "hardening_curve")))
DROPS = {"backstress_first": 900.0, "second_hardening": 800.0, "rate_power": 300.0, "rate_logarithmic": 200.0, "lamp": 950.0}


@dataclass
class Mechanics:
    """Stands in for fits to the displacements alone: where every effect ends, and what was asked."""

    ends: dict[str, float]
    alone: float = 16.0 * N
    asked: list[tuple[str, Parameters, float]] = field(default_factory=list)

    def __call__(self, start: Parameters, label: str, to_beat: float) -> Any:
        name = label.split()[0]
        if label == "nothing added on displacements":
            if np.isnan(self.alone):
                raise NumericsError("no equilibrium")
            return start, SimpleNamespace(f=self.alone)
        assert label == f"{name} on displacements"
        self.asked.append((name, start, to_beat))
        if name not in self.ends:
            raise NumericsError("no equilibrium")
        return start.replace(E=200.0), SimpleNamespace(f=self.ends[name])


def trace(mechanics: Mechanics | None, du: float = 4.0, cheap: bool = False) -> Any:
    """A trace whose displacements are at `du` times their noise; the linear step of backstress_first cannot be."""
    parameters = Parameters.of({"E": 500.0, "kappa": 50.0, "theta_ref": 296.0}, ("E", "kappa"))
    model = SimpleNamespace(comparisons=(SimpleNamespace(channel="du", n=N), SimpleNamespace(channel="dtheta", n=100)))
    case = SimpleNamespace(
        parameters=parameters, known=KNOWN, cheap=cheap, mechanics=mechanics, model=model, spans=(), largest_strain=0.1, placed=None
    )
    scores = tuple(
        SimpleNamespace(
            effect=n, predicted_drop=d, vetoed="C would be -1" if n == "backstress_first" else "", estimate={effect(n).amplitude.name: 8.0}
        )
        for n, d in DROPS.items()
    )
    rows = SimpleNamespace(channel=np.repeat([0, 1], [N, 100]), time=np.linspace(0.0, 10.0, N + 100), xy=np.zeros((N + 100, 2)))
    residual = np.concatenate([np.full(N, du), np.full(100, 5.0)])
    problem, columns = SimpleNamespace(may_be_left=None), SimpleNamespace(residual=residual)
    return Here(case, columns, rows, SimpleNamespace(scores=scores), problem, {n: {} for n in DROPS})


@dataclass(frozen=True)
class Here:
    """What is read of a trace."""

    case: Any
    columns: Any
    rows: Any
    ranking: Any
    problem: Any
    settings: Any
    from_displacements: Any = field(default_factory=dict)


def gains(monkeypatch: pytest.MonkeyPatch, **of: float) -> list[tuple[str, Any]]:
    """Full refits that are accepted with these gains; what was tried, and where each began."""
    made: list[tuple[str, Any]] = []

    def tried(here: Any, fit: Any, score: Any, means: Any) -> Any:
        made.append((score.effect, here.from_displacements))
        trial: Any = SimpleNamespace(effects=(score.effect,), gain=of.get(score.effect, 0.0), unjudged=False)
        return trial, ("end", "fit") if score.effect in of else None

    monkeypatch.setattr(module, "tried", tried)
    return made


ENDS = {"backstress_first": 12.0 * N, "second_hardening": 14.0 * N, "rate_power": 1.5 * N, "rate_logarithmic": 1.1 * N}


def test_what_displacements_show_is_refitted_from_where_they_have_brought_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Most of a linear step first, though that cannot be; each has to come below what the best so far has left. Effects of heat, those that
    were tried, and the curve are not asked."""
    mechanics, made = Mechanics(ENDS), gains(monkeypatch, rate_power=0.7, rate_logarithmic=0.8)
    before: Sequence[Any] = (SimpleNamespace(effects=("second_hardening",), unjudged=False),)
    trials, winner = by_displacements(trace(mechanics), None, None, before)  # type: ignore[arg-type]
    assert [name for name, *_ in mechanics.asked] == ["backstress_first", "rate_power", "rate_logarithmic"]
    assert [to_beat for *_, to_beat in mechanics.asked] == [np.inf, 12.0 * N, 1.5 * N]
    first, second = (start for _, start, _ in mechanics.asked[:2])
    assert first["backstress_first.C"] == effect("backstress_first").amplitude.probe and second["rate_power.K"] == 8.0
    assert set(second.free) == {"E", "kappa", "rate_power.K"}, "exponents are held"
    assert [name for name, _ in made] == ["rate_logarithmic", "rate_power"], "the best first, and what takes nearly as much"
    assert made[0][1]["rate_logarithmic"]["E"] == 200.0
    assert winner is not None and winner[0].effects == ("rate_logarithmic",) and len(trials) == 2


def test_what_takes_less_than_half_is_not_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    made = gains(monkeypatch, rate_power=0.7)
    none = by_displacements(trace(Mechanics(dict.fromkeys(ENDS, 9.0 * N))), None, None, ())  # type: ignore[arg-type]
    assert none == ([], None) and not made
    failing = Mechanics({})
    trials, winner = by_displacements(trace(failing), None, None, ())  # type: ignore[arg-type]
    assert winner is None and len(failing.asked) == len(trials) == 4
    assert all(t.unjudged and t.refused == "its fit to the displacements alone failed: no equilibrium" for t in trials)


def test_where_the_fit_without_any_effect_fails_none_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    gains(monkeypatch)
    mechanics = Mechanics(ENDS, float("nan"))
    trials, winner = by_displacements(trace(mechanics), None, None, ())  # type: ignore[arg-type]
    assert winner is None and not mechanics.asked and {t.effects[0] for t in trials} == set(ENDS)
    assert all(t.unjudged and "without it failed: no equilibrium" in t.refused for t in trials)


def test_when_displacements_are_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """At their floor, where the winner of the round has taken nine tenths of what they held, of coupons, and without displacements."""
    mechanics = Mechanics(ENDS)
    gains(monkeypatch)
    nearly: Any = (SimpleNamespace(effects=("rate_power",), gain=0.5), (trace(mechanics, 1.1), None))
    half: Any = (SimpleNamespace(effects=("second_hardening",), gain=0.5), (trace(mechanics, 3.0), None))
    assert by_displacements(trace(mechanics), None, None, (), nearly) == ([], nearly)  # type: ignore[arg-type]
    for here in (trace(mechanics, 1.0), trace(mechanics, cheap=True), trace(None)):
        assert by_displacements(here, None, None, (), half) == ([], half)  # type: ignore[arg-type]
    assert not mechanics.asked
    assert by_displacements(trace(mechanics), None, None, (), half)[1] is half, "nothing else was accepted"  # type: ignore[arg-type]
    assert mechanics.asked


def test_what_an_effect_takes_is_told_beside_the_same_fit_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Temperatures had drawn the parameters off; and what is left without that is no more than an effect has to take."""
    made = gains(monkeypatch, rate_power=0.7)
    for alone, asked in ((1.9 * N, True), (1.003 * N, False)):
        mechanics = Mechanics(dict.fromkeys(ENDS, 1.6 * N), alone)
        by_displacements(trace(mechanics), None, None, ())  # type: ignore[arg-type]
        assert bool(mechanics.asked) is asked
    assert not made, "0.3 of 0.9 is less than half"


def test_no_further_effect_is_asked_once_two_leave_hardly_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    gains(monkeypatch)
    mechanics = Mechanics({**ENDS, "backstress_first": 1.2 * N, "second_hardening": 1.3 * N})
    by_displacements(trace(mechanics), None, None, ())  # type: ignore[arg-type]
    assert [name for name, *_ in mechanics.asked] == ["backstress_first", "second_hardening"]


def test_a_refit_begins_where_the_displacements_have_brought_it() -> None:
    """Mechanical parameters, amplitude and exponents of that end; what temperatures feel stays. From nearer to neutral as without it."""
    here = trace(None)
    from_displacements = here.case.parameters.replace(
        **{"E": 210.0, "kappa": 1.0, "rate_power.K": 90.0, "rate_power.m": 0.1, "rate_power.reference": 1e-3}
    )
    here = SimpleNamespace(**{**vars_of(here), "from_displacements": {"rate_power": from_displacements}, "shown": {}})
    begun: list[Parameters] = []

    def refit(start: Parameters, label: str, exponents: bool = False) -> Any:
        begun.append(start)
        if len(begun) == 1:
            raise NumericsError("no equilibrium")
        return start, None

    score: Any = SimpleNamespace(effect="rate_power", estimate={"rate_power.K": 8.0})
    nearer(here, (score,), {"rate_power.m": 0.1, "rate_power.reference": 1e-3}, refit)  # type: ignore[arg-type]
    assert (begun[0]["E"], begun[0]["kappa"], begun[0]["rate_power.K"], begun[0]["rate_power.m"]) == (210.0, 50.0, 90.0, 0.1)
    assert begun[1]["E"] == 500.0 and begun[1]["rate_power.K"] < 8.0


def vars_of(here: Here) -> dict[str, Any]:
    return {name: getattr(here, name) for name in here.__dataclass_fields__}


def test_a_trial_that_failed_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    mechanics = Mechanics(ENDS)
    gains(monkeypatch)
    failed = Trial((SimpleNamespace(effect="rate_power"),), None, {}, {}, 0.0, "the refit failed", unjudged=True)  # type: ignore[arg-type]
    by_displacements(trace(mechanics), None, None, (replace(failed),))  # type: ignore[arg-type]
    assert "rate_power" in [name for name, *_ in mechanics.asked]
