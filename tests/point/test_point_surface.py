"""Yield surfaces by linear transformations on a coupon and in a bar of elements: the same, in closed form, and differentiated."""

from __future__ import annotations

import numpy as np
import pytest
from coupons import CYCLES, LOSSY, SHEET, bar_and_point, corners, cycles
from published_surfaces import AA2090_T3, TWISTED

from thermofit.core.slots import Slots
from thermofit.law.page import along_tension
from thermofit.point.driver import PointSettings, Programme, simulate, simulate_rates

STRUCTURE = {
    **{"backstress_first.C": 4000.0, "backstress_first.gamma": 60.0, "elastic_degradation.amount": 0.15},
    **{"tension_compression.difference": 0.06},
}
CASES = {
    "hosford": (Slots(1, "hosford"), {"hosford.a": 8.0}),
    "yld2004": (Slots(1, "yld2004"), AA2090_T3),
    "with-structure": (Slots(2, "yld2004"), {**TWISTED, **STRUCTURE}),
}


@pytest.mark.parametrize("control", ["displacement", "force"])
@pytest.mark.parametrize("case", CASES)
def test_the_body_is_the_point(case: str, control: str) -> None:
    """Stress, lateral strains, temperature and Lambda of an adiabatic bar of elements through cycles, to 1e-8."""
    slots, values = CASES[case]
    time, strain = corners(*CYCLES, steps=5)
    bar_and_point(LOSSY.replace(**values), time, strain, slots, control)


def test_pull_in_closed_form() -> None:
    """Kirchhoff stress sigma_y / phi of unit tension, plastic strains across and through in the ratio of the normal."""
    slots, parameters = CASES["yld2004"][0], SHEET.replace(**AA2090_T3, alpha_exp=0.0, c0=1e9)
    found = simulate(parameters, Programme.by_strain(np.linspace(0.0, 100.0, 101), np.linspace(0.0, 0.1, 101)), PointSettings(slots))
    size, across = along_tension(parameters, slots)
    plastic = found.states[:, :3]
    grown = found.accumulated > 0.0
    kirchhoff = found.stress[grown] * np.exp(plastic[grown, 1] + found.states[grown, 4])
    sigma_y = 292.73 - (292.73 - 128.92) * np.exp(-10.87 * found.accumulated[grown])
    assert kirchhoff == pytest.approx(sigma_y / size, rel=1e-9)
    assert plastic[grown, 1] == pytest.approx(size * found.accumulated[grown], rel=1e-9)
    assert plastic[grown, 0] == pytest.approx(-across * plastic[grown, 1], rel=1e-9)


@pytest.mark.parametrize("case", ["yld2004", "with-structure"])
def test_taylor_order_two_of_a_coupon(case: str) -> None:
    """Stress, lateral strain and temperature of a cycled coupon by exponent and coefficients, with effects on."""
    slots, values = CASES[case]
    base, programme, settings = LOSSY.replace(**values), cycles(6), PointSettings(slots, max_strain=0.004)
    names = tuple(name for name in values if name.startswith("yld2004.") and not name.endswith(("44", "55", "66")))
    start, rates = simulate_rates(base, names, programme, settings)
    weight = np.cos(np.arange(len(start.time)))
    channels = ("stress", "lateral_x", "theta")

    def seen(history: object) -> float:
        return float(sum(weight @ getattr(history, c) / np.ptp(getattr(start, c)) for c in channels))

    for k, name in enumerate(names):
        slope = float(sum(weight @ rates[c][:, k] / np.ptp(getattr(start, c)) for c in channels))
        assert slope != 0.0, name
        size, left = 1e-3, []
        for h in (size, 0.5 * size):
            left.append(abs(seen(simulate(base.replace(**{name: base[name] + h}), programme, settings)) - seen(start) - h * slope))
        assert left[1] < 0.3 * left[0] + 1e-9, (name, left)


def test_shears_and_the_exponent_of_an_isotropic_surface_are_not_felt_in_tension() -> None:
    for slots, values in (CASES["hosford"], CASES["yld2004"]):
        names = tuple(n for n in values if n.endswith(("44", "55", "66", "hosford.a")))
        _, rates = simulate_rates(SHEET.replace(**values), names, cycles(3), PointSettings(slots))
        assert names and np.abs(rates["stress"]).max() < 1e-9 and np.abs(rates["lateral_x"]).max() < 1e-12
