"""Parameters and programmes of coupons for the tests of the point driver."""

from __future__ import annotations

import numpy as np
from small_bodies import bar_mesh

from thermofit.body.body import tension_body
from thermofit.body.mesh.mesh import Mesh
from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.core.slots import Slots
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate

SHEET = Parameters.of(
    {
        **{"E": 68396.66, "nu": 0.34, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "F": 0.35},
        **{"alpha_exp": 20.21e-6, "kappa": 133.45, "c0": 2.22, "beta": 0.79},
        **{"theta_air": 296.7, "theta_clamp": 296.7, "theta_ref": 296.7},
    }
)
"""The sheet of the reference solution; adiabatic, since tau is neutral."""
LOSSY = SHEET.replace(tau=70.0, lag=0.8, H_lin=40.0, theta_air=297.3, F=0.42, G=0.55, H=0.47)
WHOLE = PointSettings(max_strain=1.0)
"""Every interval in one step."""


def corners(*points: tuple[float, float], steps: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Time and value along straight lines between corners (time, value), each line in the same number of steps."""
    time, value = np.array(points).T
    at = np.linspace(0.0, len(points) - 1.0, steps * (len(points) - 1) + 1)
    index = np.arange(len(points), dtype=float)
    return np.interp(at, index, time), np.interp(at, index, value)


CYCLES = ((0.0, 0.0), (30.0, 0.012), (32.0, 0.006), (50.0, -0.011), (60.0, 0.018), (90.0, 0.018), (95.0, -0.02), (140.0, 0.03))


def cycles(steps: int = 12, theta_start: float | None = None) -> Programme:
    """Strain cycles of growing amplitude with partial unloading, a change of rate and a hold."""
    return Programme.by_strain(*corners(*CYCLES, steps=steps), theta_start)


SIZE = (4.0, 10.0, 1.5)
"""Edges of the bar in mm."""


def bar(
    parameters: Parameters,
    time: np.ndarray,
    value: np.ndarray,
    model: int | str | Slots,
    tolerance: float = 1e-10,
    control: str = "displacement",
    mesh: Mesh | None = None,
) -> tuple[History, np.ndarray, np.ndarray]:
    """A bar of 1 x 2 x 1 elements, or another mesh of its edges, through a history of nominal strain, or of nominal stress in MPa where
    `control` is "force": its history, nominal strain across (x, z)."""
    set_threads(1)
    mesh = bar_mesh((1, 2, 1), SIZE, air=("x1", "z1")) if mesh is None else mesh
    body = tension_body(mesh, control=control, symmetry=1.0)
    pulled = control == "force"
    loading = Loading(time, value * (SIZE[0] * SIZE[2] if pulled else SIZE[1]), control, from_rest=not pulled)
    settings = MarchSettings(model=model, newton=NewtonSettings(tolerance=tolerance), coupling_tolerance=1e-9, max_cuts=0)
    history = march(body, parameters, loading, time, settings)
    corner = mesh.nearest_node(tuple(mesh.nodes.max(axis=0)))
    lateral = history.u[:, corner, :] / np.array(SIZE)
    return history, lateral[:, 0] - lateral[0, 0], lateral[:, 2] - lateral[0, 2]


def bar_and_point(
    parameters: Parameters,
    time: np.ndarray,
    strain: np.ndarray,
    model: int | str | Slots,
    control: str = "displacement",
    tolerance: float = 1e-11,
    mesh: Mesh | None = None,
) -> None:
    """Assert that stress and strain, lateral strain, temperature and Lambda of the adiabatic bar are those of the point, to 1e-8. By
    "force" the bar takes the stress that the strain asks of the point."""
    parameters = parameters.replace(alpha_air=0.0, alpha_clamp=0.0, tau=1e12, lag=0.0, theta_clamp=297.3, theta_ref=297.3)
    found = simulate(parameters, Programme.by_strain(time, strain), PointSettings(model=model, max_strain=1.0))
    if control == "force":
        found = simulate(parameters, Programme.under_stress(time, found.stress), PointSettings(model=model, max_strain=1.0))
    history, across, through = bar(parameters, time, found.stress if control == "force" else strain, model, tolerance, control, mesh)
    stress, along = history.force / (SIZE[0] * SIZE[2]), (history.u_top - history.u_top[0]) / SIZE[1]
    assert np.abs(found.stress - stress).max() < 1e-8 * np.abs(stress).max()
    assert np.abs(found.strain - along).max() < 1e-8 * np.abs(along).max()
    assert np.abs(found.lateral_x - across).max() < 1e-8 * np.abs(across).max()
    assert np.abs(found.lateral_z - through).max() < 1e-8 * np.abs(through).max()
    assert np.ptp(history.theta, axis=1).max() < 1e-6, "the bar is homogeneous"
    rise = history.theta[:, 0] - history.theta[0, 0]
    assert rise.max() > 3.0
    assert np.abs(found.theta - found.theta[0] - rise).max() < 1e-8 * rise.max()
    assert abs(found.accumulated[-1] - history.largest_multiplier[-1]) < 1e-8 * found.accumulated[-1]
    assert min(step.smallest_dissipation for step in history.balance) >= 0.0


def flow_stress_of(found: PointHistory, parameters: Parameters) -> np.ndarray:
    """|Mandel stress| in the norm of Hill along the load: nominal stress times stretch, since the lateral faces are free."""
    stretch = np.exp(found.states[:, 1] + found.states[:, 4])
    return np.asarray(np.sqrt(parameters["F"] + parameters["H"]) * np.abs(found.stress) * stretch)


def ramp(rate: float, strain: float, steps: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Time and strain of a straight ramp at a rate in 1/s."""
    return np.linspace(0.0, strain / rate, steps + 1), np.linspace(0.0, strain, steps + 1)
