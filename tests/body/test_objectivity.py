"""A rotation superposed on a whole run turns the displacements and the forces and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from published_surfaces import TWISTED
from scipy.spatial.transform import Rotation
from small_bodies import NOMINAL, bar_mesh, dense_equilibrium

from thermofit.body.body import tension_body, thermal_geometry
from thermofit.body.element.hex8 import element_data
from thermofit.body.solve.newton import axes_about_z, virgin_state
from thermofit.core.slots import Slots
from thermofit.law.page import law_of
from thermofit.point.state import LAMBDA

STRETCH = np.array([[-0.012, 0.006, 0.002], [0.004, 0.024, -0.005], [0.006, 0.002, -0.011]])
"""Displacement gradient of one step."""


STRUCTURE = {
    **{"backstress_first.C": 4000.0, "backstress_first.gamma": 60.0, "backstress_second.C": 800.0},
    **{"elastic_degradation.amount": 0.15, "tension_compression.difference": 0.06},
}
"""Effects that change the local update itself."""


CASES = [(True, {}, "hill"), (False, {}, "hill"), (True, STRUCTURE, "hill"), (True, {**STRUCTURE, **TWISTED}, "yld2004")]


@pytest.mark.parametrize(("f_bar", "changes", "yields"), CASES, ids=["f-bar", "full", "structure", "yld2004"])
def test_a_run_seen_from_a_turning_frame(f_bar: bool, changes: dict[str, float], yields: str) -> None:
    """Six equilibria of a distorted block of a sheet cut at 30 degrees, loaded and reversed; in the second run its surface turns by another
    20 degrees in every step. Equal plastic states, x and nodal forces turned."""
    mesh, law = bar_mesh((2, 3, 2), (2.0, 3.0, 1.5), distortion=0.2), law_of(NOMINAL.replace(**changes), Slots(2, yields))
    data = element_data(mesh.nodes, mesh.hexes, f_bar=f_bar)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    surface = np.any(np.isclose(mesh.nodes, low) | np.isclose(mesh.nodes, high), axis=1)
    held = np.repeat(surface[:, None], 3, axis=1)
    bulge = 0.02 * np.sin(3.0 * mesh.nodes[:, [1, 2, 0]])
    still = turning = virgin_state(mesh.n_elements, axes_about_z(30.0), structure=bool(changes))
    u = moved = np.zeros_like(mesh.nodes)
    for n, amount in enumerate((1.0, 2.0, 3.0, 2.0, 1.0, 1.5), start=1):
        q = Rotation.from_rotvec(np.radians(20.0 * n) * np.array([0.6, -0.64, 0.48])).as_matrix()
        before = Rotation.from_rotvec(np.radians(20.0 * (n - 1)) * np.array([0.6, -0.64, 0.48])).as_matrix()
        asked = amount * (mesh.nodes @ STRETCH.T + bulge)
        turned = (mesh.nodes + asked) @ q.T - mesh.nodes
        start = (mesh.nodes + moved) @ (q @ before.T).T - mesh.nodes
        u, force, still = dense_equilibrium(data, np.where(held, asked, u), held, law, still)
        moved, turned_force, turning = dense_equilibrium(data, np.where(held, turned, start), held, law, turning)
        assert mesh.nodes + moved == pytest.approx((mesh.nodes + u) @ q.T, abs=1e-10)
        assert turned_force == pytest.approx(force @ q.T, abs=1e-8 * np.abs(force).max())
        assert turning == pytest.approx(still, abs=1e-10)
    assert still[:, :, LAMBDA].min() > 0.05


def test_heat_flow_in_a_turned_body() -> None:
    """Conduction and film areas do not depend on the frame."""
    mesh = bar_mesh((2, 3, 2), (2.0, 3.0, 1.5), air=("x1", "z1"), clamp=("y0",), distortion=0.2)
    body, q = tension_body(mesh), Rotation.from_rotvec([0.4, -1.0, 0.3]).as_matrix()
    u = mesh.nodes @ (4.0 * STRETCH).T
    plain, turned = thermal_geometry(body, u), thermal_geometry(body, (mesh.nodes + u) @ q.T - mesh.nodes)
    assert turned.conduction == pytest.approx(plain.conduction, abs=1e-12)
    for name in ("air", "clamp"):
        assert turned.film[name] == pytest.approx(plain.film[name], abs=1e-12) and plain.film_area[name].sum() > 1.0
