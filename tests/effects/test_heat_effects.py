"""Closed forms of the effects of the heat problem, as functions: neutral is exactly off, formula, sign and unit, complex steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from thermofit.core import parameters
from thermofit.core.errors import StudyError
from thermofit.effects import catalogue
from thermofit.effects.air_drift import boundary_temperature as air_drift
from thermofit.effects.capacity_by_temperature import capacity
from thermofit.effects.catalogue import HEAT, Effect, effects, load_effect
from thermofit.effects.clamp_difference import boundary_temperature as clamp_difference
from thermofit.effects.clamp_drift import boundary_temperature as clamp_drift
from thermofit.effects.conductivity_by_temperature import conductivity
from thermofit.effects.free_convection import surface_flux as free_convection
from thermofit.effects.initial_gradient import initial_temperature
from thermofit.effects.lamp import RAMP
from thermofit.effects.lamp import surface_flux as lamp
from thermofit.effects.latent_heat import heat_source
from thermofit.effects.radiation import surface_flux as radiation

BUILT_IN = [e for e in effects(HEAT) if not e.name.startswith("user_")]
X, Y, THETA = np.array([0.5, 1.0, 2.0]), np.array([-40.0, 3.0, 40.0]), np.array([290.0, 301.0, 345.0])
ARGUMENTS = {
    "heat_source": (THETA, np.array([0.012, 0.02, 0.024]), np.array([1e-3, 2e-3, 0.0]), 40.0, X, Y),
    "surface_flux": (THETA, 31.0, 297.0 + 0.0 * THETA, Y),
    "boundary_temperature": (Y, 40.0, 25.0),
    "capacity": (THETA, 296.0),
    "conductivity": (THETA, 296.0),
    "initial_temperature": (X, Y, 150.0),
}
NEUTRAL = {"capacity": 1.0, "conductivity": 1.0}


def probed(effect: Effect) -> list[float]:
    return [p.probe if p.probe is not None else p.neutral for p in effect.params]


def test_catalogue_holds_them() -> None:
    assert {e.name for e in BUILT_IN} >= {
        *("radiation", "lamp", "clamp_drift", "clamp_step", "air_drift", "clamp_difference", "latent_heat"),
        *("capacity_by_temperature", "conductivity_by_temperature", "initial_gradient", "free_convection", "film_by_height"),
    }


@pytest.mark.parametrize("effect", BUILT_IN, ids=lambda e: e.name)
def test_neutral_is_exactly_off_and_the_probe_is_felt(effect: Effect) -> None:
    """Whatever the other Params are."""
    others = [1.1 * p.neutral for p in effect.params[1:]]
    off, on = (effect.act(*ARGUMENTS[effect.slot], a, *others) for a in (effect.amplitude.neutral, probed(effect)[0]))
    assert np.all(off == NEUTRAL.get(effect.slot, 0.0))
    assert np.any(on != off) and np.shape(on) == (3,)


@pytest.mark.parametrize("effect", BUILT_IN, ids=lambda e: e.name)
def test_every_param_has_an_exact_complex_step(effect: Effect) -> None:
    """Off and on: the derivative by complex step is that of differences."""
    for amplitude in (effect.amplitude.neutral, probed(effect)[0]):
        numbers = [amplitude, *probed(effect)[1:]]
        for k, p in enumerate(effect.params):
            h = 1e-4 * p.scale

            def value(x: complex, k: int = k, numbers: list[float] = numbers) -> np.ndarray:
                return np.asarray(effect.act(*ARGUMENTS[effect.slot], *numbers[:k], numbers[k] + x, *numbers[k + 1 :]))

            expected = (value(h) - value(-h)) / (2.0 * h)
            assert value(1e-30j).imag / 1e-30 == pytest.approx(expected, rel=1e-5, abs=1e-7 * (1.0 + np.abs(expected).max())), p.name


@given(st.floats(250.0, 400.0), st.floats(0.0, 1.0))
def test_radiation(theta: float, emissivity: float) -> None:
    """A black body of 1000 K into the void: 56.70 kW/m^2; near the surroundings a film of 4 sigma emissivity theta^3."""
    assert radiation(np.array(1000.0), 0.0, np.array(0.0), 1.0) == pytest.approx(56.70374)
    film = 1e3 * float(radiation(np.array(theta + 1e-4), 0.0, np.array(theta - 1e-4), emissivity)) / 2e-4
    assert film == pytest.approx(1e3 * 4.0 * 5.670374419e-11 * 1e3 * emissivity * theta**3 / 1e3, rel=1e-6, abs=1e-12)


@given(st.floats(0.5, 80.0), st.sampled_from([0.25, 1.0 / 3.0]))
def test_free_convection_of_a_warm_and_a_cold_plate(difference: float, exponent: float) -> None:
    """Nu ~ Ra^n: sixteen times the difference has 16^n times the film, and a plate that is colder takes what a warmer one gives off."""
    q = lambda d: float(free_convection(np.array(297.0 + d), 0.0, np.array(297.0), 1.5, exponent))  # noqa: E731
    assert q(difference) == pytest.approx(-q(-difference), rel=1e-9) and q(0.0) == 0.0
    assert q(16.0 * difference) / q(difference) == pytest.approx(16.0 ** (1.0 + exponent), rel=0.01)
    assert q(difference) == pytest.approx(1.5e-3 * difference ** (1.0 + exponent), rel=0.01)


def test_lamp_brings_its_power_from_its_start_on() -> None:
    """Inward heat over 0 to 100 s is absorbed (100 - start); half of the power at the start, 88 per cent a ramp later."""
    inward = lambda t: -float(lamp(np.array(300.0), t, np.array(297.0), 0.2, 40.0, RAMP))  # noqa: E731
    assert quad(inward, 0.0, 100.0, points=(40.0,))[0] == pytest.approx(0.2 * 60.0, rel=1e-9)
    assert inward(40.0) == pytest.approx(0.1)
    assert inward(40.0 + 1.0) == pytest.approx(0.1 * (1.0 + np.tanh(1.0))), "as incandescent lamps do, in a second"
    assert inward(0.0) < 1e-15


@pytest.mark.parametrize(("drift", "of_both"), [(air_drift, ()), (clamp_drift, (0.0,))])
def test_drift_is_linear_at_first_and_saturates(drift, of_both) -> None:  # type: ignore[no-untyped-def]
    assert drift(Y, 0.0, 0.0, 0.01, *of_both, 200.0) == pytest.approx(0.0)
    assert drift(Y, 900.0, 300.0, 0.01, *of_both, 1e7) == pytest.approx(3.0, rel=1e-4)
    assert drift(Y, 900.0, 300.0, 0.01, *of_both, 200.0) == pytest.approx(0.01 * 200.0 * (1.0 - np.exp(-1.5)))
    assert drift(Y, 0.0, 1e5, 0.01, *of_both, 200.0) == pytest.approx(2.0)


@pytest.mark.parametrize(("apart", "moved"), [(0.02, (0.0, 3.0, 3.0)), (-0.02, (3.0, 0.0, 0.0))])
def test_one_jaw_may_drift_alone(apart: float, moved: tuple[float, float, float]) -> None:
    assert clamp_drift(Y, 0.0, 300.0, 0.01, apart, 1e9) == pytest.approx(2.0 * np.array(moved), rel=1e-4)


def test_jaws_differ_by_the_difference() -> None:
    assert clamp_difference(Y, 0.0, 0.0, 3.0) == pytest.approx([-1.5, 1.5, 1.5])


def test_latent_heat_in_total() -> None:
    """Over the whole window: heat x 2 s / tanh(s / e), at any rate of flow; in its middle the full heat per strain."""
    none = np.zeros(1)

    def power(accumulated: float) -> float:
        return float(heat_source(none + 300.0, none + accumulated, none + 1.0, 0.0, none, none, 40.0, 0.03, 0.02, 0.1)[0])

    half = 0.5 * np.arccosh(np.cosh(10.0) - 2.0)
    assert quad(power, 0.0, 0.1, points=(0.02, 0.04))[0] == pytest.approx(40.0 * 0.02 * 0.1 * 2.0 * half / np.tanh(half), rel=1e-6)
    assert power(0.03) == pytest.approx(40.0, rel=1e-4) and power(0.0) < 1e-3
    twice = heat_source(none + 300.0, none + 0.03, none + 2.0, 0.0, none, none, 40.0, 0.03, 0.02, 0.1)
    assert float(twice[0]) == pytest.approx(2.0 * power(0.03))


@pytest.mark.parametrize("rounding", [0.02, 0.1, 0.3, 0.5, 0.56])
def test_a_window_has_its_height_and_its_width_however_round_its_ends_are(rounding: float) -> None:
    """At the centre all of the heat, half of it at half a width; in total heat 2 s / tanh(s / e)."""
    accumulated = np.array([0.06, 0.056, 0.064])
    power = heat_source(accumulated + 240.0, accumulated, np.ones(3), 0.0, accumulated, accumulated, 40.0, 0.06, 0.008, rounding)
    assert power == pytest.approx([40.0, 20.0, 20.0], rel=1e-9)
    fine = np.linspace(0.0, 0.12, 4001)
    power = heat_source(fine + 240.0, fine, np.ones(4001), 0.0, fine, fine, 40.0, 0.06, 0.008, rounding)
    half = 0.5 * np.arccosh(np.cosh(1.0 / rounding) - 2.0)
    assert np.trapezoid(power, fine) == pytest.approx(40.0 * 0.008 * rounding * 2.0 * half / np.tanh(half), rel=1e-3)


def test_the_roundest_window_is_the_rate_of_a_logistic_transformation() -> None:
    """That of (1 + tanh((Lambda - centre) / e)) / 2, within 1 % of its peak, with the same width at half its height."""
    accumulated = np.linspace(0.0, 0.12, 401)
    power = heat_source(accumulated + 240.0, accumulated, np.ones(401), 0.0, accumulated, accumulated, 40.0, 0.06, 0.008, 0.56)
    e = 0.008 / (2.0 * np.arccosh(np.sqrt(2.0)))
    assert np.abs(power - 40.0 / np.cosh((accumulated - 0.06) / e) ** 2).max() < 0.4


@pytest.mark.parametrize("factor", [capacity, conductivity])
def test_factors_by_temperature(factor) -> None:  # type: ignore[no-untyped-def]
    assert factor(THETA, 290.0, 2e-3) == pytest.approx([1.0, 1.022, 1.11])


def test_initial_gradient_is_the_slowest_mode_and_a_tilt() -> None:
    y = np.array([-75.0, 0.0, 75.0])
    assert initial_temperature(y, y, 150.0, 2.0, 0.0) == pytest.approx([0.0, 2.0, 0.0], abs=1e-12)
    assert initial_temperature(y, y, 150.0, 2.0, 0.5) == pytest.approx([-1.0, 2.0, 1.0])


def test_where_an_effect_acts_must_be_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(parameters, "OF_EFFECTS", dict(parameters.OF_EFFECTS))
    text = """
from thermofit.core.parameters import Param
SLOT, FORMULA, SOURCE = "surface_flux", "q += q0", "made up"
PARAMS = (Param("user_flux.q0", "mW/mm^2", 0.0, -1.0, 1.0, 0.1, "flux", probe=0.1),)
def surface_flux(theta, time, surroundings, q0):
    return q0 + 0.0 * theta
"""
    path = tmp_path / "user_flux.py"
    for on in ("", "ON = 'air'\n", "ON = ('wall',)\n", "ON = ()\n"):
        path.write_text(text + on)
        with pytest.raises(StudyError, match="ON is"):
            load_effect(path)
    path.write_text(text + "ON = ('air', 'clamp')\n")
    assert load_effect(path).on == ("air", "clamp")
