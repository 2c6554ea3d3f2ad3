"""An effect that takes little of the error and moves a parameter of the material far; steps of films that conduct as if there were none."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from refits import fitted
from strip import strip_case

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.held_out import FAR, MOVES, PRACTICAL, Proof, far
from thermofit.diagnose.protected import either_sign, no_farther
from thermofit.diagnose.score import Columns, ranked
from thermofit.diagnose.trace import material_of, traced
from thermofit.diagnose.trial import moves_material
from thermofit.fit.linear_model import LinearModel

LITTLE = Proof(1.0, 1.0, {}, 0.002, 0.0005, 5)
N = 40_000
ANYWHERE = (np.array([-np.inf]), np.array([np.inf]))


@pytest.mark.parametrize(
    ("gain", "moves", "convinces"), [(0.0021, True, True), (0.0021, False, False), (0.0019, True, False), (0.0031, True, True)]
)
def test_held_out_error_has_to_fall_in_any_case(gain: float, moves: bool, convinces: bool) -> None:
    """By two standard errors of 0.0005 and three thousandths, or by four where something moves."""
    assert LITTLE.gain < PRACTICAL and replace(LITTLE, gain=gain, moves=moves).convinces is convinces


@pytest.mark.parametrize(("by", "sigma", "moved"), [(5.0, 0.9, True), (-5.0, 0.9, True), (5.0, 1.1, False), (1.9, 0.1, False)])
def test_what_is_far(by: float, sigma: float, moved: bool) -> None:
    """Of a value of 100: a fiftieth, and five standard errors; one of several is enough."""
    assert (FAR, MOVES) == (5.0, 0.02)
    assert far(np.array([0.0, by]), np.array([1.0, 100.0]), np.array([1.0, sigma])) is moved


def problem(amount: float, alike: float) -> Columns:
    """Modulus and degradation over N rows: columns of length 1e-2 and 100, the second `alike` the first; the effect is on with `amount`."""
    rng = np.random.default_rng(3)
    first, second, noise = (rng.normal(size=N) / np.sqrt(N) for _ in range(3))
    effect = 100.0 * (alike * first + np.sqrt(1.0 - alike**2) * second)
    model = LinearModel(noise * np.sqrt(N) - amount * effect, 1e-2 * first[:, None])
    return Columns(model, {"lamp": (("lamp.absorbed",), effect[:, None])}, material={0: 70_000.0})


def test_it_moves_what_its_column_is_like() -> None:
    """At a likeness of 0.9, 0.2 of it move the modulus by 1800, of which two per cent are 1400 and its standard error beside it is 230."""
    whole = problem(0.2, 0.9)
    assert whole.moves(whole.dormant["lamp"][1], ANYWHERE)
    assert not replace(whole, material={}).moves(whole.dormant["lamp"][1], ANYWHERE), "nothing is asked beside other effects"
    none = problem(0.2, 0.0)
    assert not none.moves(none.dormant["lamp"][1], ANYWHERE)
    weak = replace(problem(0.06, 0.9), material={0: 7_000.0})
    assert not weak.moves(weak.dormant["lamp"][1], ANYWHERE), "by eight per cent, but two of its standard errors"
    small = problem(0.14, 0.9)
    assert not small.moves(small.dormant["lamp"][1], ANYWHERE), "by five of its standard errors, but 1.8 per cent"


def test_what_this_test_could_have_shown_knows_it() -> None:
    """The three thousandths of 40 000 values are the square of 11 standard errors; what moves the modulus is named from fewer on."""
    plain, moving = (
        next(s for s in ranked(columns).scores if s.effect == "lamp")
        for columns in (replace(problem(0.0, 0.9), material={}), problem(0.0, 0.9))
    )
    assert plain.detectable == pytest.approx(np.sqrt(PRACTICAL * N + 2.0) * plain.sigma["lamp.absorbed"], rel=0.02)
    assert 8.2 < moving.detectable / moving.sigma["lamp.absorbed"] < 8.6, "by four standard errors of the held-out error"
    assert problem(moving.detectable * 1.3, 0.9).moves(problem(0.0, 0.9).dormant["lamp"][1], ANYWHERE)


def test_what_is_of_the_material() -> None:
    """No reading, no effect and no pose; nothing where an effect is free beside, or on coupons."""
    names = ("E", "kappa", "theta_air", "ir_registration.shift_x")
    parameters = Parameters.of({"E": 7e4, "kappa": 130.0, "theta_air": 296.0}).with_free(names)
    priors = (SimpleNamespace(name="theta_air"),)
    case = Case(cast(Any, SimpleNamespace(priors=priors)), parameters, (), (), frozenset(), pose=frozenset({"ir_registration.shift_x"}))
    assert material_of(case) == {0: 7e4, 1: 130.0}
    beside = replace(case, parameters=parameters.with_free((*names, "lamp.absorbed")))
    assert material_of(beside) == {} and material_of(replace(case, cheap=True)) == {}
    assert material_of(beside, True) == {0: 7e4, 1: 130.0}, "those that leave no more than the floor have the form of their cause"


def test_steps_beside_a_term() -> None:
    """No farther than half of a value; a film by its resistance, which is 1e-6 of what it should be: at once, and up to twice as much."""
    values, films = np.array([100.0, 0.0, 1e6, 300.0]), np.array([False, False, True, True])
    found = values + no_farther(np.array([-80.0, 7.0, 1e6 * (1.0 - 1e6 / 250.0), 290.0]), values, reciprocal=films)
    assert found == pytest.approx([50.0, 7.0, 250.0, 600.0])
    assert no_farther(np.array([-80.0]), np.array([100.0])) == pytest.approx([-50.0])
    nothing = no_farther(
        np.array([9.0, 9.0, 9.0, 9.0]), np.array([2e-15, 0.02, 2e-15, 0.2]), False, films, np.array([10.0, 10.0, 100.0, 100.0])
    )
    assert nothing == pytest.approx([9.0, 0.01, 9.0, 0.2]), "a film at its bound, but for rounding, says nothing of how far it may go"


def test_a_pose_may_step_anywhere() -> None:
    """A shift of 1 um is not half of what it is: it would grow by half at every step, and beside it nothing settles."""
    names = ("E", "ir_registration.shift_y")
    step = no_farther(np.array([-8e4, 0.02]), np.array([7e4, 1e-3]), either_sign(names))
    assert step == pytest.approx([-3.5e4, 0.02])


@pytest.mark.parametrize(("kappa", "sigma", "is_moved"), [(133.0, 1.0, True), (133.0, 3.0, False), (132.0, None, False)])
def test_what_a_refit_has_moved(kappa: float, sigma: float | None, is_moved: bool) -> None:
    """Conductivity was 130 before; where the refit has no standard errors, or does not fit it, nothing is known."""
    case = Case(cast(Any, SimpleNamespace(priors=())), Parameters.of({"kappa": 130.0}).with_free(("kappa",)), (), (), frozenset())
    here: Any = SimpleNamespace(case=case, answered=False)
    there: Any = SimpleNamespace(case=replace(case, parameters=case.parameters.replace(kappa=kappa)))
    fit: Any = SimpleNamespace(names=("kappa", "lamp.absorbed"), sigma=None if sigma is None else np.array([0.5 * sigma, 1.0]))
    assert moves_material(here, there, fit) is is_moved
    other: Any = SimpleNamespace(names=("lamp.absorbed",), sigma=np.array([1.0]))
    assert not moves_material(here, there, other)
    beside = replace(case, parameters=Parameters.of({"kappa": 130.0, "lamp.absorbed": 0.01}).with_free(("kappa", "lamp.absorbed")))
    for answered in (True, False):
        here = SimpleNamespace(case=beside, answered=answered)
        assert moves_material(here, there, fit) is (answered and is_moved), "beside an effect that leaves more nothing is asked"


@pytest.mark.parametrize("moves", [True, False])
def test_a_trace_asks_of_every_effect_that_it_proves(monkeypatch: pytest.MonkeyPatch, moves: bool) -> None:
    monkeypatch.setattr(Columns, "moves", lambda *_: moves)
    case = fitted(strip_case(3, **{"ir_drift.rate": 5e-4}))[0]
    here = traced(case)
    assert here.problem.material == material_of(case) and here.problem.material
    assert here.proofs and all(proof.moves is moves for proof in here.proofs.values())
    on = case.parameters.replace(**{"ir_drift.rate": 5e-4})
    there = traced(fitted(replace(case, parameters=on.with_free((*on.free, "ir_drift.rate"))))[0])
    assert there.answered and set(there.problem.material) == set(here.problem.material)
    much = replace(case, parameters=on.replace(**{"ir_drift.rate": 0.1}).with_free((*on.free, "ir_drift.rate")))
    far_off = traced(much)
    assert not far_off.answered and far_off.problem.material == {}, "beside an effect that leaves more nothing is asked"
