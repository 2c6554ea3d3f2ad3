"""The problem that thermofit and its peers solve: a straight bar drawn by 15 %, heated by its plastic work, cooled at sides and ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermofit.body.body import Body, tension_body
from thermofit.body.heat.conduction import at_constant_stress, heat_conditions
from thermofit.body.mesh.mesh import Mesh, boundary_facets, structured_hexes
from thermofit.body.solve.march import Loading
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.law.page import Law, dissipated_energy, hardening_variable, law_of, yield_stress

SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
PARAMETERS = Parameters.of(
    {
        "E": 68396.66, "nu": 0.34, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "F": 0.35, "alpha_exp": 20.21e-6, "kappa": 133.45,
        "c0": 2.22, "beta": 0.79, "alpha_air": 14.72, "alpha_clamp": 236.3, "theta_air": 297.4, "theta_clamp": 296.7, "theta_ref": 296.7,
    }
)  # fmt: skip
"""The alloy of the thesis's experiment 3."""
MISES = PARAMETERS.replace(F=0.5, G=0.5, H=0.5, theta_air=PARAMETERS["theta_ref"])
"""The same with the yield surface of von Mises, which the peers have, and at rest at the stress-free temperature."""
SYMMETRY = 4.0


@dataclass(frozen=True)
class Bar:
    """Straight bar: elements, full length mm, elongation as a share of it, duration s, number of increments."""

    mesh: tuple[int, int, int]
    length: float = 100.0
    strain: float = 0.15
    duration: float = 100.0
    increments: int = 50

    @property
    def elongation(self) -> float:
        """Displacement of the upper end, mm."""
        return self.strain * self.length


def bar_mesh(bar: Bar) -> Mesh:
    """Quarter model x in [0, w/2], y in [0, l], z in [0, t/2] of the specimen's gauge section, with the sets of a tension test."""
    n_x, n_y, n_z = bar.mesh
    size = (0.5 * SPECIMEN.gauge_width, bar.length, 0.5 * SPECIMEN.thickness)
    x, y, z = (np.linspace(0.0, length, n + 1) for length, n in zip(size, bar.mesh, strict=True))
    block = np.stack(np.meshgrid(y, x, z, indexing="ij"), axis=-1)
    nodes = np.ascontiguousarray(block.reshape(-1, 3)[:, [1, 0, 2]])
    hexes = structured_hexes(n_x, n_y, n_z)
    number = np.arange(len(nodes)).reshape(n_y + 1, n_x + 1, n_z + 1)
    facets = boundary_facets(hexes)
    centre = nodes[facets].mean(axis=1)
    end = (centre[:, 1] == 0.0) | (centre[:, 1] == size[1])
    symmetric = (centre[:, 0] == 0.0) | (centre[:, 2] == 0.0)
    return Mesh(
        nodes=nodes,
        hexes=hexes,
        facets={"air": facets[~end & ~symmetric], "clamp": facets[end]},
        node_sets={
            "x0": number[:, 0, :].ravel(),
            "z0": number[:, :, 0].ravel(),
            "bottom": number[0].ravel(),
            "top": number[-1].ravel(),
            "face": number[:, :, -1].ravel(),
        },
    )


def bar_body(bar: Bar, control: str = "displacement") -> Body:
    """The bar under a prescribed displacement of its upper end, or under a force."""
    return tension_body(bar_mesh(bar), control=control)


def bar_loading(bar: Bar) -> Loading:
    """Even elongation from the stress-free state."""
    return Loading(np.array([0.0, bar.duration]), np.array([0.0, bar.elongation]), "displacement")


def bar_times(bar: Bar) -> np.ndarray:
    """Equal increments (n + 1,) s."""
    return np.linspace(0.0, bar.duration, bar.increments + 1)


def middle_node(mesh: Mesh) -> int:
    """Node whose temperature is compared: on the axis, half way along the bar."""
    return mesh.nearest_node((0.0, float(mesh.nodes[:, 1].mean()), 0.0))


@dataclass(frozen=True)
class Curve:
    """Uniaxial answer of the law with the surface of von Mises: equivalent plastic strain (n,), yield stress MPa (n,),
    dissipated energy mJ/mm^3 (n,). Kirchhoff stress over logarithmic strain; the volume hardly changes, so that true stress is the same.
    """

    strain: np.ndarray
    stress: np.ndarray
    dissipated: np.ndarray


def curve(law: Law, strain: np.ndarray) -> Curve:
    """Curve at equivalent plastic strains (n,); the yield stress along y is M_y / sqrt(F + H) (4.19)."""
    along = 1.0 / np.sqrt(law.F + law.H)
    stress, dissipated = np.empty_like(strain), np.empty_like(strain)
    for n, value in enumerate(strain):
        multiplier = float(value) / along
        alpha = hardening_variable(0.0, multiplier, law)[0]
        stress[n] = along * yield_stress(alpha, multiplier, law)[0]
        dissipated[n] = dissipated_energy(0.0, alpha, multiplier, law)
    return Curve(strain, stress, dissipated)


def plastic_strain(law: Law, elongation: np.ndarray) -> np.ndarray:
    """Logarithmic plastic strain of a bar drawn evenly by `elongation` (n,), a share of its length: ln(1 + e) = sigma/E + eps_p."""
    young = law.mu * (3.0 * law.lame + 2.0 * law.mu) / (law.lame + law.mu)
    grid = np.linspace(0.0, 1.5 * float(np.log1p(elongation.max(initial=0.0))) + 1e-6, 2001)
    total = grid + curve(law, grid).stress / young
    return np.interp(np.log1p(elongation), total, grid, left=0.0)


def heating(bar: Bar, law: Law, times: np.ndarray) -> np.ndarray:
    """Dissipated power mW/mm^3 at `times` (n,) s in the evenly drawn bar: what a code without plastic heating is given as a source."""
    dt = 1e-3 * bar.duration / bar.increments

    def energy(t: np.ndarray) -> np.ndarray:
        return curve(law, plastic_strain(law, bar.strain * np.clip(t, 0.0, None) / bar.duration)).dissipated

    return np.asarray((energy(times) - energy(times - dt)) / dt)


def peer_constants(parameters: Parameters) -> Mapping[str, float]:
    """E, nu, alpha_exp, kappa, theta_ref, films in mW/(mm^2 K), and the heat capacity at constant stress, mJ/(mm^3 K), of the peers."""
    conditions = at_constant_stress(heat_conditions(parameters), law_of(parameters))
    names = ("E", "nu", "alpha_exp", "kappa", "theta_ref", "theta_air", "theta_clamp")
    return {
        **{name: parameters[name] for name in names},
        "capacity": conditions.c0,
        "film_air": 1e-3 * parameters["alpha_air"],
        "film_clamp": 1e-3 * parameters["alpha_clamp"],
    }
