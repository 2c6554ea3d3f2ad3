"""An effect that takes little of the error and moves a parameter of the material far; steps of films that conduct as if there were none."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refits import fitted
from strip import strip_case

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.held_out import FAR, MOVES, PRACTICAL, Proof, far
from thermofit.diagnose.protected import either_sign, held_up, no_farther, step_taken
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

    def moved(step: float, **value: float) -> float:
        return float(step_taken(Parameters.of(value, tuple(value)), (np.array([step]), np.eye(1)), ANYWHERE)[0])

    assert moved(-80.0, kappa=100.0) == -50.0 and moved(7.0, kappa=0.0) == 7.0
    assert moved(1e6 * (1.0 - 1e6 / 250.0), alpha_clamp=1e6) == pytest.approx(250.0 - 1e6)
    assert moved(290.0, alpha_clamp=300.0) == pytest.approx(300.0)
    assert moved(9.0, alpha_clamp=2e-15) == pytest.approx(9.0), "a film at its bound, but for rounding, says nothing of how far it may go"
    nothing = no_farther(np.array([9.0, 9.0]), np.array([2e-15, 0.02]), False, np.array([10.0, 10.0]))
    assert nothing == pytest.approx([9.0, 0.01])


def test_part_of_a_step_stays_in_the_valley_of_a_law_of_the_rate() -> None:
    """Of K ((1 + z)^m - 1) data tell the product of K and m: a half of a step that keeps it, and what is left of one that is too far, keep
    it as well. A film by its resistance."""
    names = ("rate_power.K", "rate_power.m", "alpha_clamp")
    parameters = Parameters.of({"rate_power.K": 12.0, "rate_power.m": 0.3, "alpha_clamp": 300.0}, names)
    for by in (0.4, 5.0):
        step = np.array([12.0 * by, -0.3 * by, 300.0 * 0.25])
        for part in (1.0, 0.5, 0.125):
            there = parameters.vector() + step_taken(parameters, (step, np.eye(3)), ANYWHERE, part=part)
            assert there[0] * there[1] == pytest.approx(12.0 * 0.3) and there[0] == pytest.approx(12.0 * np.exp(part * min(by, 0.5)))
            assert 1.0 / there[2] == pytest.approx((1.0 - 0.25 * part) / 300.0)


def test_a_step_stays_within_bounds_and_is_shorter_where_it_is_damped() -> None:
    """Where one is at its bound, the other goes where it fits best beside it. Damping mu of an uncorrelated one divides it by 1 + mu."""
    parameters = Parameters.of({"kappa": 130.0, "c0": 3.0}, ("kappa", "c0"))
    linear = np.array([20.0, 0.6]), np.array([[4.0, 0.1], [0.1, 0.01]])
    held = step_taken(parameters, linear, (np.array([0.0, 0.0]), np.array([140.0, 9.0])))
    assert held == pytest.approx([10.0, 0.6 - 0.1 / 4.0 * 10.0])
    alone = np.array([20.0, 0.6]), np.diag([4.0, 0.01])
    for damping in (0.0, 0.1, 10.0):
        assert step_taken(parameters, alone, ANYWHERE, damping) == pytest.approx(alone[0] / (1.0 + damping))
    lowest = step_taken(parameters, (-linear[0], linear[1]), (np.array([125.0, 0.0]), np.array([140.0, 9.0])))
    assert lowest[0] == pytest.approx(-5.0)


@given(st.integers(1, 6), st.integers(0, 10_000))
def test_where_a_parameter_is_held_up_the_others_fit_best_beside_it(p: int, seed: int) -> None:
    """Of the parabola about the linear step: none leaves the room, and no other parameter has a slope left."""
    rng = np.random.default_rng(seed)
    root, step, most = rng.normal(size=(p + 2, p)), 3.0 * rng.normal(size=p), rng.uniform(0.1, 4.0, size=p)
    found = held_up(step, np.linalg.inv(root.T @ root), (-most, most))
    assert np.all(np.abs(found) <= most * (1.0 + 1e-9))
    inside = np.abs(found) < most * (1.0 - 1e-9)
    slope = root.T @ root @ (found - step)
    assert np.abs(slope[inside]).max(initial=0.0) < 1e-6 * (1.0 + np.abs(slope).max())
    assert np.array_equal(found, step) or not inside.all()


def test_a_pose_may_step_anywhere() -> None:
    """A shift of 1 um is not half of what it is: it would grow by half at every step, and beside it nothing settles."""
    names = ("E", "ir_registration.shift_y")
    step = no_farther(np.array([-8e4, 0.02]), np.array([7e4, 1e-3]), either_sign(names))
    assert step == pytest.approx([-3.5e4, 0.02])
    parameters = Parameters.of({"E": 7e4, "ir_registration.shift_y": 1e-2}, names)
    beside = step_taken(parameters, (np.array([-8e4, 0.02]), np.eye(2)), ANYWHERE)
    assert beside == pytest.approx([-3.5e4, 0.02])


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
    column = far_off.columns.fitted[:, 0]
    taken = traced(much, 9.0 * column * np.linalg.norm(far_off.columns.residual) / np.linalg.norm(column))
    assert not taken.answered and taken.problem.material == {}, "an error of the mesh that a parameter has taken up leaves nothing"
