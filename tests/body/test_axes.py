"""Material axes: Hill's surface turned in the sheet."""

from __future__ import annotations

import numpy as np
import pytest
from necked_bar import AREA, bar, necked
from scalar_update import local_update, piola_stress, point_work
from scipy.spatial.transform import Rotation
from small_bodies import ADIABATIC, bar_mesh

from thermofit.body.body import Body, tension_body
from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.body.solve.newton import axes_about_z, virgin_state
from thermofit.core.errors import StudyError
from thermofit.law.page import Law, hill, in_model_axes, law_of
from thermofit.law.tensor import COLUMN, ROW
from thermofit.point.state import ELASTIC, PLASTIC

SHEET = ADIABATIC.replace(F=0.31, G=0.62, H=0.45, L=1.2, M=1.9, N=1.45)


def pulled(body: Body, stress: float, parameters: object = SHEET, **settings: float) -> History:
    loading = Loading(np.array([0.0, 1.0]), np.array([0.0, stress * AREA * body.symmetry]))
    return march(body, parameters, loading, np.linspace(0.0, 1.0, 13), MarchSettings(**settings))  # type: ignore[arg-type]


@pytest.mark.parametrize("angle", [90.0, -90.0, 270.0])
def test_a_quarter_turn_exchanges_the_hill_parameters(angle: float) -> None:
    """Necked bar, all stress components: the turned sheet is the sheet with G and H, M and N exchanged."""
    turned = pulled(necked(), 150.0, material_angle=angle)
    exchanged = pulled(necked(), 150.0, SHEET.replace(G=0.45, H=0.62, M=1.45, N=1.9))
    assert turned.u == pytest.approx(exchanged.u, abs=1e-9)
    assert turned.theta == pytest.approx(exchanged.theta, abs=1e-6)
    assert turned.largest_multiplier[-1] > 0.01
    straight = pulled(necked(), 150.0)
    assert np.abs(turned.u - straight.u).max() > 1e-3
    assert in_model_axes(SHEET, angle) == SHEET.replace(G=0.45, H=0.62, M=1.45, N=1.9)


def test_half_a_turn_changes_nothing() -> None:
    assert np.array_equal(pulled(bar(), 150.0, material_angle=180.0).u, pulled(bar(), 150.0).u)
    assert in_model_axes(SHEET, 180.0) is SHEET


def hill_of_fourth_order(law: Law, q: np.ndarray) -> np.ndarray:
    """G_ijkl of (4.19) in model axes, for material axes in the columns of q: G'_ijkl = q_ia q_jb q_kc q_ld G_abcd."""
    g = np.zeros((3, 3, 3, 3))
    for n in range(6):
        one = tuple(1.0 if m == n else 0.0 for m in range(6))
        image = hill(one, law)
        for m, (i, j) in enumerate(zip(ROW, COLUMN, strict=True)):
            k, m2 = ROW[n], COLUMN[n]
            value = image[m] * (1.0 if k == m2 else 0.5)
            for a, b in {(i, j), (j, i)}:
                for c, d in {(k, m2), (m2, k)}:
                    g[a, b, c, d] = value
    return np.einsum("ia,jb,kc,ld,abcd->ijkl", q, q, q, q, g)


