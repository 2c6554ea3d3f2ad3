"""The hex8: patch tests, rotation, stiffness by its order, no volumetric locking."""

from __future__ import annotations

import numpy as np
import pytest
from numba import config, get_num_threads
from scalar_update import local_tangent, local_update, piola_stress, point_work
from scipy.spatial.transform import Rotation
from small_bodies import MISES, NOMINAL, bar_mesh, dense_equilibrium, run_pass

from thermofit.body.element.hex8 import GAUSS_POINTS, ElementData, element_data, element_pass, reference_gradients, shape_functions
from thermofit.body.mesh.mesh import Mesh
from thermofit.body.solve.newton import virgin_state
from thermofit.core.jit import set_threads
from thermofit.law.page import Law, law_of
from thermofit.point.state import LAMBDA

ELASTIC_GRADIENT = np.array([[-0.0004, 0.0003, 0.0002], [0.0001, 0.0009, -0.0002], [0.0003, 0.0, -0.0003]])
PLASTIC_GRADIENT = np.array([[-0.03, 0.02, 0.01], [0.015, 0.06, -0.02], [0.02, 0.005, -0.028]])


def block(counts: tuple[int, int, int] = (3, 3, 3)) -> Mesh:
    return bar_mesh(counts, (2.0, 3.0, 1.5), distortion=0.25)


def boundary(mesh: Mesh) -> np.ndarray:
    """Nodes on the surface of a block."""
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    return np.any(np.isclose(mesh.nodes, low) | np.isclose(mesh.nodes, high), axis=1)


def test_shape_functions() -> None:
    """Partition of unity, exact linear fields, and the derivative by differences."""
    xi = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 3))
    n, dn = shape_functions(xi)
    assert n.sum(axis=1) == pytest.approx(np.ones(5)) and dn.sum(axis=1) == pytest.approx(np.zeros((5, 3)), abs=1e-15)
    for i in range(3):
        h = 1e-6 * np.eye(3)[i]
        assert (shape_functions(xi + h)[0] - shape_functions(xi - h)[0]) / 2e-6 == pytest.approx(dn[:, :, i], abs=1e-9)
    assert np.abs(GAUSS_POINTS) == pytest.approx(np.full((8, 3), 1.0 / np.sqrt(3.0)))


def test_reference_gradients_differentiate_linear_fields_exactly() -> None:
    mesh = block()
    gradient, volume = reference_gradients(mesh.nodes, mesh.hexes)
    slope = np.array([0.3, -1.2, 0.7])
    found = np.einsum("egai,ea->egi", gradient, (mesh.nodes @ slope + 4.0)[mesh.hexes])
    assert found == pytest.approx(np.broadcast_to(slope, found.shape), abs=1e-13)
    assert volume.sum() == pytest.approx(9.0, rel=1e-13)


@pytest.mark.parametrize("f_bar", [True, False])
@pytest.mark.parametrize(("gradient", "plastic"), [(ELASTIC_GRADIENT, False), (PLASTIC_GRADIENT, True)], ids=["elastic", "plastic"])
def test_patch(gradient: np.ndarray, plastic: bool, f_bar: bool) -> None:
    """Affine displacement of the surface of a distorted mesh: interior nodes find it, all points carry the stress of one point."""
    mesh, law = block(), law_of(NOMINAL)
    data = element_data(mesh.nodes, mesh.hexes, f_bar=f_bar)
    affine = mesh.nodes @ gradient.T
    held = boundary(mesh)
    start = np.where(held[:, None], affine, affine + 1e-3)
    u, nodal, state = dense_equilibrium(data, start, np.repeat(held[:, None], 3, axis=1), law)
    assert u == pytest.approx(affine, abs=1e-10)
    f, one, p, work = np.eye(3) + gradient, np.empty(11), np.empty((3, 3)), point_work()
    assert local_update(f, law.theta_ref, virgin_state(1)[0, 0], law, work, one) == int(plastic)
    piola_stress(f, law, work, p)
    assert state == pytest.approx(np.broadcast_to(one, state.shape), abs=1e-10)
    for axis in range(3):
        face = np.isclose(mesh.nodes[:, axis], mesh.nodes[:, axis].max())
        area = 9.0 / mesh.nodes[:, axis].max()
        assert nodal[face].sum(axis=0) == pytest.approx(p[:, axis] * area, rel=1e-9, abs=1e-9 * np.abs(p).max())


@pytest.mark.parametrize("f_bar", [True, False])
def test_rigid_rotation_gives_no_force(f_bar: bool) -> None:
    mesh, law = block(), law_of(NOMINAL)
    q = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
    u = mesh.nodes @ (q - np.eye(3)).T + np.array([3.0, -2.0, 5.0])
    data = element_data(mesh.nodes, mesh.hexes, f_bar=f_bar)
    force, _, state, dilatation = run_pass(data, u, np.full(mesh.n_nodes, law.theta_ref), virgin_state(27), law)
    assert np.abs(force).max() < 1e-13 * 68e3
    assert dilatation == pytest.approx(np.ones((27, 8)), abs=1e-13)
    assert np.array_equal(state, virgin_state(27))


