"""The body of a tension test: mesh, equations of both fields, patterns and constant matrices. No material, no state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array

from thermofit.body.element.hex8 import ElementData, element_data
from thermofit.body.heat.equation import (
    FacetData,
    at_points,
    capacity_matrices,
    conduction_matrices,
    facet_data,
    film_matrices,
    swelling_matrices,
)
from thermofit.body.mesh.mesh import Mesh, boundary_facets
from thermofit.body.solve.linear import BandPattern, band_pattern, scatter, slots
from thermofit.core.errors import StudyError

ABOVE = 1e-9
"""Part of the largest extent of a body by which points above one another may differ in the plane: rounding."""


@dataclass(frozen=True)
class Plane:
    """Points of integration as they lie in the plane of a sheet, those above one another once: x, y (n_d,) mm from the middle, x over half
    the width of the body at that height (n_d,), and the nodal heat (n_np, n_d) mm^3 of a unit density at them, int N_a dV."""

    x: np.ndarray
    y: np.ndarray
    across: np.ndarray
    heat: csr_array


@dataclass(frozen=True)
class Body:
    """Mesh and numbering. `equation` (n_np, 3): mechanical equation of a dof, FIXED (-1) or LOADED (-2, prescribed top).

    `top` is the equation of the tied end (or -1 under displacement control), `symmetry` the factor from model to specimen.
    """

    mesh: Mesh
    data: ElementData
    equation: np.ndarray
    top: int
    symmetry: float
    mechanical: BandPattern
    mechanical_slot: np.ndarray
    element_equation: np.ndarray
    thermal: BandPattern
    thermal_slot: np.ndarray
    capacity: np.ndarray
    swelling: np.ndarray
    films: Mapping[str, FacetData]
    film_slot: Mapping[str, np.ndarray]

    @property
    def n_equations(self) -> int:
        """Number of free mechanical equations."""
        return self.mechanical.n

    @property
    def loaded(self) -> np.ndarray:
        """Nodes of the tied, loaded end."""
        return self.mesh.node_sets["top"]

    @cached_property
    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Reference coordinates x, y of the points of integration, each (n_el, 8) mm, from the middle as `about_middle` has them."""
        x, y = (at_points(self.data, c) for c in about_middle(self))
        return x, y

    @cached_property
    def plane(self) -> Plane:
        """The points of integration as they lie in the plane."""
        x, y = (c.ravel() for c in self.points)
        close = ABOVE * max(float(np.ptp(x)), float(np.ptp(y)))
        _, first, which = np.unique(np.round(np.stack([x, y], axis=1) / close), axis=0, return_index=True, return_inverse=True)
        share = self.data.volume[:, :, None] * self.data.shape[None]
        node = np.broadcast_to(self.data.hexes[:, None, :], share.shape)
        column = np.broadcast_to(which.reshape(*self.data.volume.shape, 1), share.shape)
        heat = coo_array((share.ravel(), (node.ravel(), column.ravel())), shape=(self.mesh.n_nodes, len(first)))
        x, y = x[first], y[first]
        return Plane(x, y, x / reach_across(self, y), csr_array(heat))


_UPRIGHT = 0.5
"""Part of a facet's normal along the thickness below which it is of the contour."""


def reach_across(body: Body, y: np.ndarray) -> np.ndarray:
    """Largest distance in mm from the axis x = 0 (n,) of the body at heights y (n,) mm from its middle, between its ends: that of the
    straight edges of its contour in the plane."""
    facets = boundary_facets(body.mesh.hexes)
    corner = body.mesh.nodes[facets]
    normal = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    contour = np.abs(normal[:, 2]) < _UPRIGHT * np.linalg.norm(normal, axis=1)
    ends = np.stack([facets[contour], np.roll(facets[contour], -1, axis=1)], axis=-1).reshape(-1, 2)
    x, height = (np.asarray(c)[ends] for c in about_middle(body))
    rises = np.abs(height[:, 1] - height[:, 0]) > ABOVE * float(np.ptp(body.mesh.nodes[:, 1]))
    edge = np.unique(np.concatenate([np.abs(x[rises]), height[rises]], axis=1), axis=0)
    part = (y[:, None] - edge[:, 2]) / (edge[:, 3] - edge[:, 2])
    there = np.where((part >= 0.0) & (part <= 1.0), edge[:, 0] + part * (edge[:, 1] - edge[:, 0]), 0.0)
    return np.asarray(there.max(axis=1))


