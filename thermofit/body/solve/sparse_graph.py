"""Graph of a symmetric sparsity pattern: a narrow numbering by level sets, and the size of a factor by nested dissection.

Equations with the same closed neighbourhood (the unknowns of one node) are one vertex of the graph, whose weight is their number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from thermofit.core.jit import kernel

_LEAF = 30
"""Parts of at most so many equations are not divided further."""
_SWEEPS = 3


@dataclass(frozen=True)
class NodeGraph:
    """Neighbours of vertex v: `neighbour[start[v] : start[v + 1]]`; `weight` equations per vertex, `vertex` (n,) of an equation."""

    start: np.ndarray
    neighbour: np.ndarray
    weight: np.ndarray
    vertex: np.ndarray


def node_graph(n: int, row: np.ndarray, column: np.ndarray) -> NodeGraph:
    """Graph of the symmetric pattern whose lower triangle has the non-zeros (row, column)."""
    diagonal = np.arange(n)
    rows, columns = np.concatenate([row, column, diagonal]), np.concatenate([column, row, diagonal])
    matrix = csr_matrix((np.ones(len(rows), dtype=np.int32), (rows, columns)), shape=(n, n))
    # Equal neighbourhoods are found by equal sums of random numbers: 64 bits make a coincidence as good as impossible, and one would
    # only make the numbering worse, never the solution wrong.
    label = np.random.default_rng(0).integers(1, 2**62, n)
    _, first, vertex = np.unique(np.add.reduceat(label[matrix.indices], matrix.indptr[:-1]), return_index=True, return_inverse=True)
    quotient = matrix[first][:, first].tocsr()
    quotient.sort_indices()
    weight = np.bincount(vertex).astype(float)
    return NodeGraph(quotient.indptr.astype(np.int64), quotient.indices.astype(np.int64), weight, vertex)


def narrow_order(graph: NodeGraph, row: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, int]:
    """Equations (n,) in an order with a narrow band, and the half bandwidth of it.

    Cuthill and McKee's numbering, but started from the whole last level of the sweep before instead of one of its vertices: in a long
    body the levels are then its cross-sections, which halves the band that a start in one corner gives.
    """
    order = np.empty(len(graph.start) - 1, dtype=np.int64)
    order[0] = np.argmin(np.diff(graph.start))
    begin, end = _number_by_levels(graph.start, graph.neighbour, order, 1)
    best, bandwidth = np.empty(0, dtype=np.int64), len(graph.vertex)
    for _ in range(_SWEEPS):
        last = order[begin:end].copy()
        order[: len(last)] = last
        begin, end = _number_by_levels(graph.start, graph.neighbour, order, len(last))
        equations = np.argsort(_inverse(order)[graph.vertex], kind="stable")
        position = _inverse(equations)
        width = int(np.abs(position[row] - position[column]).max(initial=0))
        if width < bandwidth or not best.size:
            best, bandwidth = equations, width
    return best, bandwidth


def _inverse(order: np.ndarray) -> np.ndarray:
    position = np.empty_like(order)
    position[order] = np.arange(len(order))
    return position


@kernel
def _number_by_levels(start: np.ndarray, neighbour: np.ndarray, order: np.ndarray, count: int) -> tuple[int, int]:
    """Fill `order` level by level from its first `count` vertices, neighbours of low degree first; [begin, end) of the last level.

    Vertices that are not connected to the first ones follow, part by part; the last level is that of the first part.
    """
    n = order.shape[0]
    level = np.full(n, -1, dtype=np.int64)
    for q in range(count):
        level[order[q]] = 0
    head, begin, end = 0, 0, 0
    while head < n:
        if head == count:
            end = count if end == 0 else end
            best = -1
            for v in range(n):
                if level[v] < 0 and (best < 0 or start[v + 1] - start[v] < start[best + 1] - start[best]):
                    best = v
            order[count], level[best] = best, 0
            count += 1
        v = order[head]
        if end == 0 and head > 0 and level[v] != level[order[head - 1]]:
            begin = head
        head += 1
        first = count
        for e in range(start[v], start[v + 1]):
            w = neighbour[e]
            if level[w] < 0:
                level[w] = level[v] + 1
                k = count
                while k > first and start[order[k - 1] + 1] - start[order[k - 1]] > start[w + 1] - start[w]:
                    order[k] = order[k - 1]
                    k -= 1
                order[k] = w
                count += 1
    return begin, n if end == 0 else end


def dissection_size(graph: NodeGraph) -> tuple[float, float]:
    """Multiplications and non-zeros of the Cholesky factor in an order by automatic nested dissection (George and Liu 1978).

    Every part is divided by its middle level into two; s equations of a separator (or of an undivided part) with t equations around
    them cost s^3/3 + s^2 t + s t^2 and leave s^2/2 + s t non-zeros.
    """
    size, fill = _dissect(graph.start, graph.neighbour, graph.weight, _LEAF)
    return float(size), float(fill)


@kernel
def _levels(
    start: np.ndarray, neighbour: np.ndarray, part: np.ndarray, level: np.ndarray, queue: np.ndarray, root: int, label: int
) -> tuple[int, int]:
    """Breadth-first search from `root` in its part, which gets the new `label`: vertices in `queue`; their number, begin of last level."""
    old = part[root]
    queue[0], part[root], level[root] = root, label, 0
    count, head, last = 1, 0, 0
    while head < count:
        v = queue[head]
        if level[v] != level[queue[last]]:
            last = head
        head += 1
        for e in range(start[v], start[v + 1]):
            w = neighbour[e]
            if part[w] == old:
                part[w], level[w] = label, level[v] + 1
                queue[count] = w
                count += 1
    return count, last


@kernel
def _around(
    start: np.ndarray, neighbour: np.ndarray, weight: np.ndarray, part: np.ndarray, seen: np.ndarray, queue: np.ndarray, mark: int
) -> float:
    """Equations of the separators (part -1) that touch the vertices of `queue`."""
    around = 0.0
    for v in queue:
        for e in range(start[v], start[v + 1]):
            w = neighbour[e]
            if part[w] < 0 and seen[w] != mark:
                seen[w] = mark
                around += weight[w]
    return around


@kernel
def _separate(
    start: np.ndarray, neighbour: np.ndarray, weight: np.ndarray, part: np.ndarray, level: np.ndarray, queue: np.ndarray, half: float
) -> float:
    """Make those vertices of the middle level a separator (part -1) that have a neighbour in the next level; their equations."""
    passed, k = weight[queue[0]], 0
    while passed < half:
        k += 1
        passed += weight[queue[k]]
    middle = min(max(level[queue[k]], 1), level[queue[-1]] - 1)
    label, equations = part[queue[0]], 0.0
    for v in queue:
        if level[v] == middle:
            for e in range(start[v], start[v + 1]):
                w = neighbour[e]
                if part[w] == label and level[w] == middle + 1:
                    part[v] = -1
                    equations += weight[v]
                    break
    return equations


@kernel
def _dissect(start: np.ndarray, neighbour: np.ndarray, weight: np.ndarray, leaf: float) -> tuple[float, float]:
    n = start.shape[0] - 1
    part, level, seen = np.zeros(n, dtype=np.int64), np.empty(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    queue, roots = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    size, fill, label = 0.0, 0.0, 1
    for first in range(n):
        if part[first] != 0:
            continue
        roots[0], top = first, 1
        while top > 0:
            top -= 1
            root, deepest = roots[top], -1
            count, last = _levels(start, neighbour, part, level, queue, root, label)
            while level[queue[count - 1]] > deepest:
                deepest = level[queue[count - 1]]
                root = queue[last]
                label += 1
                count, last = _levels(start, neighbour, part, level, queue, root, label)
            around = _around(start, neighbour, weight, part, seen, queue[:count], label)
            equations = 0.0
            for v in queue[:count]:
                equations += weight[v]
            divided = equations > leaf and level[queue[count - 1]] > 1
            if divided:
                equations = _separate(start, neighbour, weight, part, level, queue[:count], 0.5 * equations)
                rest = queue[:count].copy()
                whole = label
                for v in rest:
                    if part[v] == whole:
                        label += 1
                        _levels(start, neighbour, part, level, queue, v, label)
                        roots[top] = v
                        top += 1
            label += 1
            size += equations**3 / 3.0 + equations**2 * around + equations * around**2
            fill += 0.5 * equations**2 + equations * around
    return size, fill
