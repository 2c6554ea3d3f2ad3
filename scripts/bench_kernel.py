"""Section: the pieces of a Newton iteration and of a heat step on the dogbone, beside the limits of the machine."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from bench_bar import PARAMETERS, SPECIMEN
from bench_measure import Limits, Options, Part, Row, cpu

from thermofit.body.body import Body, tension_body, thermal_geometry
from thermofit.body.element.hex8 import element_pass
from thermofit.body.heat.conduction import heat_conditions, heat_step
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.solve.linear import BandPattern, Factor, scatter
from thermofit.body.solve.newton import virgin_state
from thermofit.law.page import law_of

PASS_FLOPS = 67e3
"""Operations of one plastic element with residual and tangent, estimated from its loops: sums of the stiffness on lanes (28e3), their
products (7e3), tangent of the points (24e3), kinematics and update (8e3). The usual B^T D B form takes three times as many."""
N_RIGHT = 16


def dogbone_body(mesh: tuple[int, int, int]) -> Body:
    """The dogbone of all sections with n_x, n_y, n_z elements."""
    return tension_body(dogbone_mesh(SPECIMEN, *mesh))


class Pieces:
    """One body in a homogeneous plastic state, with the arrays that a Newton iteration needs."""

    def __init__(self, body: Body) -> None:
        nodes = body.mesh.nodes
        self.body, self.law = body, law_of(PARAMETERS)
        self.u = np.stack([-0.0012 * nodes[:, 0], 0.003 * (nodes[:, 1] - nodes[:, 1].min()), -0.0017 * nodes[:, 2]], axis=1)
        self.theta, self.state_n = np.full(len(nodes), 297.0), virgin_state(body.mesh.n_elements)
        self.state, self.dilatation = self.state_n.copy(), np.empty(self.state_n.shape[:2])
        self.force = np.empty((body.mesh.n_elements, 24))
        self.stiffness = np.empty((body.mesh.n_elements, 24, 24))
        self.data = np.zeros(body.mechanical.n_slots)

    def element_pass(self, scale: float, *, tangent: bool) -> None:
        """Residual (and tangent) of all elements at `scale` times the displacement of the plastic state."""
        arguments = (self.body.data, scale * self.u, self.theta, self.state_n, self.law, tangent)
        element_pass(*arguments, self.force, self.stiffness, self.state, self.dilatation)

    def assemble(self) -> None:
        """Scatter of the element matrices."""
        self.data[:] = 0.0
        scatter(self.stiffness, self.body.mechanical_slot, self.data)

    def newton_iteration(self) -> None:
        """One iteration with a fresh tangent: pass with tangent, scatter, factor, solve, residual at the new place."""
        self.element_pass(1.0, tangent=True)
        self.assemble()
        Factor(self.body.mechanical, self.data).solve(np.ones(self.body.n_equations))
        self.element_pass(1.0, tangent=False)


def measure(options: Options, limits: Limits) -> Part:
    """Medians of CPU seconds with the distance to the limits."""
    body = dogbone_body(options.mesh)
    pieces, repeat = Pieces(body), options.repeat
    rows = [*_element_rows(pieces, limits, repeat), *_linear_rows(pieces, limits, repeat)]
    rows.append(Row("one Newton iteration", cpu(pieces.newton_iteration, repeat), "pass with tangent, scatter, factor, solve, residual"))
    geometry, conditions = thermal_geometry(body, pieces.u), heat_conditions(PARAMETERS)
    heat = np.zeros(body.mesh.n_nodes)
    rows.append(Row("thermal matrices of a step", cpu(lambda: thermal_geometry(body, pieces.u), repeat)))
    step = cpu(lambda: heat_step(body, geometry, conditions, pieces.theta, heat, (1.0, "sdirk2")), repeat)
    rows.append(Row("heat step", step, "factor and two stages"))
    n_x, n_y, n_z = options.mesh
    title = f"Pieces of a step, dogbone {n_x} x {n_y} x {n_z}"
    remark = (
        f"{body.mesh.n_elements} hex8, {body.n_equations} mechanical equations with half bandwidth {body.mechanical.bandwidth}, "
        f"{body.thermal.n} temperatures. Operations of an element pass are estimated as {PASS_FLOPS * body.mesh.n_elements / 1e9:.2f} GF. "
        "Those of a factor are n b^2, of a solve 4 n b, for n equations and half bandwidth b."
    )
    return Part(title, tuple(rows), (), (remark,))


def _element_rows(pieces: Pieces, limits: Limits, repeat: int) -> list[Row]:
    flops = PASS_FLOPS * pieces.body.mesh.n_elements

    def passing(scale: float, *, tangent: bool) -> Callable[[], object]:
        return lambda: pieces.element_pass(scale, tangent=tangent)

    full = cpu(passing(1.0, tangent=True), repeat)
    return [
        Row("element pass, elastic, residual", cpu(passing(0.3, tangent=False), repeat)),
        Row("element pass, elastic, with tangent", cpu(passing(0.3, tangent=True), repeat)),
        Row("element pass, plastic, residual", cpu(passing(1.0, tangent=False), repeat)),
        Row("element pass, plastic, with tangent", full, limits.of_product(flops, full)),
    ]


def _linear_rows(pieces: Pieces, limits: Limits, repeat: int) -> list[Row]:
    pattern = pieces.body.mechanical
    pieces.element_pass(1.0, tangent=True)
    scattering = cpu(pieces.assemble, repeat)
    moved = 8.0 * pieces.stiffness.size + pieces.body.mechanical_slot.nbytes + 16.0 * pattern.n_slots
    factoring = cpu(lambda: Factor(pattern, pieces.data), repeat)
    factor = Factor(pattern, pieces.data)
    right = np.random.default_rng(0).normal(size=(pattern.n, N_RIGHT))
    one, many = cpu(lambda: factor.solve(right[:, 0]), repeat), cpu(lambda: factor.solve(right), repeat)
    return [
        Row("scatter of the tangent", scattering, limits.of_bandwidth(moved, scattering)),
        Row("factor, mechanical", factoring, limits.of_product(factor_flops(pattern), factoring)),
        Row("solve, 1 right-hand side", one, limits.of_bandwidth(2.0 * 8.0 * pattern.n * (pattern.bandwidth + 1), one)),
        Row(f"solve, {N_RIGHT} right-hand sides", many, limits.of_product(N_RIGHT * 4.0 * pattern.n * pattern.bandwidth, many)),
    ]


def factor_flops(pattern: BandPattern) -> float:
    """Operations of the band Cholesky: n b^2."""
    return float(pattern.n) * float(pattern.bandwidth) ** 2
