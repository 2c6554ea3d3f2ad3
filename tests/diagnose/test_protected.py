"""Thermal parameters beside a broad heat source: a spot that no effect has drives a plain fit off, not them; drifting jaws are named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import virtual_pulls
from refits import refitting
from virtual_pulls import SIZE, TRUTH, study

from thermofit.core import parameters as declared
from thermofit.core.parameters import Parameters
from thermofit.diagnose import rescored as module
from thermofit.diagnose.case import Case, HeatFit, rows_of
from thermofit.diagnose.held_out import Rows, Split, split_by_blocks
from thermofit.diagnose.protected import Protected, begins, pairs, protected
from thermofit.diagnose.refit import HEAT_EVALUATIONS, NEGLIGIBLE, WORTH
from thermofit.diagnose.rescored import rescored
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.trial import freed_from_the_start
from thermofit.diagnose.unlisted import structured, unlisted
from thermofit.effects import catalogue
from thermofit.effects.catalogue import effect, effects, load_effect
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.model import Prior
from thermofit.experiment.residuals import Span
from thermofit.fit.settings import Settings
from thermofit.identify.solve import F_TOLERANCE

THERMAL = ("kappa", "c0", "beta", "alpha_air", "alpha_clamp", "theta_air", "theta_clamp")
TIME = np.array([*np.arange(0.0, 30.0, 1.0), *np.arange(30.0, 121.0, 3.0)])
FORCE = np.interp(TIME, [0.0, 2.0, 4.0, 12.0, 30.0, 33.0, 36.0], [0.0, 0.0, 3000.0, 4600.0, 5200.0, 2000.0, 0.0])
WARM = ("lamp", "clamp_drift", "air_drift", "latent_heat", "ir_drift", "stored_energy")
"""Known effects that temperatures show; one more acts on the motion."""
Made = Callable[..., tuple[Case, HeatFit, Rows, Split]]
SPOT = '''"""A spot in the gauge that is heated from 20 s on. Off at power = 0."""

import numpy as np

from thermofit.core.parameters import Param

SLOT = "heat_source"
PARAMS = (
    Param("spot_of_this_test.power", "mW/mm^3", 0.0, -10.0, 10.0, 0.1, "power per volume in its middle", probe=0.1),
    Param("spot_of_this_test.pulse", "mW/mm^3", 0.0, -10.0, 10.0, 0.1, "the same from 50 to 80 s", probe=0.1),
)
FORMULA = "r += [power (t > 20 s) + pulse (50 s < t < 80 s)] exp(-(y - 6)^2 / 32)"
SOURCE = "planted by a test"


def heat_source(theta, accumulated, rate, time, x, y, power, pulse):
    now = 0.5 * power * (1.0 + np.tanh((time - 20.0) / 0.5))
    now = now + 0.5 * pulse * (np.tanh((time - 50.0) / 0.5) - np.tanh((time - 80.0) / 0.5))
    return np.exp(-((y - 6.0) ** 2) / 32.0) * now + 0.0 * theta
'''


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Made]:
    """From planted values to the case, its heat fit, rows and folds. Temperatures are fitted as the loop does, or `plainly`: by steps of
    Gauss and Newton to the end, which stay in the valley in which they begin."""
    patch = pytest.MonkeyPatch()
    patch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    patch.setattr(declared, "OF_EFFECTS", dict(declared.OF_EFFECTS))
    known = tuple(e for e in effects() if e.name in (*WARM, "second_hardening"))
    path = tmp_path_factory.mktemp("effects") / "spot_of_this_test.py"
    path.write_text(SPOT, encoding="utf-8")
    load_effect(path)
    patch.setattr(virtual_pulls, "TIME", TIME)

    def made(*, plainly: bool = False, **planted: float) -> tuple[Case, HeatFit, Rows, Split]:
        data, case = virtual_pulls.pulled(planted, FORCE), study()
        joint = Joint(case, data, joint_settings(case, THERMAL, data), SIZE)
        truth = Parameters.of({**TRUTH, **{n: p.neutral for e in known for p in e.params for n in (p.name,)}}).with_free(THERMAL)
        warm = joint.heat(truth)
        assert warm is not None
        spans = (Span("all", 0.0, 121.0),)
        first = {"kappa": 90.0, "c0": 2.6, "beta": 0.9, "alpha_air": 10.0, "alpha_clamp": 300.0}
        least = max(F_TOLERANCE, NEGLIGIBLE * sum(c.n for c in warm.comparisons))
        as_the_loop = Settings(f_tolerance=least, max_evaluations=HEAT_EVALUATIONS, worth=WORTH)
        refit = refitting(warm) if plainly else refitting(warm, "trust-region", as_the_loop)
        fit = HeatFit(warm, lambda start, label: refit(start, label)[0], None, first)
        rows = rows_of(warm, spans)
        there = Case(joint.model, truth, known, spans, frozenset(("ir_drift.rate",)), heated=lambda _: fit, largest_strain=0.03)
        return there, fit, rows, split_by_blocks(rows, (10, 2), (1.0, 1.0))

    yield made
    patch.undo()


def found_of(made: tuple[Case, HeatFit, Rows, Split]) -> Protected:
    found = protected(*made)
    assert found is not None
    return found


def test_a_spot_of_no_effect_drives_a_plain_fit_off_and_not_the_protected_parameters(problem: Made) -> None:
    made = problem(**{"spot_of_this_test.power": 0.05})
    case, fit, *_ = made
    plain = fit.minimised(case.parameters.replace(**fit.first), "plain")
    found = found_of(made)
    off = {n: (abs(plain[n] / TRUTH[n] - 1.0), abs(found.parameters[n] / TRUTH[n] - 1.0)) for n in ("kappa", "c0", "beta")}
    print(off, found.with_source / len(found.linear.residual))
    assert off["kappa"][0] > 0.3 > 0.15 > off["kappa"][1]
    assert off["beta"][1] < 0.1 and off["c0"][1] < 0.1
    assert found.with_source < 1.1 * len(found.linear.residual)


def trace_of(made: tuple[Case, HeatFit, Rows, Split]) -> tuple[Traced, Traced]:
    """The trace at the optimum of a plain fit, by one linear step and by refits."""
    case, fit, *_ = made
    here = traced(replace(case, parameters=fit.minimised(case.parameters.replace(**fit.first), "plain")))
    return here, rescored(here)


def test_what_explains_less_than_half_of_the_broad_source_is_no_name(problem: Made) -> None:
    """Nothing listed is a spot that is cooled for a while."""
    _, refitted = trace_of(problem(**{"spot_of_this_test.pulse": -0.1}))
    assert not refitted.promising()
    why = {s.effect: s.vetoed for s in refitted.ranking.scores}
    assert "displacements" in why["second_hardening"]
    assert any("of what a heat source over place, time and plastic strain explains: not the cause" in w for w in why.values()), why


def test_what_explains_two_thirds_at_most_is_no_name_beside_what_explains_more(problem: Made) -> None:
    """Jaws that drift: a lamp explains much of it, and the jaws all."""
    _, refitted = trace_of(problem(plainly=True, **{"clamp_drift.rate": 0.03}))
    why = {s.effect: s.vetoed for s in refitted.ranking.scores}
    part = int(why["lamp"].split()[1])
    assert why["lamp"].endswith("not the cause") and 33 < part < 67 and why["clamp_drift"] == ""


def test_a_cause_between_the_scanned_values_is_named(problem: Made) -> None:
    """Held at the nearest scanned window the heat explains less than a name has to; with the window free it explains all."""
    _, refitted = trace_of(problem(**{"latent_heat.heat": 200.0, "latent_heat.centre": 0.012, "latent_heat.width": 0.002}))
    first = refitted.promising()[0]
    assert first.effect == "latent_heat" and first.vetoed == ""
    assert refitted.settings["latent_heat"]["latent_heat.centre"] == pytest.approx(0.012, abs=1e-3)


def test_what_explains_enough_at_a_scanned_value_is_fitted_with_its_exponents_free(problem: Made) -> None:
    """A cause near a scanned value is no reason to hold it there: the others would make up for the rest. The coupled refit begins with all
    of them free."""
    planted = {"latent_heat.heat": 200.0, "latent_heat.centre": 0.0137, "latent_heat.width": 0.008}
    _, refitted = trace_of(problem(**planted))
    end = refitted.shown["latent_heat"]
    assert set(planted) <= set(end.parameters.free)
    assert end.parameters["latent_heat.centre"] == pytest.approx(0.0137, abs=2e-4)
    (score,) = (s for s in refitted.ranking.scores if s.effect == "latent_heat")
    exponents = tuple(p.name for p in effect("latent_heat").exponents)
    assert freed_from_the_start(refitted, (score,)) == exponents
    assert freed_from_the_start(replace(refitted, shown={}), (score,)) == ()


def test_a_refit_with_exponents_free_is_given_up_where_it_would_be_no_name(problem: Made) -> None:
    """It has to come below what a name may leave; refits with exponents held are asked for families too, and end by their own rule."""
    case, fit, *_ = problem(**{"latent_heat.heat": 200.0, "latent_heat.centre": 0.0137, "latent_heat.width": 0.008})
    asked: list[tuple[bool, float, float]] = []

    def from_here(start: Parameters, label: str, to_beat: float) -> Parameters:
        end = fit.minimised(start, label)
        asked.append(("latent_heat.centre" in start.free, to_beat, float(np.sum(fit.model.residual(end) ** 2))))
        return end

    telling = replace(fit, from_here=from_here)
    there = replace(case, heated=lambda _: telling, known=tuple(e for e in case.known if e.name == "latent_heat"))
    here = traced(replace(there, parameters=fit.minimised(case.parameters.replace(**fit.first), "plain")))
    rescored(here)
    assert {beaten for freed, beaten, _ in asked if not freed} == {np.inf}
    ((_, limit, end),) = (one for one in asked if one[0])
    held = min(left for freed, _, left in asked if not freed)
    assert limit <= module.RIVAL * held, "nor is what leaves half more than the best"
    assert end < limit < float(here.columns.residual @ here.columns.residual)


def test_on_the_known_motion_the_camera_stands_where_its_landmarks_have_it(problem: Made) -> None:
    """While much heat is missing the pose would stand in for it; here the drift of the camera is taken for that."""
    case, fit, *_ = problem(**{"clamp_drift.rate": 0.05})
    pose, plain = "ir_drift.rate", fit.minimised(case.parameters.replace(**fit.first), "plain")
    known = tuple(e for e in case.known if e.name in ("clamp_drift", "lamp"))
    there = plain.replace(**{pose: 0.01}).with_free((*plain.free, pose))
    refitted = rescored(traced(replace(case, parameters=there, known=known, pose=frozenset((pose,)))))
    assert refitted.case.parameters[pose] == 0.01 and pose in refitted.case.parameters.free
    assert refitted.protected.parameters[pose] == 0.0 and pose not in refitted.protected.parameters.free
    ends = [end.parameters for end in refitted.shown.values()]
    assert ends and all(p[pose] == 0.0 and pose not in p.free for p in ends)


def test_effects_are_judged_on_the_motion_that_displacements_tell(monkeypatch: pytest.MonkeyPatch, problem: Made) -> None:
    """A joint fit has bent the motion to what is missing; the case that is refitted is that of the displacements alone, and the trace stays
    where it was."""
    case, fit, *_ = problem(**{"latent_heat.heat": 200.0, "latent_heat.centre": 0.0137, "latent_heat.width": 0.008})
    heated: list[float] = []

    def heat(parameters: Parameters) -> HeatFit:
        heated.append(parameters["M_y0"])
        return fit

    plain = fit.minimised(case.parameters.replace(**fit.first), "plain")
    found = rescored(traced(replace(case, parameters=plain, heated=heat, moved=lambda p: p.replace(M_y0=101.0))))
    assert heated == [101.0] and found.case.parameters["M_y0"] == plain["M_y0"] != 101.0
    assert {end.parameters["M_y0"] for end in found.shown.values()} == {101.0}


def test_what_explains_the_broad_source_is_named(problem: Made) -> None:
    step, refitted = trace_of(problem(**{"clamp_drift.rate": 0.05}))
    first = refitted.promising()[0]
    assert first.effect == "clamp_drift" and first.estimate["clamp_drift.rate"] == pytest.approx(0.05, rel=0.1)
    assert first.z > 300.0, "the root of what the square sum falls by"
    assert "clamp_drift" in refitted.warmed and refitted.proofs["clamp_drift"].convinces
    assert step.excess(float(step.columns.residual @ step.columns.residual)) > 0.0


def test_a_step_that_is_proposed_below_the_floor_of_a_coarse_mesh_is_refitted_too(problem: Made) -> None:
    """The parameters have been driven off there as anywhere. Where no step is proposed nothing is asked."""
    case, fit, *_ = problem(**{"lamp.absorbed": 0.02})
    here = traced(replace(case, parameters=fit.minimised(case.parameters.replace(**fit.first), "plain")))
    below = replace(here, problem=replace(here.problem, numerical=here.problem.model.left))
    assert below.excess(float(below.columns.residual @ below.columns.residual)) == 0.0 and below.promising()
    assert "lamp" in rescored(below).warmed
    none = replace(below, ranking=replace(below.ranking, scores=()))
    assert rescored(none) is none


def test_jaws_that_drift_explain_most_from_there(problem: Made) -> None:
    """As a plain fit of its own leaves a contact that conducts nothing, no drift is felt at that optimum."""
    case, fit, rows, split = made = problem(**{"clamp_drift.rate": 0.05})
    first, *others = begins(case, fit, found_of(made), WARM)
    assert first.effects == ("clamp_drift",) and first.f < 0.8 * min(b.f for b in others)
    assert first.parameters["clamp_drift.rate"] == pytest.approx(0.05, rel=0.3)
    assert set(acting_on_temperatures(case.parameters.free)) == set(THERMAL) and len(rows.time) == len(split.held_out[0])


def test_two_that_act_at_once_begin_together(problem: Made) -> None:
    """Each alone leaves what the other makes."""
    case, fit, *_ = made = problem(**{"clamp_drift.rate": 0.05, "lamp.absorbed": 0.03, "lamp.start": 37.0})
    found = found_of(made)
    singles = begins(case, fit, found, WARM)
    best, *others = pairs(case, found, singles)
    assert "clamp_drift" in best.effects and best.effects != ("clamp_drift",)
    n = len(found.linear.residual)
    assert best.f - n < 0.7 * (singles[0].f - n) and best.f <= min(b.f for b in others)
    own = {n: v for b in singles if b.effects[0] in best.effects for n, v in b.values.items()}
    assert own and all(best.parameters[n] == v for n, v in own.items()), "at the times and exponents of each"


def test_an_unlisted_heat_is_sought_where_it_has_not_driven_the_parameters_off(problem: Made) -> None:
    """The parameters beside a spot of 0.05 mW/mm3 that no effect has, and when it begins."""
    case, fit, *_ = problem(**{"spot_of_this_test.power": 0.05})
    here = traced(replace(case, parameters=fit.minimised(case.parameters.replace(**fit.first), "plain")))
    found = unlisted(here, structured(here, None), ())
    assert found is not None and found.field is not None and found.place is not None and not found.remark
    off = {n: abs(found.parameters[n] / TRUTH[n] - 1.0) for n in ("kappa", "c0", "beta")}
    assert max(off.values()) < 0.15, off
    assert abs(found.place.when[0] - 20.0) < 4.0 and found.place.when[1] == 120.0


def test_a_refit_that_has_driven_a_reading_is_made_again_with_it_held(monkeypatch: pytest.MonkeyPatch, problem: Made) -> None:
    """Jaws read to 0.1 K that a lamp needs 2 K warmer; not those of an effect that says the jaws differ, and none that stayed."""
    case, *_ = problem()
    asked: list[Parameters] = []
    monkeypatch.setattr(module, "refitted", lambda here, scores, fit, settings, begin, freed: asked.append(begin))
    fit: Any = SimpleNamespace(model=SimpleNamespace(priors=(Prior("theta_clamp", TRUTH["theta_clamp"], 0.1),)))
    beside: Any = SimpleNamespace(parameters=case.parameters)

    def held(name: str, off: float) -> int:
        there = case.parameters.replace(theta_clamp=TRUTH["theta_clamp"] + off)
        end, scores = cast(Any, SimpleNamespace(parameters=there)), cast(Any, (SimpleNamespace(effect=name),))
        before = len(asked)
        module.with_readings(cast(Any, None), scores, fit, end, beside, False)
        return len(asked) - before

    assert held("lamp", 2.0) == 1 and held("lamp", 0.3) == 0
    assert asked[0]["theta_clamp"] == TRUTH["theta_clamp"] and "theta_clamp" not in asked[0].free and "kappa" in asked[0].free


def test_what_has_to_be_explained_counts_from_the_best_fit_without_an_effect(problem: Made) -> None:
    """An optimum in another valley is no credit to whatever leaves it; one that is lower stays."""
    case, fit, rows, _ = problem()
    mine = np.ones(len(rows.time), dtype=bool)
    right = float(np.sum(fit.model.residual(case.parameters) ** 2))
    beside: Any = SimpleNamespace(parameters=case.parameters)
    same = replace(fit, from_here=lambda start, label, _: start)
    for optimum in (3.0 * right, 0.5 * right):
        residual = np.full(len(mine), np.sqrt(optimum / len(mine)))
        here: Any = SimpleNamespace(case=case, columns=SimpleNamespace(residual=residual))
        assert module.nothing_added(here, same, beside, mine) == pytest.approx(min(right, optimum))