def about_middle(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Reference coordinates x, y of the nodes (n_np,) mm, y from the middle of the body."""
    x, y = body.mesh.nodes[:, 0], body.mesh.nodes[:, 1]
    return x, y - 0.5 * (y.min() + y.max())


FIXED, LOADED = -1, -2
_DIRECTION = {"x0": 0, "bottom": 1, "z0": 2}


def tension_body(mesh: Mesh, *, control: str = "force", f_bar: bool = True, symmetry: float = 4.0) -> Body:
    """Body under tension along y (thesis 5.2.2).

    Node set x0: u_x = 0, z0: u_z = 0, bottom: u_y = 0, top: all u_y equal (linear tie). `control` "force" makes the common u_y an
    unknown, "displacement" prescribes it. Lateral contraction is free at both ends. StudyError where a node set is missing.
    """
    missing = [name for name in (*_DIRECTION, "top") if name not in mesh.node_sets]
    if missing:
        raise StudyError(f"mesh: node set '{missing[0]}' is missing; a tension test needs the sets x0, z0, bottom and top")
    if control not in ("force", "displacement"):
        raise StudyError(f"control: '{control}' found; expected 'force' or 'displacement'")
    equation = np.zeros((mesh.n_nodes, 3), dtype=np.int64)
    for name, direction in _DIRECTION.items():
        equation[mesh.node_sets[name], direction] = FIXED
    top = mesh.node_sets["top"]
    master = int(top.min())
    equation[top, 1] = LOADED
    if control == "force":
        equation[master, 1] = 0
    free = equation >= 0
    equation[free] = np.arange(int(free.sum()))
    if control == "force":
        equation[top, 1] = equation[master, 1]
    data = element_data(mesh.nodes, mesh.hexes, f_bar=f_bar)
    n_equations = int(free.sum())
    element_equation = np.maximum(equation[mesh.hexes].reshape(mesh.n_elements, 24), FIXED)
    mechanical = band_pattern(element_equation, n_equations)
    thermal = band_pattern(mesh.hexes, mesh.n_nodes)
    thermal_slot = slots(thermal, mesh.hexes)
    capacity, swelling = np.zeros(thermal.n_slots), np.zeros(thermal.n_slots)
    scatter(capacity_matrices(data), thermal_slot, capacity)
    scatter(swelling_matrices(data), thermal_slot, swelling)
    return Body(
        mesh=mesh,
        data=data,
        equation=equation,
        top=int(equation[master, 1]) if control == "force" else -1,
        symmetry=symmetry,
        mechanical=mechanical,
        mechanical_slot=slots(mechanical, element_equation),
        element_equation=element_equation,
        thermal=thermal,
        thermal_slot=thermal_slot,
        capacity=capacity,
        swelling=swelling,
        films={name: facet_data(facets) for name, facets in mesh.facets.items()},
        film_slot={name: slots(thermal, facets) for name, facets in mesh.facets.items()},
    )


def check_axes(body: Body, angle: float) -> None:
    """StudyError where material axes turned by `angle` degrees about z break a symmetry plane x = 0 of the body."""
    on_plane = np.zeros(body.mesh.n_nodes, dtype=bool)
    on_plane[body.mesh.node_sets["x0"]] = True
    if angle % 90.0 != 0.0 and on_plane[boundary_facets(body.mesh.hexes)].all(axis=1).any():
        raise StudyError(
            f"material axes: an angle of {angle:g} degrees found, but the body is a symmetric part, which only multiples of 90 degrees "
            "leave symmetric; choose one of them, or mesh the whole specimen"
        )


@dataclass(frozen=True)
class ThermalGeometry:
    """Conduction (n_slots,) for unit kappa, mm, and per film set int N_a N_b da (n_slots,) and int N_a da (n_np,), mm^2."""

    conduction: np.ndarray
    film: Mapping[str, np.ndarray]
    film_area: Mapping[str, np.ndarray]

    def mean_with(self, other: ThermalGeometry) -> ThermalGeometry:
        """Mean of both: the geometry of a time step to second order."""
        return ThermalGeometry(
            0.5 * (self.conduction + other.conduction),
            {name: 0.5 * (self.film[name] + other.film[name]) for name in self.film},
            {name: 0.5 * (self.film_area[name] + other.film_area[name]) for name in self.film},
        )


def thermal_geometry(body: Body, u: np.ndarray) -> ThermalGeometry:
    """Matrices of conduction and film exchange on the body deformed by u (n_np, 3) mm."""
    matrices = np.empty((body.mesh.n_elements, 8, 8))
    conduction_matrices(body.data, u, matrices)
    conduction = np.zeros(body.thermal.n_slots)
    scatter(matrices, body.thermal_slot, conduction)
    film, area = {}, {}
    x = body.mesh.nodes + u
    for name, facets in body.films.items():
        local = np.empty((len(facets.facets), 4, 4))
        film_matrices(facets, x, local)
        film[name] = np.zeros(body.thermal.n_slots)
        scatter(local, body.film_slot[name], film[name])
        shares = np.bincount(facets.facets.ravel(), local.sum(axis=2).ravel(), minlength=body.mesh.n_nodes)
        area[name] = shares.astype(float)  # numpy counts an empty set in integers
    return ThermalGeometry(conduction, film, area)
