"""Test programmes that part what a monotonic test cannot: rate dependence and thermal softening, isotropic and kinematic hardening."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from record_case import NOISE as RECORD
from record_case import TRUTH, case_of, study
from refits import fitted, refitting

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.decide import (
    Decision,
    added_families,
    at_point,
    columns,
    decided,
    decisions,
    in_words,
    sensitive_at_point,
)
from thermofit.diagnose.decide_specimen import Discrimination
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.score import ALIKE, likeness
from thermofit.diagnose.trace import Traced
from thermofit.effects.catalogue import effect
from thermofit.experiment.coupon_check import record_spans
from thermofit.experiment.coupon_model import coupon_model
from thermofit.experiment.coupon_records import CouponData, CouponTest
from thermofit.experiment.fields import TestPhase
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.point.programmes import Usual, named
from thermofit.point.programmes import programme as made

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
    told = tuple(
        Discrimination(named(n), cos, {"a": 1.0, "b": 2.0}) for n, cos in (("monotonic", 0.99), ("load-unload", 0.6), ("cycles", 0.1))
    )
    decision = Decision(("a", "b"), told, ())
    assert decision.best is not None and decision.best.programme.name == "load-unload"
    assert in_words(decision).startswith("a and b: the programme load-unload") and "|cos| 0.60" in in_words(decision)
    assert "none of the programmes" in in_words(Decision(("a", "b"), told[:1], ()))


def test_a_member_that_no_coupon_feels_does_not_hide_what_is_told_of_the_others() -> None:
    told = (Discrimination(named("monotonic"), 0.99, {"a": 1.0, "b": 2.0}), Discrimination(named("cycles"), 0.1, {"a": 1.0, "b": 2.0}))
    said = in_words(Decision(("a", "lamp", "b"), told, ("lamp",)))
    assert "the programme cycles" in said and said.endswith("; a coupon test cannot show lamp, which acts on the field of temperature")
    alone = in_words(Decision(("a", "lamp"), (Discrimination(named("hold"), 0.0, {"a": 0.5}),), ("lamp",)))
    assert "the programme hold" in alone and "it shows a from 0.5 on; a coupon test cannot show lamp" in alone
    assert in_words(Decision(("lamp",), (), ("lamp",))) == "lamp: a coupon test cannot show lamp, which acts on the field of temperature"


@pytest.mark.parametrize(
    ("name", "what"),
    [
        *(
            ("lamp", "temperature"),
            ("clamp_conductance", "temperature"),
            ("ir_drift@second", "temperature"),
            ("latent_heat", "temperature"),
        ),
        *(("dic_scale", "displacement"), ("bending", "displacement"), ("hill_anisotropy", "displacement")),
        *(("force_scale", "channel of force"), ("force_offset", "channel of force")),
        *(("machine_compliance", "machine"), ("jaw_slip", "machine")),
    ],
)
def test_what_no_coupon_feels_is_named_by_what_it_acts_on(name: str, what: str) -> None:
    assert what in in_words(Decision((name,), (), (name,)))


def undecided(case: Case, *families: tuple[str, ...]) -> Traced:
    """A trace of which only the families count that it leaves undecided."""
    scores = tuple(SimpleNamespace(effect=f[0], family=f, detectability=1.0, z=9.0) for f in families)
    ranking = SimpleNamespace(scores=scores, threshold=3.0)
    return cast(Traced, SimpleNamespace(case=case, promising=lambda: scores, ranking=ranking, settings={}))


def test_a_coupon_with_a_temperature_has_the_sensor_of_its_records(tmp_path: Path) -> None:
    """Its drift is one of time, its gain one of the heat: a programme parts them. A body's camera is not on a coupon."""
    case = case_of(tmp_path, 1)
    (found,) = decisions(undecided(case, ("ir_drift", "ir_gain")))
    assert found.unfelt == () and found.best is not None and set(found.best.detectable) == {"ir_drift", "ir_gain"}
    assert "would decide" in in_words(found)
    body = replace(case, model=replace(case.model, missing=None))
    alone, two = decisions(undecided(body, ("ir_drift", "linear_hardening"), ("ir_drift", "backstress_first", "linear_hardening")))
    assert alone.unfelt == ("ir_drift",) and alone.best is not None and set(alone.best.detectable) == {"linear_hardening"}
    assert two.unfelt == ("ir_drift",) and two.best is not None and set(two.best.detectable) == {"backstress_first", "linear_hardening"}


def test_the_sensor_of_a_programme_drifts_by_its_rate() -> None:
    """The column of a drift is time over noise; the stress does not feel it, and Young's modulus takes next to nothing of it."""
    held = LAW.with_free(("E",))
    own = columns(named("hold"), USUAL, held, (effect("ir_drift"),), NOISE)
    assert own is not None
    time = made("hold", USUAL, held).time
    expected = np.concatenate([0.0 * time, time / NOISE[1]])
    assert np.linalg.norm(own["ir_drift"][:, 0] - expected) < 0.05 * np.linalg.norm(expected)


