"""Node planes along the load: evenly spaced between places at which one has to lie, the mouth of the jaws among them.

Films of the jaws act on whole facets. Where no node plane lies at the mouth of the jaws, the area that they hold depends on the mesh, and a
contact coefficient takes what the area lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from thermofit.body.mesh.mesh import Mesh
from thermofit.core.errors import StudyError

_SAME = 1e-9
"""Part of the length within which two places are one."""


def planes(ends: Sequence[float], counts: Sequence[int]) -> np.ndarray:
    """Positions (sum of counts + 1,) mm of node planes: `counts` (k,) elements of one length between two neighbours of `ends` (k + 1,)."""
    pieces = [np.linspace(a, b, n + 1) for a, b, n in zip(ends[:-1], ends[1:], counts, strict=True)]
    return np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])


def split_at(ends: Sequence[float], counts: Sequence[int], mouth: float) -> tuple[list[float], list[int]]:
    """Ends and counts of `planes` with `mouth` among the ends, and as many elements in all: those of the piece in which it lies are shared
    by length, and where that has one element only, the piece with most gives one. The same where mouth is an end.
    StudyError where it lies before the first, or where the elements are too few."""
    ends, counts = list(ends), list(counts)
    near = _SAME * (ends[-1] - ends[0])
    if any(abs(mouth - end) <= near for end in ends):
        return ends, counts
    if not ends[0] < mouth < ends[-1]:
        raise StudyError(
            f"specimen: gripped_length puts the mouth of the jaws {mouth:.4g} mm from the middle of the specimen; expected between "
            f"{ends[0]:.4g} and {ends[-1]:.4g} mm, where this shape can be held"
        )
    k = int(np.searchsorted(ends, mouth)) - 1
    if counts[k] < 2:
        most = int(np.argmax(counts))
        if counts[most] < 2:
            raise StudyError(
                f"mesh.n_y: too few elements for a node plane at the mouth of the jaws, {mouth:.4g} mm from the middle of the "
                "specimen; raise it"
            )
        counts[most] -= 1
        counts[k] += 1
    before = round(counts[k] * (mouth - ends[k]) / (ends[k + 1] - ends[k]))
    before = min(max(before, 1), counts[k] - 1)
    return [*ends[: k + 1], mouth, *ends[k + 1 :]], [*counts[:k], before, counts[k] - before, *counts[k + 1 :]]


def longest(mesh: Mesh) -> tuple[float, float]:
    """Length mm along the load of the longest element in the jaws, 0 where nothing is held, and of the longest one outside, in a mesh of
    node planes."""
    y = np.unique(np.round(mesh.nodes[:, 1], 6))
    held = mesh.nodes[mesh.facets["clamp"], 1].mean(axis=1)
    inside = np.array([np.any((held > a + _SAME) & (held < b - _SAME)) for a, b in pairwise(y)])
    length = np.diff(y)
    return float(length[inside].max(initial=0.0)), float(length[~inside].max(initial=0.0))
