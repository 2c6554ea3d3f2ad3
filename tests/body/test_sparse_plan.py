"""Choice of the solver by predicted cost: numbering, size of a factor by nested dissection, and which solver they lead to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from thermofit.body.mesh.mesh import structured_hexes
from thermofit.body.solve.linear import BandPattern, band_pattern
from thermofit.body.solve.sparse import SparseLU
from thermofit.body.solve.sparse_graph import dissection_size, node_graph
from thermofit.body.solve.sparse_plan import BAND_CHOLESKY, BAND_LU, SPARSE_LU

SCIPY = (BAND_CHOLESKY, SPARSE_LU)


def mesh_pattern(n_x: int, n_y: int, n_z: int, *, dofs: int = 3, scattered: bool = False, hole: bool = False) -> BandPattern:
    """Pattern of a block of hex8 elements, as it is numbered or at random; with a round hole through the middle of x and y."""
    hexes = structured_hexes(n_x, n_y, n_z)
    if hole:
        element = np.arange(len(hexes))
        x, y = (element // n_z % n_x + 0.5) / n_x, (element // (n_x * n_z) + 0.5) / n_y
        hexes = hexes[np.hypot(x - 0.5, y - 0.5) > 0.2]
    _, hexes = np.unique(hexes, return_inverse=True)
    n = int(hexes.max()) + 1
    number = np.random.default_rng(0).permutation(n) if scattered else np.arange(n)
    equation = dofs * number[hexes.reshape(-1, 8)][:, :, None] + np.arange(dofs)
    return band_pattern(equation.reshape(len(equation), 8 * dofs), dofs * n)


def test_unknowns_of_a_node_are_one_vertex_of_the_graph() -> None:
    pattern = mesh_pattern(3, 4, 2)
    graph = node_graph(pattern.n, pattern.row, pattern.column)
    assert len(graph.weight) == 4 * 5 * 3 and np.all(graph.weight == 3.0)
    assert np.array_equal(graph.vertex[0::3], graph.vertex[1::3]) and np.array_equal(graph.vertex[0::3], graph.vertex[2::3])
    assert np.diff(graph.start).max() == 27 and np.diff(graph.start).min() == 8


def test_the_dogbone_keeps_its_numbering_and_its_band() -> None:
    plan = mesh_pattern(12, 80, 4).plan
    assert plan.order is None
    assert plan.cheapest(SCIPY) == BAND_CHOLESKY
    assert plan.cheapest((BAND_LU, SPARSE_LU)) == BAND_LU
    assert plan.seconds[SPARSE_LU] > 3.0 * plan.seconds[BAND_CHOLESKY]


def test_a_scattered_dogbone_is_numbered_along_its_axis() -> None:
    """Levels that start from a whole cross-section give nearly the band of the structured numbering, 215; from a corner it is 404."""
    pattern = mesh_pattern(12, 80, 4, scattered=True)
    assert pattern.bandwidth > 10000 and pattern.plan.bandwidth < 240
    assert pattern.plan.cheapest(SCIPY) == BAND_CHOLESKY


def test_a_cube_without_a_narrow_numbering_goes_to_the_general_solver() -> None:
    """Numbered by planes, a cube of this size is still cheaper as a band: panels make up for three times the arithmetic."""
    assert mesh_pattern(18, 18, 18, scattered=True).plan.cheapest(SCIPY) == SPARSE_LU
    assert mesh_pattern(18, 18, 18).plan.cheapest(SCIPY) == BAND_CHOLESKY


@pytest.mark.parametrize(
    "counts", [(12, 80, 4), (8, 8, 8), (30, 30, 1), (16, 16, 4)], ids=["bar", "cube", "plate", "slab"]
)  # fmt: skip
def test_predicted_size_of_a_sparse_factor_is_that_of_superlu(counts: tuple[int, int, int]) -> None:
    """Non-zeros and multiplications of the Cholesky factor within a factor of two of minimum degree; also where a hole is cut out."""
    for hole in (False, True):
        pattern = mesh_pattern(*counts, dofs=1, hole=hole)
        multiplications, non_zeros = dissection_size(node_graph(pattern.n, pattern.row, pattern.column))
        off = pattern.row != pattern.column
        rows = np.concatenate([pattern.row, pattern.column[off]])
        columns = np.concatenate([pattern.column, pattern.row[off]])
        values = np.where(rows == columns, 100.0, -1.0)
        lower = splu(csc_matrix((values, (rows, columns))), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).L
        assert 0.5 < non_zeros / lower.nnz < 2.0
        assert 0.4 < multiplications / np.sum(np.diff(lower.indptr).astype(float) ** 2) < 2.5


def test_an_indefinite_matrix_keeps_the_fill_of_its_ordering() -> None:
    """Several hundred negative eigenvalues: pivots off the diagonal must not undo the minimum degree ordering."""
    pattern = mesh_pattern(20, 20, 2, dofs=1)
    random = np.random.default_rng(0)
    data = random.uniform(-1.0, 1.0, pattern.n_slots)
    data[pattern.row == pattern.column] = random.choice([-2.0, 2.0], pattern.n)
    indefinite = SparseLU(pattern.n, pattern.row, pattern.column, data)
    definite = SparseLU(pattern.n, pattern.row, pattern.column, np.where(pattern.row == pattern.column, 100.0, data))
    assert indefinite._lu.L.nnz < 1.2 * definite._lu.L.nnz
    b = random.standard_normal((pattern.n, 2))
    off = pattern.row != pattern.column
    x = indefinite.solve(b)
    product = np.zeros_like(b)
    np.add.at(product, pattern.row, data[:, None] * x[pattern.column])
    np.add.at(product, pattern.column[off], data[off, None] * x[pattern.row[off]])
    assert product == pytest.approx(b, abs=1e-6)