def answer(f: np.ndarray, law: Law, state: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    work, new, p = point_work(), np.empty(11), np.empty((3, 3))
    status = local_update(np.ascontiguousarray(f), 310.0, state, law, work, new)
    piola_stress(np.ascontiguousarray(f), law, work, p)
    return status, new, p


@pytest.mark.parametrize("seed", range(4))
def test_any_axes_turn_the_fourth_order_hill_tensor(seed: int) -> None:
    """Yield limit and direction of flow, in model axes, are those of the turned Hill tensor."""
    law, q = law_of(SHEET), Rotation.random(random_state=seed).as_matrix()
    g = hill_of_fourth_order(law, q)
    start = virgin_state(1, q)[0, 0]
    f = np.eye(3) + 0.03 * np.random.default_rng(seed).uniform(-1.0, 1.0, (3, 3))
    f /= np.linalg.det(f) ** (1.0 / 3.0)
    status, new, _ = answer(f, law, start)
    assert status == PLASTIC
    fp_inv = new[:9].reshape(3, 3) @ q.T  # F_p^-1 without the turn: from the sheet's plastic placement to the model
    c = fp_inv.T @ f.T @ f @ fp_inv
    gradient = np.einsum("ijkl,kl->ij", g, c)
    norm = np.sqrt(np.sum(c * gradient))
    assert law.mu * norm == pytest.approx(law.M_y0 + law.H_exp * (law.M_yinf - law.M_y0) * new[9], rel=1e-9)
    values, vectors = np.linalg.eigh(new[10] * gradient / norm)
    exponential = vectors @ np.diag(np.exp(-values)) @ vectors.T
    assert fp_inv == pytest.approx(exponential, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_turned_axes_are_a_turned_reference_placement(seed: int) -> None:
    """P(F; axes Q) = P(F Q; axes 1) Q^T over several plastic increments, and objectivity P(R F) = R P(F)."""
    law, random = law_of(SHEET), np.random.default_rng(seed)
    q, r = (Rotation.random(random_state=seed + n).as_matrix() for n in (0, 50))
    turned, straight, moved = virgin_state(1, q)[0, 0], virgin_state(1)[0, 0], virgin_state(1, q)[0, 0]
    f = np.eye(3)
    for _ in range(4):
        f = (np.eye(3) + 0.02 * random.uniform(-1.0, 1.0, (3, 3))) @ f
        f /= np.linalg.det(f) ** (0.9 / 3.0)
        (status, turned, p), (_, straight, p0), (_, moved, p1) = (
            answer(f, law, turned),
            answer(f @ q, law, straight),
            answer(r @ f, law, moved),
        )
        assert status == PLASTIC
        assert p == pytest.approx(p0 @ q.T, abs=1e-7) and p1 == pytest.approx(r @ p, abs=1e-7)
        assert turned[9:] == pytest.approx(straight[9:], abs=1e-12) and moved == pytest.approx(turned, abs=1e-11)
    assert turned[10] > 0.02


def test_axes_turn_about_z() -> None:
    """Columns are the axes; elasticity does not feel them."""
    assert axes_about_z(30.0)[:, 0] == pytest.approx([np.sqrt(0.75), 0.5, 0.0])
    for angle in (0.0, 90.0, 180.0, 270.0, -90.0):
        assert axes_about_z(angle) == pytest.approx(Rotation.from_euler("z", angle, degrees=True).as_matrix(), abs=1e-15)
        assert np.array_equal(axes_about_z(angle) @ axes_about_z(angle).T, np.eye(3))
    law, f = law_of(SHEET), np.diag([0.9995, 1.001, 0.9995])
    for axes in (np.eye(3), axes_about_z(37.0)):
        status, _, p = answer(f, law, virgin_state(1, axes)[0, 0])
        assert status == ELASTIC and p == pytest.approx(answer(f, law, virgin_state(1)[0, 0])[2], abs=1e-9)


def whole_bar() -> Body:
    """A bar without the symmetry plane x = 0: one edge of its lower end is held in x."""
    mesh = bar_mesh((2, 4, 1), (4.0, 30.0, 1.0), air=("x1",), clamp=("y0", "y1"), distortion=0.1)
    corner = mesh.node_sets["x0"][np.isclose(mesh.nodes[mesh.node_sets["x0"], 1], 0.0)]
    mesh.node_sets["x0"] = corner  # type: ignore[index]
    return tension_body(mesh, symmetry=1.0)


@pytest.mark.parametrize("angle", [30.0, 45.0, 60.0])
def test_yield_limit_of_a_sheet_cut_at_an_angle(angle: float) -> None:
    """Tension at an angle a to axis 2: M_22 = c^2, M_11 = s^2, M_12 = s c times the stress (4.19)."""
    c2, s2 = np.cos(np.radians(angle)) ** 2, np.sin(np.radians(angle)) ** 2
    v = SHEET.values
    norm = np.sqrt(v["F"] * (s2 - c2) ** 2 + v["G"] * s2**2 + v["H"] * c2**2 + 2.0 * v["L"] * s2 * c2)
    limit = v["M_y0"] / norm
    limit *= 1.0 - limit / v["E"]  # nominal stress: the Mandel stress is the elastic stretch times as large
    cold = SHEET.replace(alpha_exp=0.0)
    area = 4.0
    for factor, plastic in ((0.9995, False), (1.0005, True)):
        loading = Loading(np.array([0.0, 1.0]), np.array([0.0, factor * limit * area]))
        history = march(whole_bar(), cold, loading, np.array([0.0, 0.5, 1.0]), MarchSettings(material_angle=angle))
        assert (history.plastic_points[-1] == 8 * 8) == plastic and (history.plastic_points[-1] == 0) != plastic


def test_a_symmetric_body_and_a_study_take_quarter_turns_only() -> None:
    with pytest.raises(StudyError, match="angle of 45 degrees"):
        pulled(bar(), 10.0, material_angle=45.0)
    with pytest.raises(StudyError, match="multiples of 90"):
        in_model_axes(SHEET, 30.0)
    for wrong in (np.diag([1.0, 1.0, -1.0]), 1.1 * np.eye(3), np.eye(2)):
        with pytest.raises(StudyError, match="no rotation"):
            virgin_state(1, wrong)