@pytest.mark.parametrize("f_bar", [True, False])
def test_forces_of_an_element_balance(f_bar: bool) -> None:
    """Sum of forces and of moments about the origin vanish in any deformed state."""
    mesh, law = block(), law_of(NOMINAL)
    u = mesh.nodes @ PLASTIC_GRADIENT.T + 0.01 * np.random.default_rng(1).standard_normal(mesh.nodes.shape)
    data = element_data(mesh.nodes, mesh.hexes, f_bar=f_bar)
    force = run_pass(data, u, np.full(mesh.n_nodes, 300.0), virgin_state(27), law)[0].reshape(27, 8, 3)
    x = (mesh.nodes + u)[mesh.hexes]
    assert force.sum(axis=1) == pytest.approx(np.zeros((27, 3)), abs=1e-11 * np.abs(force).max())
    assert np.cross(x, force).sum(axis=1) == pytest.approx(np.zeros((27, 3)), abs=1e-10 * np.abs(force).max())


def one_element(f_bar: bool, law: Law) -> tuple[ElementData, np.ndarray, np.ndarray]:
    """A distorted element with different plastic states in its points, and its next displacement."""
    mesh = bar_mesh((1, 1, 1), (2.0, 3.0, 1.5))
    random = np.random.default_rng(7)
    nodes = mesh.nodes + 0.2 * random.uniform(-1.0, 1.0, mesh.nodes.shape)
    data = element_data(nodes, mesh.hexes, f_bar=f_bar)
    u = nodes @ PLASTIC_GRADIENT.T + 0.03 * random.uniform(-1.0, 1.0, nodes.shape)
    state = run_pass(data, u, np.full(8, 300.0), virgin_state(1), law)[2]
    return data, 1.5 * u + 0.03 * random.uniform(-1.0, 1.0, nodes.shape), state


@pytest.mark.parametrize("f_bar", [True, False])
@pytest.mark.parametrize("plastic", [True, False])
def test_stiffness_to_second_order(plastic: bool, f_bar: bool) -> None:
    """force(u + h du) - force(u) - h K du falls with h^2; all points plastic (von Mises, where the tangent is symmetric) or elastic."""
    data, u, state = one_element(f_bar, law_of(MISES))
    law = law_of(MISES, plastic=plastic)
    theta = np.linspace(295.0, 305.0, 8)
    force, stiffness, new, _ = run_pass(data, u, theta, state, law, tangent=True)
    assert np.all((new[:, :, LAMBDA] > state[:, :, LAMBDA]) == plastic)
    direction = np.random.default_rng(2).uniform(-1.0, 1.0, (8, 3))
    slope = stiffness[0] @ direction[data.hexes[0]].ravel()
    steps = np.array([1e-3, 3e-4, 1e-4])
    errors = [np.abs(run_pass(data, u + h * direction, theta, state, law)[0][0] - force[0] - h * slope).max() for h in steps]
    orders = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert np.all(np.abs(orders - 2.0) < 0.1), orders
    assert np.array_equal(stiffness[0], stiffness[0].T)


@pytest.mark.parametrize("f_bar", [True, False])
def test_stiffness_of_hill_plasticity_is_its_symmetric_neighbour(f_bar: bool) -> None:
    """Across the axes of Hill's surface the exact tangent is asymmetric by some 1e-5; the stiffness is within that of it."""
    law = law_of(NOMINAL)
    data, u, state = one_element(f_bar, law)
    theta = np.full(8, 300.0)
    stiffness = run_pass(data, u, theta, state, law, tangent=True)[1][0]
    h = 1e-5
    for direction in np.random.default_rng(2).uniform(-1.0, 1.0, (3, 8, 3)):
        difference = (run_pass(data, u + h * direction, theta, state, law)[0] - run_pass(data, u - h * direction, theta, state, law)[0])[0]
        slope = stiffness @ direction[data.hexes[0]].ravel()
        assert np.abs(difference / (2 * h) - slope).max() < 3e-5 * np.abs(slope).max()


