"""The one rule of verdict and exit code: each thing that speaks against an answer, alone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.parameters import Parameters, param
from thermofit.experiment.joint_errors import too_far
from thermofit.experiment.model import Prior
from thermofit.experiment.trust import ChannelLevel, above_floor, at_bound, doubts, grade, level, undetermined

MANY = 10**6


def test_an_answer_that_nothing_speaks_against_is_trusted() -> None:
    assert doubts([ChannelLevel("theta", 1.0, MANY), ChannelLevel("theta", 1.0, MANY, "loading")], ((), Parameters.of({})), {}) == []


@pytest.mark.parametrize(
    ("over", "n", "phase", "above"),
    [
        (1.24, MANY, "", False),
        (1.26, MANY, "", True),
        (1.26, 8, "", True),
        (1.49, MANY, "loading", False),
        (1.51, MANY, "loading", True),
        (1.99, 8, "loading", False),
        (2.01, 8, "loading", True),
    ],
)
def test_floor_of_a_channel_and_of_a_phase(over: float, n: int, phase: str, above: bool) -> None:
    """Eight values of white noise scatter by 1 / 4 in their rms: four times that comes on top of one."""
    found = doubts([ChannelLevel("theta", over, n, phase)])
    assert bool(found) is above
    assert not above or found == [f"theta is {over:.2g} times its noise{' in loading' if phase else ''}: more than noise is left"]


@pytest.mark.parametrize(("off", "single"), [(14.0, True), (5.0, False)])
def test_one_value_that_makes_it_is_told(off: float, single: bool) -> None:
    """136 values of 1.46 times their noise: without one at 14 times they are within it, without one at 5 times they are not."""
    (found,) = doubts([ChannelLevel("force", 1.46, 136, largest=(45.64, off))])
    assert ("one value makes that, at 45.64 s" in found) is single and "more than noise is left" in found


def test_the_error_of_mesh_and_steps_belongs_to_the_floor() -> None:
    assert level("theta", 4.0, 0.0, MANY).over == 2.0 and level("theta", 4.0, 3.0, MANY).over == 1.0
    assert level("theta", 4.0, 3.0, 7, "loading") == ChannelLevel("theta", 1.0, 7, "loading")
    assert level("theta", 4.0, 3.0, 7, largest=(5.0, 8.0)).largest == (5.0, 4.0)


def test_a_channel_is_named_once_as_a_whole_or_by_its_worst_phase() -> None:
    found = above_floor(
        [
            ChannelLevel("u", 1.6, MANY, "a"),
            ChannelLevel("u", 3.0, MANY, "b"),
            ChannelLevel("v", 9.0, MANY, "a"),
            ChannelLevel("v", 1.3, MANY),
            ChannelLevel("w", 1.1, MANY),
        ]
    )
    assert [(one.channel, one.phase) for one in found] == [("v", ""), ("u", "b")]


@pytest.mark.parametrize(("times", "said"), [(2.9, False), (-2.9, False), (3.1, True), (-3.1, True)])
def test_a_reading_three_standard_errors_off_speaks_against_the_answer(times: float, said: bool) -> None:
    readings = ((Prior("theta_air", 297.0, 0.1),), Parameters.of({"theta_air": 297.0 + 0.1 * times}))
    found = doubts([], readings)
    assert bool(found) is said and (not said or found[0].startswith("theta_air ends at"))


def test_an_effect_that_no_run_could_judge_speaks_against_the_answer() -> None:
    assert doubts([], unjudged={"lamp": "no run"}) == ["lamp could not be judged, and may be what is missing: no run"]


@pytest.mark.parametrize(
    ("value", "bounds", "neutral", "ends"),
    [
        (248.0, (150.0, 250.0), 0.0, False),
        (249.1, (150.0, 250.0), 0.0, True),
        (150.9, (150.0, 250.0), 0.0, True),
        (50.0, (1.0, 1e5), 0.0, False),
        (1.005, (1.0, 1e5), 0.0, True),
        (0.001, (0.0, 20.0), 0.0, False),
        (991.0, (-1000.0, 1000.0), 0.0, True),
        (-989.0, (-1000.0, 1000.0), 0.0, False),
        (0.995, (0.0, 1.0), 0.0, True),
        (1.0, (1.0, 3.0), 1.0, False),
        (7.0, (0.0, float("inf")), 0.0, False),
    ],
)
def test_a_value_is_at_a_bound_within_one_per_cent_of_the_way_to_it(
    value: float, bounds: tuple[float, float], neutral: float, ends: bool
) -> None:
    """Of the way from neutral, or of the range where that is shorter. A bound that is neutral itself is none."""
    assert at_bound(value, bounds, neutral) is ends


NAMES = ("E", "lag", "second_hardening.Q", "second_hardening.b")


def ended(sigma: tuple[float, ...] | None = (1.0, 1.0, 1.0, 1.0), on: tuple[str, ...] = (), **values: float) -> dict[str, str]:
    """What is undetermined of a fit, where everything else is sound; E has bounds of its own."""
    at = {"E": 200e3, "lag": 0.5, "second_hardening.Q": 20.0, "second_hardening.b": 60.0, **values}
    fit: Any = SimpleNamespace(names=NAMES, sigma=None if sigma is None else np.array(sigma), at_bound=[n in on for n in NAMES])
    return undetermined(Parameters.of(at), fit, lambda n: (150e3, 250e3) if n == "E" else (param(n).lower, param(n).upper))


def test_a_parameter_at_a_bound_or_without_a_standard_error_has_no_value_of_its_own() -> None:
    nan = float("nan")
    assert ended() == {}
    assert ended(E=249.9e3) == {"E": "E ends at its bound: 2.499e+05 MPa, bounds 150000 to 250000"}
    assert list(ended(E=150.9e3)) == ["E"], "its usual value is no end of the way to a bound"
    assert list(ended(**{"second_hardening.Q": -995.0})) == ["second_hardening.Q"]
    assert list(ended(**{"second_hardening.b": 0.1})) == ["second_hardening.b"], "of an exponent neutral is no place where it is off"
    assert ended((1.0, 1.0, nan, 1.0)) == {
        "second_hardening.Q": "second_hardening.Q = 20 MPa has no standard error: the data do not determine it"
    }
    assert set(ended(None)) == set(NAMES)
    assert ended((1.0, nan, 1.0, 1.0), on=("lag",), lag=0.0) == {}, "a lag of nothing is an answer"


def test_where_a_family_of_forms_ends_a_value_is_a_form_as_any_other() -> None:
    """The ends of a window of latent heat are rounded from sharp to logistic, and no farther; its width has a size of its own."""
    names = ("latent_heat.rounding", "latent_heat.width")
    fit: Any = SimpleNamespace(names=names, sigma=np.array([0.01, 0.01]), at_bound=[True, True])
    for rounding in (0.56, 0.02):
        at = Parameters.of({"latent_heat.rounding": rounding, "latent_heat.width": 2.0})
        assert list(undetermined(at, fit)) == ["latent_heat.width"]


def test_what_is_undetermined_speaks_against_the_answer() -> None:
    assert doubts([], ends={"E": "E ends at its bound"}) == ["E ends at its bound"]


def test_an_effect_in_whose_stead_another_explains_as_well_speaks_against_the_answer() -> None:
    assert doubts([], alike={"lamp": (), "ir_drift": ("ir_reflection",)}) == ["the data do not tell ir_drift from ir_reflection"]


def test_a_fit_that_has_not_settled_speaks_against_the_answer() -> None:
    assert doubts([], unsettled="200 evaluations") == ["the last fit has not settled: 200 evaluations"]


@pytest.mark.parametrize(("misfit", "knows", "far"), [(8.9, True, False), (9.1, True, True), (9.1, False, False)])
def test_the_force_is_taken_as_exact_while_the_model_misses_three_standard_errors(misfit: float, knows: bool, far: bool) -> None:
    parts: Any = SimpleNamespace(knows_force_error=knows, force_misfit=lambda *_: misfit)
    assert too_far(parts, Parameters.of({})) is far


@pytest.mark.parametrize(
    ("added", "more", "unlisted", "expected"),
    [
        ({}, False, None, "complete"),
        ({"lamp": ()}, False, None, "named"),
        ({"lamp": (), "ir_drift": ("ir_reflection",)}, False, None, "named-as-family"),
        ({"lamp": ()}, True, None, "unexplained"),
        ({}, True, None, "unexplained"),
        ({"lamp": ()}, False, {"when_s": [3.0, 9.0]}, "unlisted"),
        ({}, True, {"when_s": None}, "unexplained"),
        ({}, True, {"when_s": None, "over_state": {"of": "plastic strain"}}, "unlisted"),
    ],
)
def test_grade_of_an_answer(added: dict[str, tuple[str, ...]], more: bool, unlisted: dict[str, object] | None, expected: str) -> None:
    assert grade(added, more, unlisted) == expected
