"""Manufactured solutions: observed orders of the discretisation on distorted meshes, with sources that make a chosen field exact.

Mechanics: x -> X + u(X) with a body force b = -Div P(F(X)) by differences of the closed form of P; the load vector int N b dV and the
nonlinear solve are those of this file. Heat: a chosen theta(X, t) without flux through the surface, with the source that it needs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu
from small_bodies import NOMINAL, bar_mesh, run_pass

from thermofit.body.body import tension_body, thermal_geometry
from thermofit.body.element.hex8 import element_data, shape_functions
from thermofit.body.heat.conduction import HeatConditions, heat_step
from thermofit.body.mesh.mesh import Mesh
from thermofit.body.solve.newton import virgin_state
from thermofit.law.page import Law, law_of

Told = Callable[[str, object], None]

SIZE = np.array([2.0, 3.0, 1.5])
_P, _W = np.polynomial.legendre.leggauss(3)
POINTS = np.array([[a, b, c] for a in _P for b in _P for c in _P])
WEIGHTS = np.array([a * b * c for a in _W for b in _W for c in _W])
"""27 points: the source and the norm of the error are integrated more exactly than the element."""


def distorted(n: int) -> Mesh:
    """Block of 2n x 3n x 1.5n elements whose inner nodes are moved smoothly, so that all meshes are of one family, and not affinely."""
    mesh = bar_mesh((n, n, n), (2.0, 3.0, 1.5))
    s = np.prod(np.sin(np.pi * mesh.nodes / SIZE), axis=1)[:, None]
    mesh.nodes[:] = mesh.nodes + 0.12 * s * np.array([1.0, -1.2, 0.8])
    return mesh


def integration(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shape functions (27, 8), positions (n_el, 27, 3) and volumes (n_el, 27) of the fine rule."""
    n, dn = shape_functions(POINTS)
    x = mesh.nodes[mesh.hexes]
    jacobian = np.einsum("eai,gaj->egij", x, dn)
    return n, np.einsum("ga,eai->egi", n, x), np.linalg.det(jacobian) * WEIGHTS


def loads(mesh: Mesh, source: np.ndarray) -> np.ndarray:
    """int N_a source dV at the nodes (n_np, m) of a density at the fine points (n_el, 27, m)."""
    n, _, volume = integration(mesh)
    local = np.einsum("ga,eg,egi->eai", n, volume, source)
    out = np.zeros((mesh.n_nodes, source.shape[2]))
    np.add.at(out, mesh.hexes, local)
    return out


def error(mesh: Mesh, nodal: np.ndarray, exact: Callable[[np.ndarray], np.ndarray]) -> float:
    """L2 norm of a nodal field (n_np, m) minus a function of X (..., 3)."""
    n, x, volume = integration(mesh)
    difference = np.einsum("ga,eai->egi", n, nodal[mesh.hexes]) - exact(x)
    return float(np.sqrt(np.sum(volume[:, :, None] * difference**2)))


AMPLITUDE = np.array([0.05, 0.08, -0.04])
SHIFT = np.array([0.3, 0.7, 1.1])
WAVES = np.array([[0.9, 0.5, 0.4], [0.3, 0.8, -0.6], [0.5, -0.4, 1.0]])


def displacement(x: np.ndarray) -> np.ndarray:
    """u_i = A_i sin(k_i . X + c_i): strains of some percent, volume changes, all shears."""
    return AMPLITUDE * np.sin(x @ WAVES.T + SHIFT)


def stress(x: np.ndarray, law: Law) -> np.ndarray:
    """P of the hyperelastic law (4.8) at theta_0: mu (F - F^-T) + lambda ln J F^-T, at X (..., 3)."""
    f = np.eye(3) + (AMPLITUDE * np.cos(x @ WAVES.T + SHIFT))[..., :, None] * WAVES
    f_inv_t = np.swapaxes(np.linalg.inv(f), -1, -2)
    return law.mu * (f - f_inv_t) + law.lame * np.log(np.linalg.det(f))[..., None, None] * f_inv_t


def body_force(x: np.ndarray, law: Law) -> np.ndarray:
    """-Div P by central differences of order 4."""
    out, h = np.zeros(x.shape), 1e-3
    for j in range(3):
        d = h * np.eye(3)[j]
        slope = 8.0 * (stress(x + d, law) - stress(x - d, law)) - (stress(x + 2 * d, law) - stress(x - 2 * d, law))
        out -= slope[..., :, j] / (12.0 * h)
    return out


