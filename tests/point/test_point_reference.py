"""The point driver against tables of an independent solver and against the finite element kernel on a homogeneous bar."""

from __future__ import annotations

import numpy as np
import pytest
from coupons import CYCLES, LOSSY, SHEET, SIZE, WHOLE, bar, bar_and_point, corners
from reference import reference_table

from thermofit.point.driver import PointSettings, Programme, simulate


@pytest.mark.parametrize("model", [1, 2])
def test_uniaxial_tables(model: int) -> None:
    """Adiabatic and isothermal tension, stretches and stress over the multiplier; the tables are exact to their eight digits."""
    table = reference_table(f"uniaxial_model{model}.csv")
    rows = np.flatnonzero(table["Lambda"] >= 0.0)
    for kind, parameters in (("adiab", SHEET), ("isoth", SHEET.replace(tau=1e-3))):
        strain = np.append(0.0, table[f"stretch_y_{kind}"][rows] - 1.0)
        time = 1000.0 * np.arange(len(strain))
        found = simulate(parameters, Programme.by_strain(time, strain), PointSettings(model=model, max_strain=1e-3))
        stress = table["P_adiab_MPa" if kind == "adiab" else "P_isoth_MPa"][rows]
        assert found.stress[1:] == pytest.approx(stress, rel=2e-6), kind
        assert found.accumulated[1:] == pytest.approx(table["Lambda"][rows], abs=3e-7), kind
        assert found.alpha[1:] == pytest.approx(table["alpha"][rows], abs=3e-7), kind
        assert found.dissipated[1:] == pytest.approx(table["dissipation_mJ_mm3"][rows], abs=2e-5), kind
        if kind == "isoth":
            assert found.lateral_x[1:] == pytest.approx(table["stretch_x_isoth"][rows] - 1.0, abs=1e-7)
            assert found.lateral_z[1:] == pytest.approx(table["stretch_z_isoth"][rows] - 1.0, abs=1e-7)
        else:
            assert found.theta[1:] == pytest.approx(table["theta_adiabatic_K"][rows], abs=2e-4)


@pytest.mark.parametrize("model", [1, 2])
def test_homogeneous_bar(model: int) -> None:
    """Loading, partial unloading, reverse flow, hold, reload: stress, lateral strain and temperature of the adiabatic bar to 1e-6."""
    time, strain = corners(*CYCLES, steps=6)
    bar_and_point(LOSSY, time, strain, model)


def test_film_of_a_thin_bar_is_a_time_constant() -> None:
    """Air on two faces of a small bar: tau = c0 V / (alpha A), up to the change of area and the time scheme of the bar."""
    film = 20.0
    volume, area = SIZE[0] * SIZE[1] * SIZE[2], SIZE[1] * (SIZE[0] + SIZE[2])
    tau = LOSSY["c0"] * volume / (1e-3 * film * area)
    parameters = LOSSY.replace(alpha_air=film, alpha_clamp=0.0, tau=tau, lag=0.0, kappa=1e5, theta_ref=297.3)
    time, strain = corners((0.0, 0.0), (20.0, 0.02), (400.0, 0.02), steps=60)
    history, _, _ = bar(parameters, time, strain, 2, 1e-8)
    found = simulate(parameters, Programme.by_strain(time, strain), WHOLE)
    rise = history.theta.mean(axis=1)
    assert np.abs(found.theta - rise).max() < 0.01 * np.ptp(rise)
    assert found.theta[-1] - found.theta[0] < 0.2 * np.ptp(found.theta), "most of the heat has left"
