"""Derivatives of the point driver: Taylor tests of order two and central differences for every parameter."""

from __future__ import annotations

import numpy as np
import pytest
from coupons import LOSSY, SHEET, cycles

from thermofit.core.parameters import NAMES, Parameters, param
from thermofit.point.driver import CHANNELS, PointSettings, Programme, simulate, simulate_rates

FINE = PointSettings(max_strain=0.004)
BASE = LOSSY.replace(theta_ref=296.1)
FELT = (
    "E", "nu", "M_y0", "M_yinf", "H_exp", "H_lin", "F", "H", "alpha_exp", "c0", "beta", "theta_ref", "tau", "lag", "theta_air",
)  # fmt: skip
"""Parameters that a coupon feels; the others have no influence on it (G acts on the two equal lateral stresses)."""


def by_stress(parameters: Parameters) -> Programme:
    """The stress of a monotonic strain history of another material: a programme that no parameter moves."""
    strain = Programme.by_strain(np.linspace(0.0, 60.0, 25), np.linspace(0.0, 0.03, 25))
    found = simulate(parameters.replace(E=0.97 * parameters["E"], M_y0=0.98 * parameters["M_y0"]), strain)
    return Programme.under_stress(found.time, found.stress)


def case(which: str) -> tuple[Programme, PointSettings]:
    if which == "stress":
        return by_stress(BASE), FINE
    return cycles(10), PointSettings(model=int(which[-1]), max_strain=0.004, closed_form="exact" in which)


CASES = ("exact-1", "exact-2", "euler-2", "stress")


def step(name: str) -> float:
    """A change of one in a thousand; of the temperatures of a kelvin, to which a coupon answers weakly."""
    if name.startswith("theta_"):
        return 1.0
    return 1e-3 * (BASE[name] or param(name).scale)


@pytest.mark.parametrize("which", CASES)
@pytest.mark.parametrize("name", FELT)
def test_taylor_order_two(which: str, name: str) -> None:
    """f(p + h) - f(p) - h f' falls as h^2 for the sum of all channels, each against its size."""
    programme, settings = case(which)
    start, rates = simulate_rates(BASE, (name,), programme, settings)
    weight = {c: np.cos(np.arange(len(start.time)) + k) / max(np.ptp(getattr(start, c)), 1e-30) for k, c in enumerate(CHANNELS)}
    slope = sum(float(w @ rates[c][:, 0]) for c, w in weight.items())
    remainder = []
    for h in (step(name), 0.5 * step(name)):
        moved = simulate(BASE.replace(**{name: BASE[name] + h}), programme, settings)
        change = sum(float(w @ (getattr(moved, c) - getattr(start, c))) for c, w in weight.items())
        remainder.append(abs(change - h * slope))
        linear = abs(change)
    round_off = 1e-9 * len(CHANNELS)
    assert linear > round_off, "the parameter matters"
    assert remainder[1] < 0.3 * remainder[0] + round_off or remainder[1] < 1e-7 * linear


@pytest.mark.parametrize("which", CASES)
def test_central_differences_of_every_channel(which: str) -> None:
    programme, settings = case(which)
    start, rates = simulate_rates(BASE, NAMES, programme, settings)
    plain = simulate(BASE, programme, settings)
    assert np.array_equal(plain.states, start.states), "differentiation changes nothing"
    for k, name in enumerate(NAMES):
        if name not in FELT:
            assert not rates.rates[:, :, k].any(), name
            continue
        h = 1e-2 * step(name)
        upper, lower = (simulate(BASE.replace(**{name: BASE[name] + s * h}), programme, settings) for s in (1.0, -1.0))
        for channel in CHANNELS:
            found = rates[channel][:, k]
            difference = (getattr(upper, channel) - getattr(lower, channel)) / (2.0 * h)
            round_off = 2e-13 * (np.abs(getattr(start, channel)).max() + 1e-3) / h
            assert np.abs(found - difference).max() < 2e-5 * np.abs(found).max() + 20.0 * round_off, (name, channel)


def test_derivatives_at_neutral_heat_loss_and_lag() -> None:
    """At lag = 0 the sensor's derivative is minus the slope of the temperature; with the neutral tau hardly anything is lost."""
    programme = cycles(6)
    found, rates = simulate_rates(SHEET, ("tau", "lag"), programme)
    slope = np.diff(found.theta) / np.diff(found.time)
    assert rates["theta_sensor"][1:, 1] == pytest.approx(-slope, rel=1e-9, abs=1e-12)
    assert np.abs(rates["stress"][:, 0]).max() * SHEET["tau"] < 1e-6


def test_start_temperature_of_the_air_moves_with_the_air() -> None:
    """A specimen that starts at air temperature stays there: d theta / d theta_air = 1 at rest, 0 where the start is measured."""
    time = np.array([0.0, 5.0])
    for start, expected in ((None, (1.0, 1.0)), (300.0, (0.0, 1.0 - np.exp(-5.0 / 70.0)))):
        _, rates = simulate_rates(LOSSY.replace(alpha_exp=0.0), ("theta_air",), Programme.under_stress(time, 0.0 * time, start))
        assert rates["theta"][:, 0] == pytest.approx(expected, rel=1e-12)