def solved(
    mesh: Mesh,
    law: Law,
    f_bar: bool,
    theta: np.ndarray | None = None,
    force_at: Callable[[np.ndarray, Law], np.ndarray] = body_force,
    displacement: Callable[[np.ndarray], np.ndarray] = displacement,
) -> np.ndarray:
    """u (n_np, 3) with the exact displacement on the surface, by Newton with a sparse matrix of the element stiffnesses; `theta`: nodal
    temperatures (n_np,) K, None: those of reference."""
    data = element_data(mesh.nodes, mesh.hexes, f_bar=f_bar)
    theta = np.full(mesh.n_nodes, law.theta_ref) if theta is None else theta
    load = loads(mesh, force_at(integration(mesh)[1], law))
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    held = np.any(np.isclose(mesh.nodes, low) | np.isclose(mesh.nodes, high), axis=1)
    free = np.flatnonzero(np.repeat(~held, 3))
    u = np.where(held[:, None], displacement(mesh.nodes), 0.98 * displacement(mesh.nodes))
    dof = (3 * mesh.hexes[:, :, None] + np.arange(3)).reshape(mesh.n_elements, 24)
    for _ in range(20):
        force, stiffness, _, _ = run_pass(data, u, theta, virgin_state(mesh.n_elements), law, tangent=True)
        residual = np.bincount(dof.ravel(), force.ravel(), minlength=u.size) - load.ravel()
        if np.linalg.norm(residual[free]) < 1e-10 * np.linalg.norm(force):
            return u
        rows, columns = np.repeat(dof, 24, axis=1).ravel(), np.tile(dof, (1, 24)).ravel()
        matrix = coo_matrix((stiffness.ravel(), (rows, columns)), shape=(u.size, u.size)).tocsc()
        u.ravel()[free] -= splu(matrix[free][:, free]).solve(residual[free])
    raise AssertionError("no convergence")


@pytest.mark.parametrize("f_bar", [True, False])
def test_finite_elastic_strain_has_order_2(f_bar: bool, record_property: Told) -> None:
    law = law_of(NOMINAL, plastic=False)
    errors = [error(mesh, solved(mesh, law, f_bar), displacement) for mesh in (distorted(3), distorted(6), distorted(12))]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    record_property(
        f"finite elastic strain, {'F-bar' if f_bar else 'full integration'}, order in the mesh (2)", round(float(orders[-1]), 2)
    )
    assert np.all(orders > 1.95), (errors, orders)
    assert errors[-1] < 5e-3 * np.sqrt(9.0) * np.abs(AMPLITUDE).max()


KAPPA, C0 = 1.0, 2.22
"""Conductivity (mW/(mm K)) for which the block of some mm relaxes within seconds, as a specimen of aluminium does along its length."""
WARM, RATE = 20.0, 0.35


def temperature(x: np.ndarray, t: float) -> np.ndarray:
    """300 K + 20 K cos(pi x/a) cos(pi y/l) cos(pi z/b) e^(-0.35 t): no flux through the surface of the block."""
    return 300.0 + WARM * np.exp(-RATE * t) * np.prod(np.cos(np.pi * x / SIZE), axis=-1)


def heating(x: np.ndarray, t: float) -> np.ndarray:
    """c0 dtheta/dt - kappa Laplace theta of it, mW/mm^3."""
    wave = KAPPA * np.sum((np.pi / SIZE) ** 2)
    return (wave - C0 * RATE) * (temperature(x, t) - 300.0)


def heated(mesh: Mesh, steps: int, scheme: str, end: float = 2.0) -> np.ndarray:
    """theta (n_np,) at `end` s, from the exact field at the start; the heat of a step is the exact integral of its power."""
    body = tension_body(mesh)
    geometry = thermal_geometry(body, np.zeros((mesh.n_nodes, 3)))
    conditions = HeatConditions(KAPPA, C0, {"air": (0.0, 300.0), "clamp": (0.0, 300.0)})
    dt, theta = end / steps, temperature(mesh.nodes, 0.0)
    shape = loads(mesh, heating(integration(mesh)[1], 0.0)[:, :, None])[:, 0]
    for n in range(steps):
        released = shape * (np.exp(-RATE * n * dt) - np.exp(-RATE * (n + 1) * dt)) / RATE
        theta = heat_step(body, geometry, conditions, theta, released, (dt, scheme)).theta
    return theta


def test_temperature_with_a_source_has_order_2_in_the_mesh(record_property: Told) -> None:
    errors = []
    for n in (3, 6, 12):
        mesh = distorted(n)
        errors.append(error(mesh, heated(mesh, 64, "sdirk2")[:, None], lambda x: temperature(x, 2.0)[..., None]))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    record_property("heat with a source, order in the mesh (2)", round(float(orders[-1]), 2))
    assert np.all(orders > 1.95), (errors, orders)