def test_force_of_f_bar_is_that_of_its_virtual_work() -> None:
    """f . w = d/dh sum P(F_bar) : F_bar(u + h w) V at fixed P, with F_bar = (J_bar / J)^(1/3) F written out in numpy."""
    law = law_of(NOMINAL)
    data, u, state = one_element(True, law)
    theta = np.full(8, 301.0)

    def f_bar(v: np.ndarray) -> np.ndarray:
        f = np.eye(3) + np.einsum("ai,gaj->gij", v[data.hexes[0]], data.gradient[0])
        j = np.linalg.det(f)
        mean = np.sum(j * data.volume[0]) / data.volume[0].sum()
        return f * np.cbrt(mean / j)[:, None, None]

    work, p = point_work(), np.empty((8, 3, 3))
    for q, f in enumerate(f_bar(u)):
        assert local_update(f, 301.0, state[0, q], law, work, np.empty(11)) == 1
        piola_stress(f, law, work, p[q])
    force = run_pass(data, u, theta, state, law)[0][0]
    for w in np.random.default_rng(4).uniform(-1.0, 1.0, (3, 8, 3)):
        change = (f_bar(u + 1e-6 * w) - f_bar(u - 1e-6 * w)) / 2e-6
        expected = np.einsum("gij,gij,g", p, change, data.volume[0])
        assert force @ w[data.hexes[0]].ravel() == pytest.approx(expected, rel=1e-7)


