"""The point driver against tables of an independent solver and against the finite element kernel on a homogeneous bar."""

from __future__ import annotations

import numpy as np
import pytest
from coupons import CYCLES, LOSSY, SHEET, WHOLE, corners
from small_bodies import bar_mesh, reference_table

from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.fem.body import tension_body
from thermofit.fem.march import History, Loading, MarchSettings, march
from thermofit.fem.newton import NewtonSettings
from thermofit.point.driver import PointSettings, Programme, simulate

SIZE = (4.0, 10.0, 1.5)


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


def bar(
    parameters: Parameters, time: np.ndarray, strain: np.ndarray, model: int, tolerance: float = 1e-10
) -> tuple[History, np.ndarray, np.ndarray]:
    """A bar of 1 x 2 x 1 elements through a history of strain: its history, nominal strain across (x, z)."""
    set_threads(1)
    mesh = bar_mesh((1, 2, 1), SIZE, air=("x1", "z1"))
    body = tension_body(mesh, control="displacement", symmetry=1.0)
    loading = Loading(time, SIZE[1] * strain, "displacement", from_rest=True)
    settings = MarchSettings(model=model, newton=NewtonSettings(tolerance=tolerance), coupling_tolerance=1e-9, max_cuts=0)
    history = march(body, parameters, loading, time, settings)
    corner = mesh.nearest_node(SIZE)
    lateral = history.u[:, corner, :] / np.array(SIZE)
    return history, lateral[:, 0] - lateral[0, 0], lateral[:, 2] - lateral[0, 2]


@pytest.mark.parametrize("model", [1, 2])
def test_homogeneous_bar(model: int) -> None:
    """Loading, partial unloading, reverse flow, hold, reload: stress, lateral strain and temperature of the adiabatic bar to 1e-6."""
    parameters = LOSSY.replace(alpha_air=0.0, alpha_clamp=0.0, tau=1e12, lag=0.0, theta_clamp=297.3, theta_ref=297.3)
    time, strain = corners(*CYCLES, steps=6)
    history, across, through = bar(parameters, time, strain, model)
    found = simulate(parameters, Programme.by_strain(time, strain), PointSettings(model=model, max_strain=1.0))
    stress = history.force / (SIZE[0] * SIZE[2])
    assert np.abs(found.stress - stress).max() < 1e-6 * np.abs(stress).max()
    assert np.abs(found.lateral_x - across).max() < 1e-6 * np.abs(across).max()
    assert np.abs(found.lateral_z - through).max() < 1e-6 * np.abs(through).max()
    assert np.ptp(history.theta, axis=1).max() < 1e-6, "the bar is homogeneous"
    rise = history.theta[:, 0] - history.theta[0, 0]
    assert rise.max() > 3.0
    assert np.abs(found.theta - found.theta[0] - rise).max() < 1e-6 * rise.max()
    assert found.accumulated[-1] == pytest.approx(history.largest_multiplier[-1], rel=1e-6)


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