@pytest.mark.parametrize(("scheme", "order"), [("sdirk2", 2.0), ("backward-euler", 1.0)])
def test_temperature_with_a_source_has_the_order_of_its_scheme_in_time(scheme: str, order: float, record_property: Told) -> None:
    """On one mesh, against many small steps."""
    mesh = distorted(3)
    exact = heated(mesh, 512, "sdirk2")
    errors = [np.abs(heated(mesh, steps, scheme) - exact).max() for steps in (4, 8, 16)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    record_property(f"heat with a source, {scheme}, order in the step ({order:g})", round(float(orders[-1]), 2))
    assert np.all(np.abs(orders - order) < 0.25), (errors, orders)


STRETCH = np.array([0.12, 0.2, -0.1])
EXPANSION = 4e-3
"""Thermal expansion, 1/K, so large that 20 K strain the block by 8 %."""


def pulled(x: np.ndarray) -> np.ndarray:
    """u_i = A_i sin(pi X_i / (2 L_i)), each over its own coordinate: F is diagonal, so that no heat flows through the surface."""
    return STRETCH * np.sin(0.5 * np.pi * x / SIZE)


def pulled_f(x: np.ndarray) -> np.ndarray:
    """Diagonal (..., 3) of F."""
    return 1.0 + STRETCH * (0.5 * np.pi / SIZE) * np.cos(0.5 * np.pi * x / SIZE)


def warm_force(t: float) -> Callable[[np.ndarray, Law], np.ndarray]:
    """-Div P of that field with the thermal stress -3 alpha K (theta - theta_0)(1 - ln J)/J F^-T, by central differences of order 4."""

    def stress_of(x: np.ndarray, law: Law) -> np.ndarray:
        f = pulled_f(x)
        j = f.prod(axis=-1)
        thermal = 3.0 * law.alpha_exp * law.bulk * (temperature(x, t) - law.theta_ref) * (1.0 - np.log(j)) / j
        pressure = law.lame * np.log(j) - thermal
        return law.mu * (f - 1.0 / f) + pressure[..., None] / f

    def force(x: np.ndarray, law: Law) -> np.ndarray:
        out, h = np.zeros(x.shape), 1e-3
        for j in range(3):
            d = h * np.eye(3)[j]
            slope = 8.0 * (stress_of(x + d, law) - stress_of(x - d, law)) - (stress_of(x + 2 * d, law) - stress_of(x - 2 * d, law))
            out[..., j] = -slope[..., j] / (12.0 * h)
        return out

    return force


def warm_source(x: np.ndarray) -> np.ndarray:
    """c0 dtheta/dt - Div(kappa J C^-1 Grad theta) at t = 0, mW/mm^3 of reference volume; later it falls as e^(-0.35 t)."""

    def flux(x: np.ndarray, j: int) -> np.ndarray:
        f, wave = pulled_f(x), np.cos(np.pi * x / SIZE)
        slope = -WARM * np.pi / SIZE[j] * np.sin(np.pi * x[..., j] / SIZE[j]) * np.prod(np.delete(wave, j, axis=-1), axis=-1)
        return np.asarray(KAPPA * f.prod(axis=-1) / f[..., j] ** 2 * slope)

    out, h = -C0 * RATE * (temperature(x, 0.0) - 300.0), 1e-3
    for j in range(3):
        d = h * np.eye(3)[j]
        out = out - (8.0 * (flux(x + d, j) - flux(x - d, j)) - (flux(x + 2 * d, j) - flux(x - 2 * d, j))) / (12.0 * h)
    return np.asarray(out)


def coupled(mesh: Mesh, steps: int, end: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """u (n_np, 3) and theta (n_np,) at `end` s: conduction through the deformed block, whose thermal stress the temperature makes; each
    step takes the motion at its start."""
    law = law_of(NOMINAL.replace(alpha_exp=EXPANSION, theta_ref=300.0, theta_clamp=300.0, nu=0.3), plastic=False)
    body, dt, theta = tension_body(mesh), end / steps, temperature(mesh.nodes, 0.0)
    conditions = HeatConditions(KAPPA, C0, {"air": (0.0, 300.0), "clamp": (0.0, 300.0)})
    shape = loads(mesh, warm_source(integration(mesh)[1])[:, :, None])[:, 0]
    for n in range(steps):
        u = solved(mesh, law, True, theta, warm_force(n * dt), pulled)
        released = shape * (np.exp(-RATE * n * dt) - np.exp(-RATE * (n + 1) * dt)) / RATE
        theta = heat_step(body, thermal_geometry(body, u), conditions, theta, released, (dt, "sdirk2")).theta
    return solved(mesh, law, True, theta, warm_force(end), pulled), theta


def test_heat_and_motion_together_have_order_2(record_property: Told) -> None:
    """Each field with the other's error in it."""
    errors = []
    for n in (2, 4, 8):
        mesh = distorted(n)
        u, theta = coupled(mesh, 4)
        errors.append([error(mesh, u, pulled), error(mesh, theta[:, None], lambda x: temperature(x, 2.0)[..., None])])
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    record_property("coupled manufactured solution, orders of u and theta in the mesh (2)", [round(float(v), 2) for v in orders[-1]])
    assert np.all(orders[-1] > 1.8), (errors, orders)