def element_of_points(
    data: ElementData, u: np.ndarray, theta: np.ndarray, state_n: np.ndarray, law: Law
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force (24,), upper triangle of the stiffness (24, 24) and state of one element, by `scalar_update` and the formulas of F-bar:

    f_a = sum_q w [tau g_a + p (g_bar_a - g_a)],
    K = sum_q w [G_a A G_b + p g_b (x) g_a] + h (x) m + m (x) h + P [sum_q J w (g_a (x) g_b - g_b (x) g_a) / (V J_bar) - g_bar (x) g_bar],
    h = (g_bar - g)/3, m = w [F_bar : A G + tau g + (F_bar : A : F_bar + 3 p) h / 2].
    """
    gradient, weight = data.gradient[0], data.volume[0]
    f = np.eye(3) + np.einsum("ai,qaj->qij", u[data.hexes[0]], gradient)
    g, j = np.einsum("qji,qaj->qai", np.linalg.inv(f), gradient), np.linalg.det(f)
    mean = np.einsum("q,qai->ai", j * weight, g) / np.sum(j * weight)
    scale = np.cbrt(np.sum(j * weight) / weight.sum() / j) if data.f_bar else np.ones(8)
    force, k, power = np.zeros((8, 3)), np.zeros((8, 3, 8, 3)), 0.0
    state, work, p, a = np.empty((8, 11)), point_work(), np.empty((3, 3)), np.empty((9, 9))
    for q in range(8):
        f_bar, big_g, w = scale[q] * f[q], scale[q] * gradient[q], weight[q]
        status = local_update(f_bar, data.shape[q] @ theta[data.hexes[0]], state_n[q], law, work, state[q])
        piola_stress(f_bar, law, work, p)
        local_tangent(status, law, work, a)
        tau, tangent = p @ f_bar.T, a.reshape(3, 3, 3, 3)
        pressure = data.f_bar * np.trace(tau) / 3.0
        power += w * pressure
        force += w * (g[q] @ tau + pressure * (mean - g[q]))
        k += w * (np.einsum("aj,ijkl,bl->aibk", big_g, tangent, big_g) + pressure * np.einsum("bi,ak->aibk", g[q], g[q]))
        h = data.f_bar * (mean - g[q]) / 3.0
        fa = np.einsum("ij,ijkl->kl", f_bar, tangent)
        m = w * (big_g @ fa.T + g[q] @ tau + 0.5 * (np.sum(fa * f_bar) + 3.0 * pressure) * h)
        k += np.einsum("ai,bk->aibk", h, m) + np.einsum("ai,bk->aibk", m, h)
    dyads = np.einsum("q,qai,qbk->aibk", j * weight, g, g) / np.sum(j * weight)
    k += power * (dyads - dyads.transpose(0, 3, 2, 1) - np.einsum("ai,bk->aibk", mean, mean))
    return force.ravel(), np.triu(k.reshape(24, 24)), state


@pytest.mark.parametrize("f_bar", [True, False])
@pytest.mark.parametrize("model", [1, 2])
@pytest.mark.parametrize("size", [3e-4, 1.7e-3, 0.01, 0.2], ids=["elastic", "mixed", "plastic", "large"])
def test_element_is_the_sum_of_its_points(size: float, model: int, f_bar: bool) -> None:
    """Lanes against the point and the formulas of F-bar, Hill's surface, different temperatures; the points' states from a first step."""
    law = law_of(NOMINAL.replace(F=0.31, G=0.62, H=0.45, L=1.2, M=1.9, N=1.45, H_lin=20.0), model)
    random = np.random.default_rng(3)
    mesh = bar_mesh((1, 1, 1), (2.0, 3.0, 1.5))
    nodes = mesh.nodes + 0.2 * random.uniform(-1.0, 1.0, mesh.nodes.shape)
    data, theta = element_data(nodes, mesh.hexes, f_bar=f_bar), np.linspace(270.0, 380.0, 8)
    isochoric = np.array([[-0.5, 0.3, 0.2], [0.1, 1.0, -0.2], [0.3, 0.1, -0.5]])
    state = virgin_state(1)
    kinds = []
    for step in (1.0, 1.5):
        u = step * size * (nodes @ isochoric.T + 0.2 * random.uniform(-1.0, 1.0, nodes.shape))
        force, stiffness, new, dilatation = run_pass(data, u, theta, state, law, tangent=True)
        expected_force, expected_k, expected_state = element_of_points(data, u, theta, state[0], law)
        assert force[0] == pytest.approx(expected_force, abs=1e-12 * np.abs(force).max() + 1e-15 * law.mu)
        assert np.triu(stiffness[0]) == pytest.approx(expected_k, abs=2e-13 * np.abs(stiffness).max())
        assert np.array_equal(stiffness[0], stiffness[0].T)
        assert new[0] == pytest.approx(expected_state, abs=1e-13)
        f = np.eye(3) + np.einsum("ai,gaj->gij", u[data.hexes[0]], data.gradient[0])
        j, w = np.linalg.det(f), data.volume[0]
        assert dilatation[0] == pytest.approx(np.full(8, np.sum(j * w) / w.sum()) if f_bar else j, rel=1e-14)
        kinds.append(np.mean(new[0, :, LAMBDA] > state[0, :, LAMBDA]))
        state = new
    assert kinds == {3e-4: [0.0, 0.0], 0.01: [1.0, 1.0], 0.2: [1.0, 1.0]}.get(size, kinds)
    assert size != 1.7e-3 or 0.0 < min(kinds) < 1.0


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    mesh, law = block((3, 5, 3)), law_of(NOMINAL)
    u = mesh.nodes @ PLASTIC_GRADIENT.T + 0.01 * np.random.default_rng(1).standard_normal(mesh.nodes.shape)
    data, theta = element_data(mesh.nodes, mesh.hexes), np.full(mesh.n_nodes, 300.0)
    before = get_num_threads()
    try:
        answers = []
        for n in (1, config.NUMBA_NUM_THREADS):
            set_threads(n)
            answers.append(run_pass(data, u, theta, virgin_state(45), law, tangent=True))
    finally:
        set_threads(before)
    assert all(np.array_equal(one, many) for one, many in zip(*answers, strict=True))


def indentation(n: int, f_bar: bool) -> float:
    """Force in N on a rigid rough punch over half of a block under plane strain, far into plastic flow."""
    mesh = bar_mesh((n, n, 1), (1.0, 1.0, 1.0 / n))
    x, y, _ = mesh.nodes.T
    held = np.zeros(mesh.nodes.shape, dtype=bool)
    held[:, 2] = True
    held[np.isclose(x, 0.0) | np.isclose(x, 1.0), 0] = True
    held[np.isclose(y, 0.0), 1] = True
    punch = np.isclose(y, 1.0) & (x < 0.5 + 1e-9)
    held[punch] = True
    data, law = element_data(mesh.nodes, mesh.hexes, f_bar=f_bar), law_of(MISES.replace(M_yinf=140.0))
    u, state = np.zeros(mesh.nodes.shape), virgin_state(mesh.n_elements)
    for depth in np.linspace(0.0, 0.02, 9)[1:]:
        u[punch, 1] = -depth
        u, nodal, state = dense_equilibrium(data, u, held, law, state)
    return float(-nodal[punch, 1].sum() * n)


def test_plastic_flow_does_not_lock() -> None:
    """Isochoric flow under a punch: full integration is far too stiff, F-bar is close to its refined answer on the coarse mesh."""
    fine = indentation(8, True)
    coarse = {f_bar: indentation(4, f_bar) for f_bar in (True, False)}
    assert coarse[False] > 1.05 * coarse[True]
    assert abs(coarse[True] / fine - 1.0) < 0.5 * abs(coarse[False] / fine - 1.0)


def test_failed_elements_are_counted() -> None:
    mesh, law = block((1, 2, 1)), law_of(NOMINAL)
    data = element_data(mesh.nodes, mesh.hexes)
    out = (np.empty((2, 24)), np.empty((2, 24, 24)), np.empty((2, 8, 11)), np.empty((2, 8)))
    u = np.zeros(mesh.nodes.shape)
    top = np.isclose(mesh.nodes[:, 1], 3.0)
    for y, number in ((-2.0, 1), (30.0, 1), (0.01, 0)):
        u[top, 1] = y
        assert element_pass(data, u, np.full(mesh.n_nodes, 296.7), virgin_state(2), law, False, *out) == number
