"""A pose at the end of what its landmarks can reach is fitted beyond it and judged as any effect; within it, it is no cause."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refits import fitted, refitting
from seen_field import BASE, case_of
from virtual_pulls import SIZE, TRUTH, data, study

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import pose as module
from thermofit.diagnose.backward import Means
from thermofit.diagnose.case import Case, RefinedProblem
from thermofit.diagnose.drift import drifts
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.pose import contradicting_landmarks, not_asked_of_pose, released
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.rejudge import ends_of_fit
from thermofit.diagnose.trace import traced
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.model import Prior
from thermofit.experiment.row_states import VARIABLES
from thermofit.experiment.trust import physical
from thermofit.fit.result import FitResult
from thermofit.identify.solve import within

RATE = "ir_drift.rate"
"""Stands for the pose of a camera."""


def bounded(true: float, within: float, fails: str = "") -> tuple[Case, FitResult, Any]:
    """A case whose pose is fitted within bounds, its optimum, and a fit that keeps the pose at the bound where it ends there; labels that
    hold `fails` cannot be run."""
    case = case_of(5, **{RATE: true})
    plain = refitting(case.model)

    def refit(start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        if fails and fails in label:
            raise NumericsError("no run")
        end, fit = plain(start, label)
        if "beyond its landmarks" in label or RATE not in start.free or abs(end[RATE]) <= within:
            return end, fit
        held = end.replace(**{RATE: within})
        for _ in range(3):
            held = plain(held.with_free(("kappa", "c0")), label)[0]
        held = held.with_free(start.free)
        residual, columns = case.model.linearised(held, held.free)
        return held, replace(fit, x=held.vector(), residual=residual, jacobian=columns, f=float(residual @ residual))

    case = replace(
        case,
        parameters=BASE.with_free(("kappa", "c0", RATE)),
        bounds=lambda name: (-within, within) if name == RATE else physical(name),
        pose=frozenset((RATE,)),
    )
    end, fit = refit(case.parameters, "joint")
    return replace(case, parameters=end), fit, refit


def looped(true: float, within: float, most: int = 3, fails: str = "") -> Closed:
    case, fit, refit = bounded(true, within, fails)
    return close_loop(case, fit, refit, most, None)


def test_within_its_bounds_it_is_no_cause() -> None:
    found = looped(0.02, 0.05)
    assert found.accepted == () and found.last.case.parameters[RATE] == pytest.approx(0.02, rel=0.05)


def test_beyond_them_it_is_named_with_all_of_it() -> None:
    found = looped(0.02, 0.005)
    assert found.accepted == ("ir_drift",) and found.last.case.parameters[RATE] == pytest.approx(0.02, rel=0.05)
    assert contradicting_landmarks(found.first.case) == ("ir_drift",) and contradicting_landmarks(found.last.case) == ()
    before, after = (float(np.mean(t.columns.residual**2)) for t in (found.first, found.last))
    assert before > 2.0 and after == pytest.approx(1.0, abs=0.1), "the error before is that at the bound"


def test_it_takes_the_place_of_an_effect() -> None:
    found = looped(0.02, 0.005, most=0)
    assert found.accepted == ()


def test_what_is_not_better_beyond_is_refused() -> None:
    """At the bound by chance: the data do not ask for more."""
    case, fit, refit = bounded(0.0, 1e-9)
    here = traced(case, None, fit=fit)
    assert contradicting_landmarks(replace(case, parameters=case.parameters.replace(**{RATE: 1e-9}))) == ("ir_drift",)
    at_end = replace(here, case=replace(case, parameters=case.parameters.replace(**{RATE: 1e-9})))
    found = released(at_end, fit, Means(refit, None, "auto"))
    (trial,) = found.trials
    assert found.accepted is None and trial.refused


@pytest.mark.parametrize(("share", "taken"), [(1.0, True), (0.7, True), (0.6, False)])
def test_it_is_no_name_for_heat_of_which_it_explains_less_than_two_thirds(share: float, taken: bool) -> None:
    """Beside a broad source so little is left that the camera beyond its landmarks explains this share of it."""
    case, fit, refit = bounded(0.02, 0.005)
    here = traced(case, None, fit=fit)
    assert here.protected is None and released(here, fit, Means(refit, None, "auto")).accepted is not None
    now, left = (float(np.sum(case.model.residual(p) ** 2)) for p in (case.parameters, refit(case.parameters, "beyond its landmarks")[0]))
    beside: Any = SimpleNamespace(with_source=now - (now - left) / share)
    found = released(replace(here, protected=beside), fit, Means(refit, None, "auto"))
    assert (found.accepted is not None) is taken
    assert taken or "60 % of what a heat source over place, time and plastic strain explains: not the cause" in found.trials[0].refused


def test_a_run_that_fails_beyond_is_said() -> None:
    found = looped(0.02, 0.005, fails="beyond its landmarks")
    assert found.accepted == () and "no run" in found.unjudged["ir_drift"]


NAMES = ("ir_registration.shift_y", "ir_registration.shift_x", "ir_registration.rotation", "ir_registration.scale")


def test_all_fits_go_beyond_from_then_on_and_the_landmarks_say_nothing() -> None:
    """Coupled fit, temperatures alone, scores, and the problem that knows the error of the force; what else was declared stays."""
    declared = tuple(Prior(n, 0.0, 0.05, firm=False) for n in NAMES)
    jaws = Prior("clamp_difference.difference", 0.0, 0.5)
    joint = Joint(study(), data(), joint_settings(study(), ("c0", *NAMES), data()), SIZE, beside=(*declared, jaws))
    at = Parameters.of({**TRUTH, NAMES[0]: 1.0}, ("c0", *NAMES))
    narrow = within(study(), at, dict.fromkeys(NAMES[:2], (-2.0, 2.0)))
    job: Any = SimpleNamespace()
    fitting = JointFit(narrow, joint.settings, joint.model, job, parts=joint)
    bare = replace(fitting, parts=None)
    last = RefinedProblem(joint.model, joint.scored, fitting, bare, np.zeros(1), fitting.heated)
    sharp = replace(last, again=lambda _: last)
    case = Case(
        joint.model, at, (), (), frozenset(), scored=joint.scored, refined_at=lambda _: sharp, heated=fitting.heated, bounds=narrow.bounds
    )
    wide = module.wider(fitting, at, NAMES)
    found = module.widened(replace(case, pose=frozenset(NAMES)), NAMES, wide)
    assert not found.pose and all(found.bounds(n) == physical(n) for n in NAMES) and found.bounds("kappa") == narrow.bounds("kappa")
    told, heated = (None if of is None else of(at) for of in (found.refined_at, found.heated))
    assert told is not None and heated is not None and told.scored is not None and found.scored is not None and isinstance(wide, JointFit)
    rows = len(NAMES) + 1
    anew = None if told.again is None else told.again(at)
    assert anew is not None and anew.again is None
    for fit in (wide, told.refit, told.nearby, anew.refit, anew.nearby):
        assert isinstance(fit, JointFit) and all(fit.study.bounds(n) == physical(n) for n in NAMES)
        assert fit.model.residual(at)[-rows:].tolist() == [0.0] * rows
    for model in (found.model, told.model, anew.model, heated.model):
        assert {p.name: p.sigma for p in model.priors} == {**dict.fromkeys(NAMES, np.inf), jaws.name: 0.5}
    for scored in (found.scored, told.scored):
        assert scored(at, (NAMES[0],), ())[1][-rows:].tolist() == [[0.0]] * rows
    assert joint.model.residual(at)[-rows] == 20.0, "with the datum: twenty of its errors"


def test_the_second_camera_is_asked_where_the_first_one_stays() -> None:
    """Two at their ends; what is refused of one says nothing of the other."""
    moved = "ir_emissivity.slope"
    case, fit = fitted(case_of(5, **{moved: 1.0}))
    ends = {RATE: 1e-9, moved: 1e-3}
    there = case.parameters.replace(**ends).with_free((*case.parameters.free, *ends))
    here = traced(replace(case, parameters=there, pose=frozenset(ends), bounds=lambda n: (-ends[n], ends[n]) if n in ends else physical(n)))
    assert contradicting_landmarks(here.case) == ("ir_drift", "ir_emissivity")
    found = released(here, fit, Means(refitting(case.model), None, "auto"))
    assert [t.effects for t in found.trials] == [("ir_drift",), ("ir_emissivity",)]
    assert found.trials[0].refused and found.accepted is not None and not found.trials[1].refused


def test_it_is_no_part_of_the_answer() -> None:
    """At its bound it speaks against no effect, and no drift of it is told."""
    case, fit, _ = bounded(0.02, 0.005)
    here = traced(case, None, fit=fit)
    stuck = replace(fit, sigma=None)
    assert RATE not in ends_of_fit(here, stuck) and RATE in ends_of_fit(replace(here, case=replace(case, pose=frozenset())), stuck)
    rows = here.rows
    states = {v: np.full(len(rows.time), np.nan) for v in VARIABLES} | {"time": rows.time}
    asked = drifts(here, states).asked
    assert drifts(replace(here, case=replace(case, pose=frozenset())), states).asked == asked + 1


@pytest.mark.parametrize(
    ("value", "gain", "refused", "unjudged", "told"),
    [
        (0.02, 2e-4, "not enough", False, True),
        (0.02, 0.2, "readings are off", False, False),  # held-out data ask for it, and something else refuses it
        (0.02, 2e-4, "not enough", True, False),  # no run could judge it
        (0.02, 2e-4, "", False, False),
        (0.01, 2e-4, "not enough", False, False),  # within its bound
    ],
)
def test_a_pose_at_its_end_is_no_doubt_where_held_out_data_ask_for_no_more(
    value: float, gain: float, refused: str, unjudged: bool, told: bool
) -> None:
    case = case_of(5)
    case = replace(
        case,
        parameters=BASE.with_free(("kappa", RATE)).replace(**{RATE: value}),
        bounds=lambda name: (-0.02, 0.02) if name == RATE else physical(name),
        pose=frozenset((RATE,)),
    )
    proof = Proof(1.0, 1.0, {}, gain, 2e-4, 5)
    trial: Any = SimpleNamespace(effects=("ir_drift",), proof=proof, refused=refused, unjudged=unjudged)
    said = not_asked_of_pose(case, (trial,))
    assert set(said) == ({RATE} if told else set())
    assert not told or "beyond it, held-out error falls by 0.02 % +- 0.02 %" in said[RATE]
    assert not_asked_of_pose(case, ()) == {}
