"""What tests of hardening laws share: a law by its closed form, worked out by hand, and parameters at which every law is plainly itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from coupons import SHEET
from scipy.integrate import quad

from thermofit.core.parameters import Parameters, param
from thermofit.law.hardening.catalogue import Hardening, hardening
from thermofit.law.page import law_of, plastic_energy, yield_stress


def values_of(law: Hardening) -> dict[str, float]:
    """Starts for metals in general, and usual values of what they leave out."""
    return {name: param(name).neutral for name in law.names} | {name: start for name, (start, _, _) in law.file.METALS.items()}


def parameters_of(law: Hardening) -> Parameters:
    """The sheet of the point driver's tests with that hardening."""
    return SHEET.replace(**values_of(law))


def check_closed_form(
    name: str, values: Mapping[str, float], points: tuple[tuple[float, float, float, float], ...], by_hand: Callable[[float], float]
) -> None:
    """Stress, slope and stored energy of the page at `points` = (alpha, stress, slope, energy) worked out by hand, and the stress of
    `by_hand` over many alpha, whose integral over the initial yield stress is the stored energy. beta = 1: nothing else is stored."""
    law = law_of(Parameters.of({"beta": 1.0, "theta_ref": 297.0, **values}), name)
    for alpha, stress, slope, energy in points:
        found = yield_stress(alpha, alpha, law)
        assert found[0] == pytest.approx(stress, rel=1e-9), alpha
        assert found[1] + found[2] == pytest.approx(slope, rel=1e-9, abs=1e-12), alpha
        assert plastic_energy(alpha, alpha, law) == pytest.approx(energy, rel=1e-8, abs=1e-12), alpha
    begin = yield_stress(0.0, 0.0, law)[0]
    for alpha in np.geomspace(1e-4, 0.9, 13):
        assert yield_stress(alpha, alpha, law)[0] == pytest.approx(by_hand(alpha), rel=1e-12), alpha
        # a square in the variable: a root at zero is smooth then
        work = quad(lambda u: 2.0 * u * (by_hand(u * u) - begin), 0.0, np.sqrt(alpha), epsabs=1e-12, epsrel=1e-11, limit=400)[0]
        assert plastic_energy(alpha, alpha, law) == pytest.approx(work, rel=1e-7, abs=1e-9), alpha


def curve_of(name: str, values: Mapping[str, float]) -> Callable[[np.ndarray], np.ndarray]:
    """The curve of a law with given values, others neutral, linear hardening included."""
    parameters = Parameters.of({"theta_ref": 297.0, **values})
    return lambda accumulated: hardening(name).curve(parameters, accumulated)
