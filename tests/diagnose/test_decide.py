"""Test programmes that part what a monotonic test cannot: rate dependence and thermal softening, isotropic and kinematic hardening."""

from __future__ import annotations

import pytest

from thermofit.core.parameters import Parameters
from thermofit.diagnose.decide import Decision, Told, columns, in_words
from thermofit.diagnose.score import ALIKE, likeness
from thermofit.effects.catalogue import effect
from thermofit.point.programmes import Usual, named

LAW = Parameters.of(
    {
        **{"E": 200e3, "nu": 0.3, "M_y0": 300.0, "M_yinf": 500.0, "H_exp": 30.0, "alpha_exp": 12e-6, "c0": 3.65, "beta": 1.0},
        **{"tau": 40.0, "theta_air": 293.15, "theta_ref": 293.15},
    },
    ("E", "M_y0", "M_yinf", "H_exp", "tau"),
)
USUAL = Usual(0.05, 1e-3, 293.15)
NOISE = (0.5, 0.02)


def cosine(programme: str, *names: str) -> float:
    own = columns(named(programme), USUAL, LAW, tuple(effect(n) for n in names), NOISE)
    assert own is not None and set(own) == set(names)
    return max(cos for (a, b), cos in likeness(own).items() if a != b)


def test_cycles_part_a_backstress_from_isotropic_hardening() -> None:
    pair = ("backstress_first", "linear_hardening")
    assert cosine("monotonic", *pair) > ALIKE > cosine("cycles", *pair)


def test_stepped_rates_show_rate_dependence_best() -> None:
    size = {}
    for programme in ("monotonic", "stepped-rates"):
        own = columns(named(programme), USUAL, LAW, (effect("rate_logarithmic"),), NOISE)
        assert own is not None
        size[programme] = float((own["rate_logarithmic"] ** 2).sum() ** 0.5)
    assert size["stepped-rates"] > 5.0 * size["monotonic"]


def test_a_decision_names_the_simplest_programme_that_parts() -> None:
    told = tuple(Told(named(n), cos, {"a": 1.0, "b": 2.0}) for n, cos in (("monotonic", 0.99), ("load-unload", 0.6), ("cycles", 0.1)))
    decision = Decision(("a", "b"), told, ())
    assert decision.best is not None and decision.best.programme.name == "load-unload"
    assert in_words(decision).startswith("a and b: the programme load-unload") and "|cos| 0.60" in in_words(decision)
    assert "no coupon feels b" in in_words(Decision(("a", "b"), told, ("b",)))
    assert "none of the programmes" in in_words(Decision(("a", "b"), told[:1], ()))


@pytest.mark.parametrize("name", ["rate_logarithmic", "backstress_first"])
def test_one_effect_is_shown_best_by_the_programme_with_the_smallest_amplitude(name: str) -> None:
    told = (Told(named("monotonic"), 0.0, {name: 0.5}), Told(named("cycles"), 0.0, {name: 0.1}))
    best = Decision((name,), told, ()).best
    assert best is not None and best.programme.name == "cycles"
