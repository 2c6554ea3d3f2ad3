"""What a specimen that hangs free expands by where it becomes warmer than its run had it.

Thermal strain is alpha_exp (theta - theta_ref) in every direction and adds to the strain that the force makes, whatever that is (4.4). In a
specimen that is pulled by a force nothing holds it back but what is colder at its side. Where that is taken for nothing,

    du_y(y) = int alpha_exp dtheta dy,    du_x = alpha_exp dtheta x,

dtheta the mean over a section, y and x where the material is now, from the end that does not move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from thermofit.body.body import Body

DIGITS = 6
"""Digits of a mm by which nodes are on different sections."""
LEAST_NODES = 4
"""Nodes of a section of a mesh of bricks at least; a mesh with fewer at one height has no sections."""


@dataclass(frozen=True)
class CrossSections:
    """Sections of a mesh along the load: `of` (n_np,) the number of that of every node, upwards, and the number of nodes (n,) of each."""

    of: np.ndarray
    count: np.ndarray

    def mean(self, nodal: np.ndarray) -> np.ndarray:
        """Means (n, m) over the sections of nodal values (n_np, m)."""
        out = np.zeros((len(self.count), nodal.shape[1]))
        np.add.at(out, self.of, nodal)
        return out / self.count[:, None]

    def expansion(self, position: np.ndarray, warmer: np.ndarray, alpha_exp: float) -> np.ndarray:
        """Displacements (n_np, 3, m) mm by temperatures (n_np, m) K that are added, of nodes that are at `position` (n_np, 3) mm."""
        strain = alpha_exp * self.mean(warmer)
        along = cumulative_trapezoid(strain, self.mean(position[:, 1:2])[:, 0], axis=0, initial=0.0)
        out = np.zeros((len(position), 3, warmer.shape[1]))
        out[:, 1] = along[self.of]
        out[:, 0] = strain[self.of] * position[:, :1]
        return out


def sections_of(body: Body) -> CrossSections | None:
    """The sections of a mesh that is made of rows across the load; None of one that is not."""
    _, of, count = np.unique(np.round(body.mesh.nodes[:, 1], DIGITS), return_inverse=True, return_counts=True)
    return CrossSections(of, count) if count.min() >= LEAST_NODES else None
