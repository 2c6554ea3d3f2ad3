"""Small blocks and bars for tests, a dense Newton that knows nothing of the solver under test, and reference tables."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from thermofit.body.element.hex8 import ElementData, element_data, element_pass
from thermofit.body.mesh.mesh import Mesh, boundary_facets, structured_hexes
from thermofit.body.solve.march import Loading
from thermofit.body.solve.newton import virgin_state
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.law.page import Law, law_of

NOMINAL = Parameters.of(
    {
        **{"E": 68396.66, "nu": 0.34, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "H_lin": 0.0},
        **{"F": 0.35, "G": 0.5, "H": 0.5, "L": 1.5, "M": 1.5, "N": 1.5, "alpha_exp": 20.21e-6, "kappa": 133.45, "c0": 2.22, "beta": 0.79},
        **{"alpha_air": 14.72, "alpha_clamp": 236.3, "theta_air": 297.4, "theta_clamp": 296.7, "theta_ref": 296.7},
    }
)
MISES = NOMINAL.replace(F=0.5)
ADIABATIC = NOMINAL.replace(alpha_air=0.0, alpha_clamp=0.0)
SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
LOADING = Loading(np.array([0.0, 1.0, 25.0, 35.0, 37.0, 60.0]), np.array([0.0, 0.0, 5700.0, 5700.0, 0.0, 0.0]))
"""Pulled, held, unloaded, cooled: N over s."""
"""The specimen of the reference solution."""


def area_vectors(nodes: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Outward area vectors of plane quadrilaterals, half the cross product of the diagonals."""
    x = nodes[facets]
    return 0.5 * np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])


def bar_mesh(
    counts: tuple[int, int, int],
    size: tuple[float, float, float],
    *,
    air: Iterable[str] = (),
    clamp: Iterable[str] = (),
    distortion: float = 0.0,
) -> Mesh:
    """Block [0, a] x [0, l] x [0, b] with the node sets of a tension test; `air` and `clamp` name its faces x0, x1, y0, y1, z0, z1.

    `distortion` moves interior nodes at random by that share of an element.
    """
    n_x, n_y, n_z = counts
    y, x, z = np.meshgrid(*(np.linspace(0.0, size[i], counts[i] + 1) for i in (1, 0, 2)), indexing="ij")
    nodes = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    planes = {f"{axis}{end}": np.isclose(nodes[:, i], end * size[i]) for i, axis in enumerate("xyz") for end in (0, 1)}
    inner = ~np.any(list(planes.values()), axis=0)
    shift = np.random.default_rng(3).uniform(-1.0, 1.0, nodes.shape) * distortion * np.array(size) / np.array(counts)
    nodes[inner] += shift[inner]
    hexes = structured_hexes(n_x, n_y, n_z)
    outer = boundary_facets(hexes)

    def facets(names: Iterable[str]) -> np.ndarray:
        chosen = [outer[planes[name][outer].all(axis=1)] for name in names]
        return np.concatenate(chosen) if chosen else np.empty((0, 4), dtype=np.int64)

    sets = {"x0": "x0", "z0": "z0", "bottom": "y0", "top": "y1"}
    return Mesh(
        nodes=nodes,
        hexes=hexes,
        facets={"air": facets(air), "clamp": facets(clamp)},
        node_sets={name: np.flatnonzero(planes[plane]) for name, plane in sets.items()},
    )


def run_pass(
    data: ElementData, u: np.ndarray, theta: np.ndarray, state: np.ndarray, law: Law, *, tangent: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One element pass that must succeed: forces (n_el, 24), stiffness (n_el, 24, 24), new state, J."""
    n_el = len(data.hexes)
    force, stiffness = np.full((n_el, 24), np.nan), np.full((n_el, 24, 24), np.nan)
    new, dilatation = np.full_like(state, np.nan), np.full((n_el, 8), np.nan)
    assert element_pass(data, u, theta, state, law, tangent, force, stiffness, new, dilatation) == 0
    return force, stiffness, new, dilatation


def dense_equilibrium(
    data: ElementData, u: np.ndarray, held: np.ndarray, law: Law, state: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Equilibrium by a dense Newton: dofs of `held` (n_np, 3) keep their value in u. Returns u, nodal forces (n_np, 3), new state."""
    n, free = u.size, ~held.ravel()
    dof = (3 * data.hexes[:, :, None] + np.arange(3)).reshape(len(data.hexes), 24)
    state = virgin_state(len(data.hexes)) if state is None else state
    theta = np.full(len(u), law.theta_ref)
    u = u.copy()
    for _ in range(40):
        force, stiffness, new, _ = run_pass(data, u, theta, state, law, tangent=True)
        nodal = np.bincount(dof.ravel(), force.ravel(), minlength=n)
        if np.linalg.norm(nodal[free]) < 1e-11 * np.linalg.norm(force):
            return u, nodal.reshape(-1, 3), new
        k = np.zeros((n, n))
        np.add.at(k, (dof[:, :, None], dof[:, None, :]), stiffness)
        step = np.zeros(n)
        step[free] = -np.linalg.solve(k[np.ix_(free, free)], nodal[free])
        u += step.reshape(-1, 3)
    raise AssertionError("the dense Newton did not converge")


def patch_error(mesh: Mesh) -> float:
    """Largest deviation of free interior nodes from a homogeneous deformation that the boundary follows, relative to it."""
    gradient = 1e-3 * np.array([[0.4, 0.2, -0.1], [-0.3, 1.0, 0.25], [0.15, -0.2, -0.3]])
    exact = mesh.nodes @ gradient.T
    held = np.zeros((mesh.n_nodes, 3), dtype=bool)
    held[np.unique(boundary_facets(mesh.hexes))] = True
    assert (~held).any(), "no interior node: the patch test would be vacuous"
    start = np.where(held, exact, 0.0)
    law = law_of(MISES.replace(M_y0=5000.0, M_yinf=5001.0), 2)
    u, _, _ = dense_equilibrium(element_data(mesh.nodes, mesh.hexes, f_bar=True), start, held, law)
    return float(np.abs(u - exact).max() / np.abs(exact).max())