@pytest.mark.parametrize("name", ["rate_logarithmic", "backstress_first"])
def test_one_effect_is_shown_best_by_the_programme_with_the_smallest_amplitude(name: str) -> None:
    told = (Discrimination(named("monotonic"), 0.0, {name: 0.5}), Discrimination(named("cycles"), 0.0, {name: 0.1}))
    best = Decision((name,), told, ()).best
    assert best is not None and best.programme.name == "cycles"


PAIR = ("linear_hardening", "backstress_first")


def hardened(folder: Path) -> Case:
    """A monotonic record of a law with linear hardening, and a model that has none."""
    strain = np.linspace(0.0, 0.05, 201)
    time, truth = strain / 1e-3, TRUTH.replace(H_lin=800.0)
    run = simulate(truth, Programme.by_strain(time, strain, 293.0), PointSettings(model=1))
    rng = np.random.default_rng(1)
    noisy = (run.stress + 0.3 * rng.normal(size=201), run.theta_sensor + 0.01 * rng.normal(size=201))
    test = CouponTest("pull", time, strain, *noisy, 293.0, 293.0, RECORD, (TestPhase(0.0, 50.0, "loading"),))
    made, data, free = study(folder), CouponData((test,), "strain"), ("E", "M_y0", "M_yinf", "H_exp", "beta", "tau")
    settings = made.stage("thermal").model_copy(update={"free": free})
    model = coupon_model(made, data, settings, TRUTH.with_free(free))
    return Case(model, TRUTH.with_free(free), tuple(effect(n) for n in PAIR), record_spans(data), frozenset())


def test_the_family_of_an_effect_that_was_added_is_decided(tmp_path: Path) -> None:
    """In monotonic tension a backstress is hardening: one of the two is added, and a programme that turns back would say which."""
    case, fit = fitted(hardened(tmp_path))
    closed = close_loop(case, fit, refitting(case.model), 1, None)
    (name,) = closed.accepted
    (family,) = added_families(closed)
    assert set(family.members) == set(PAIR) and family.members[0] == family.added == name
    told = decided({"undecided": []}, closed.last, added_families(closed))
    row = next(r for r in told["programmes"] if r["added"] == name)
    shown = {t["programme"]: t["max_cos"] for t in row["told"]}
    assert shown["monotonic"] > ALIKE > shown[row["best"]], "told as in the round that added it: its own Params take nothing"
    assert told["undecided"][0].startswith(f"{name} (added) or {family.members[1]}: the programme {row['best']} (")
    assert len(told["programmes"]) == 1, "what is dormant and hardly felt is told with its family"


def test_an_effect_that_is_on_is_asked_at_its_value() -> None:
    """A factor on the yield stress acts on what hardening made of it, whether that is asked for beside it or not."""
    on, rate = LAW.replace(H_lin=3000.0), effect("rate_logarithmic")
    beside, alone = (columns(named("monotonic"), USUAL, on, wanted, NOISE) for wanted in ((effect("linear_hardening"), rate), (rate,)))
    assert beside is not None and alone is not None
    assert beside["rate_logarithmic"] == pytest.approx(alone["rate_logarithmic"], rel=1e-6)


def test_what_was_added_besides_is_in_no_family_and_is_a_parameter() -> None:
    """Two accepted effects of one family are both needed; another one that was accepted takes its part of the columns."""
    turns = []
    for name, family in (("linear_hardening", (*PAIR, "second_hardening")), ("backstress_first", (PAIR[1], PAIR[0]))):
        trial = SimpleNamespace(scores=(SimpleNamespace(effect=name, family=family),), effects=(name,))
        settings = {"second_hardening": {"second_hardening.b": 100.0}}
        turns.append(SimpleNamespace(trials=(trial,), accepted=(name,), traced=SimpleNamespace(settings=settings)))
    (family,) = added_families(cast(Closed, SimpleNamespace(rounds=tuple(turns), accepted=PAIR, stand_ins=None)))
    assert family.members == ("linear_hardening", "second_hardening") and family.settings == {"second_hardening.b": 100.0}
    on = LAW.replace(H_lin=100.0, **{"backstress_first.C": 500.0, "ir_drift.rate": 1e-3})
    on = on.with_free((*LAW.free, "kappa", "H_lin", "backstress_first.C", "ir_drift.rate"))
    case = SimpleNamespace(parameters=on, model=SimpleNamespace(missing=None))
    here = cast(Traced, SimpleNamespace(case=case))
    coupon = at_point(here, family, sensitive_at_point(here))
    assert coupon.free == (*LAW.free, "backstress_first.C"), "what it was added by is not taken out of its own column"
    assert coupon["ir_drift.rate"] == 0.0 and coupon["H_lin"] == 100.0 and coupon["second_hardening.b"] == 100.0
