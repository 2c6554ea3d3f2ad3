"""The effect files: neutral is exactly off, formula and unit, declared parameters exist."""

from __future__ import annotations

import importlib
import pkgutil

import pytest
from hypothesis import given
from hypothesis import strategies as st

import thermofit.effects
from thermofit.core.parameters import param
from thermofit.effects.catalogue import _NO_EFFECTS as NOT_EFFECTS
from thermofit.effects.catalogue import SLOTS
from thermofit.effects.film_exchange import outward_flux
from thermofit.effects.linear_hardening import yield_stress

MODULES = sorted(module.name for module in pkgutil.iter_modules(thermofit.effects.__path__) if module.name not in NOT_EFFECTS)


@pytest.mark.parametrize("name", MODULES)
def test_effect_names_its_slot_and_its_parameters(name: str) -> None:
    module = importlib.import_module(f"thermofit.effects.{name}")
    assert module.SLOT in SLOTS
    assert module.FORMULA and module.SOURCE
    for declared in module.PARAMS:
        assert param(declared if isinstance(declared, str) else declared.name).unit


@given(st.floats(0.0, 2.0), st.floats(0.0, 1e4))
def test_linear_hardening(accumulated: float, H_lin: float) -> None:
    """H_lin Lambda, the derivative of H_lin Lambda^2 / 2 (4.6); exactly zero at H_lin = 0."""
    assert yield_stress(accumulated, 0.0) == 0.0
    assert yield_stress(accumulated, H_lin) == pytest.approx(H_lin * accumulated)


@given(st.floats(200.0, 1000.0), st.floats(200.0, 1000.0), st.floats(0.0, 1e8))
def test_film_exchange(theta: float, medium: float, alpha: float) -> None:
    """(4.13): outward, mW/mm^2 for a coefficient in W/(m^2 K); exactly zero at alpha = 0 or without a difference."""
    assert outward_flux(theta, medium, 0.0) == 0.0
    assert outward_flux(theta, theta, alpha) == 0.0
    watts_per_square_metre = alpha * (theta - medium)
    assert outward_flux(theta, medium, alpha) == pytest.approx(watts_per_square_metre * 1e3 / 1e6)
