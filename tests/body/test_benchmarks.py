"""Published benchmarks: NAFEMS T3 and T4, Cook's membrane near incompressibility, a beam bent far into the plastic range.

Where the figures come from: tests/reference/README.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu
from small_bodies import MISES, NOMINAL, bar_mesh, run_pass

from thermofit.body.body import tension_body, thermal_geometry
from thermofit.body.element.hex8 import element_data
from thermofit.body.heat.conduction import HeatConditions, heat_step, steady_temperature
from thermofit.body.mesh.mesh import Mesh
from thermofit.body.solve.newton import virgin_state
from thermofit.core.experiment import CELSIUS
from thermofit.law.page import Law, law_of

Told = Callable[[str, object], None]
FIXED = 1e9
"""Film of a surface whose temperature is prescribed, W/(m^2 K)."""


def t3(n: int, steps: int) -> float:
    """degC at x = 0.08 m, t = 32 s in a bar of 0.1 m: k = 35 W/(m K), rho c = 7200 x 440.5 J/(m^3 K), ends 0 and 100 sin(pi t/40) degC."""
    body = tension_body(bar_mesh((1, n, 1), (1.0, 100.0, 1.0), air=("y0",), clamp=("y1",)))
    geometry = thermal_geometry(body, np.zeros((body.mesh.n_nodes, 3)))
    theta, dt = np.full(body.mesh.n_nodes, CELSIUS), 32.0 / steps
    for k in range(steps):
        end = CELSIUS + 100.0 * np.sin(np.pi * (k + 1) * dt / 40.0)
        conditions = HeatConditions(35.0, 7200.0 * 440.5 * 1e-6, {"air": (FIXED, CELSIUS), "clamp": (FIXED, end)})
        theta = heat_step(body, geometry, conditions, theta, np.zeros_like(theta), (dt, "backward-euler")).theta
    place = np.isclose(body.mesh.nodes[:, 1], 80.0)
    return float(theta[place].mean() - CELSIUS)


def test_nafems_t3(record_property: Told) -> None:
    """36.60 degC. The steps are extrapolated from two, and the order in the mesh is two."""
    found = np.array([2.0 * t3(n, 1280) - t3(n, 640) for n in (5, 10, 20, 40)])
    changes = np.diff(found)
    record_property("NAFEMS T3, degC (36.60)", round(float(found[-1]), 3))
    record_property("NAFEMS T3, order in the mesh (2)", round(float(np.log2(changes[-2] / changes[-1])), 2))
    assert found[-1] == pytest.approx(36.60, abs=0.06)
    assert np.log2(changes[-2] / changes[-1]) == pytest.approx(2.0, abs=0.2)


def t4(n_x: int, n_y: int) -> float:
    """degC at E: 0.6 x 1.0 m, k = 52 W/(m K), lower side at 100 degC, right and upper side 750 W/(m^2 K) to 0 degC, left side adiabatic."""
    body = tension_body(bar_mesh((n_x, n_y, 1), (600.0, 1000.0, 10.0), air=("x1", "y1"), clamp=("y0",)))
    geometry = thermal_geometry(body, np.zeros((body.mesh.n_nodes, 3)))
    theta = steady_temperature(body, geometry, HeatConditions(52.0, 1.0, {"air": (750.0, CELSIUS), "clamp": (FIXED, CELSIUS + 100.0)}))
    return float(theta[body.mesh.nearest_node((600.0, 200.0, 0.0))] - CELSIUS)


def test_nafems_t4(record_property: Told) -> None:
    """18.3 degC; the corner, where 100 degC meets the convection, makes the way there slow."""
    found = np.array([t4(n, n // 3 * 5) for n in (12, 24, 48)])
    record_property("NAFEMS T4, degC (18.3)", round(float(found[-1]), 3))
    assert np.all(np.diff(np.abs(found - 18.25)) < 0.0) and found[-1] == pytest.approx(18.25, abs=0.05)


def bent(
    mesh: Mesh, law: Law, f_bar: bool, held: np.ndarray, load: np.ndarray, increments: int, *, drawn: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """u (n_np, 3) and nodal forces of a body under nodal loads (n_np, 3), with the degrees of freedom `held` (n_np, 3) at zero, or at their
    values `drawn`, by Newton in increments of the load with element stiffnesses alone."""
    data, theta = element_data(mesh.nodes, mesh.hexes, f_bar=f_bar), np.full(mesh.n_nodes, law.theta_ref)
    dof = (3 * mesh.hexes[:, :, None] + np.arange(3)).reshape(mesh.n_elements, 24)
    rows, columns = np.repeat(dof, 24, axis=1).ravel(), np.tile(dof, (1, 24)).ravel()
    free = np.flatnonzero(~held.ravel())
    u, state = np.zeros((mesh.n_nodes, 3)), virgin_state(mesh.n_elements)
    for k in range(increments):
        step = np.zeros(u.size)
        if drawn is not None:
            step[held.ravel()] = drawn[held] / increments
        for _ in range(25):
            force, stiffness, new, _ = run_pass(data, u, theta, state, law, tangent=True)
            inner = np.bincount(dof.ravel(), force.ravel(), minlength=u.size)
            residual = inner - load.ravel() * (k + 1) / increments
            if not step.any() and np.linalg.norm(residual[free]) < 1e-8 * max(float(np.linalg.norm(inner)), 1e-12):
                break
            matrix = coo_matrix((stiffness.ravel(), (rows, columns)), shape=(u.size, u.size)).tocsc()
            step[free] = -splu(matrix[free][:, free]).solve(residual[free] + (matrix @ step)[free])
            u += step.reshape(-1, 3)  # what is drawn goes with what follows it in the tangent, so that no element is crushed
            step = np.zeros(u.size)
        else:
            raise AssertionError(f"no convergence in increment {k + 1}")
        state = new
    return u, inner.reshape(-1, 3)


def cook(n: int, f_bar: bool) -> float:
    """Rise of the upper corner in mm: corners (0, 0), (48, 44), (48, 60), (0, 44), held at the left, 100 N along the right edge."""
    mesh = bar_mesh((n, n, 1), (48.0, 44.0, 1.0))
    x, s = mesh.nodes[:, 0].copy(), mesh.nodes[:, 1] / 44.0
    mesh.nodes[:, 1] = x * 44.0 / 48.0 + s * (44.0 - x * 28.0 / 48.0)
    bulk, mu = 400942.0, 80.1938
    lame = bulk - 2.0 * mu / 3.0
    law = law_of(NOMINAL.replace(E=mu * (3.0 * lame + 2.0 * mu) / (lame + mu), nu=0.5 * lame / (lame + mu)), plastic=False)
    held = np.zeros((mesh.n_nodes, 3), dtype=bool)
    held[:, 2] = True
    held[np.isclose(x, 0.0)] = True
    load = np.zeros((mesh.n_nodes, 3))
    right = np.isclose(x, 48.0)
    inner = right & ~(np.isclose(s, 0.0) | np.isclose(s, 1.0))
    load[right, 1], load[inner, 1] = 100.0 / (4.0 * n), 100.0 / (2.0 * n)
    u, _ = bent(mesh, law, f_bar, held, load, 4)
    return float(u[np.isclose(x, 48.0) & np.isclose(s, 1.0), 1].mean())


def test_cooks_membrane_near_incompressibility(record_property: Told) -> None:
    """F-bar converges from coarse meshes on; full integration locks."""
    found = np.array([cook(n, True) for n in (4, 8, 16)])
    locked = cook(8, False)
    record_property("Cook's membrane, mm (6.9)", round(float(found[-1]), 3))
    record_property("Cook's membrane, full integration, 8 x 8, mm", round(locked, 3))
    assert found[-1] == pytest.approx(6.9, abs=0.1) and np.all(np.diff(np.abs(found - 6.9)) < 0.0)
    assert locked < 0.75 * found[1]


def beam(n: int, f_bar: bool) -> float:
    """Force per mm of width at the end of a cantilever 40 x 4 mm in plane strain whose end is pushed by 8 mm, n x 5n elements."""
    mesh = bar_mesh((n, 5 * n, 1), (4.0, 40.0, 1.0))
    law = law_of(MISES.replace(H_lin=0.0, alpha_exp=0.0), plastic=True)
    held, drawn = np.zeros((mesh.n_nodes, 3), dtype=bool), np.zeros((mesh.n_nodes, 3))
    held[:, 2] = True
    held[np.isclose(mesh.nodes[:, 1], 0.0)] = True
    end = np.isclose(mesh.nodes[:, 1], 40.0)
    held[end, 0], drawn[end, 0] = True, 8.0
    _, inner = bent(mesh, law, f_bar, held, np.zeros((mesh.n_nodes, 3)), 16, drawn=drawn)
    return float(inner[end, 0].sum())


def test_plastic_bending_does_not_lock(record_property: Told) -> None:
    """The force of a bent beam converges from above, with F-bar from two elements over the height on."""
    bar = np.array([beam(n, True) for n in (2, 4, 8)])
    full = np.array([beam(n, False) for n in (2, 4, 8)])
    record_property("plastic bending, force per width with F-bar, N/mm", [round(float(v), 1) for v in bar])
    record_property("plastic bending, full integration, N/mm", [round(float(v), 1) for v in full])
    assert np.all(np.diff(bar) < 0.0) and np.all(np.diff(full) < 0.0) and np.all(full > bar)
    assert bar[0] / bar[2] < 1.5 and full[0] / full[2] > 2.5
