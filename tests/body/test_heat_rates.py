"""Exact derivatives of the heat equation: every direction against differences of the plain functions, on a body far deformed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from small_bodies import ADIABATIC, NOMINAL, bar_mesh

from thermofit.body.body import Body, tension_body, thermal_geometry
from thermofit.body.heat.conduction import HeatStep, at_constant_stress, heat_conditions, heat_step, steady_temperature
from thermofit.body.heat.equation import PointStates, heat_of_increment, increment_between
from thermofit.body.heat.one_way import HeatProblem, heat_problem, heat_run, heat_run_rates
from thermofit.body.heat.sources import nodal_heat
from thermofit.body.mesh.dogbone import Specimen, dogbone_mesh, half_width
from thermofit.body.mesh.shapes import MeshSize, plate_with_hole_mesh
from thermofit.body.sensitivity.conduction_rates import condition_rates, heat_step_rates, steady_rates
from thermofit.body.sensitivity.heat_effect_rates import multiply_some
from thermofit.body.sensitivity.heat_rates import (
    PointStateRates,
    SourceLaw,
    frozen_source_rates,
    heat_source_rates,
    source_law,
    source_slopes,
)
from thermofit.body.sensitivity.lanes import multiply_directions
from thermofit.body.solve.linear import multiply_symmetric
from thermofit.body.solve.march import History, MarchSettings
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters, param
from thermofit.law.page import Law, law_of
from thermofit.law.page_rates import directions, padded
from thermofit.point.state import ALPHA, LAMBDA

THERMAL = ("alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp", "theta_air", "theta_clamp")
LAW = ("E", "nu", "M_y0", "M_yinf", "H_exp", "alpha_exp", "beta", "theta_ref", "F")
POINT = NOMINAL.replace(theta_ref=293.0, kappa=15.0, alpha_air=800.0, alpha_clamp=1200.0, theta_air=340.0)
"""Far from isothermal, so that differences see every parameter."""
SCHEMES = ("sdirk2", "backward-euler")
RANDOM = np.random.default_rng(7)


def differences(function: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    """Derivative at zero by central differences of order 4."""
    return (8.0 * (function(h) - function(-h)) - (function(2.0 * h) - function(-2.0 * h))) / (12.0 * h)


def moved(name: str, by: float) -> Parameters:
    return POINT.replace(**{name: POINT[name] + by})


def step_of(name: str) -> float:
    return 1e-3 * param(name).scale


def wide_step_of(name: str) -> float:
    """Where the temperature hardly moves: differences need a larger step."""
    return 5e-3 * POINT[name]


def check_columns(rates: np.ndarray, functions: list[Callable[[float], np.ndarray]], steps: list[float], tolerance: float = 1e-7) -> None:
    """Columns of rates (..., m) against differences; what is filled up is zero."""
    assert rates.shape[-1] == padded(len(functions))
    for k, (function, h) in enumerate(zip(functions, steps, strict=True)):
        expected = differences(function, h)
        assert rates[..., k] == pytest.approx(expected, rel=0.0, abs=tolerance * np.abs(expected).max()), k
    assert np.all(rates[..., len(functions) :] == 0.0)


def check_order(function: Callable[[float], np.ndarray], rate: np.ndarray, h: float) -> None:
    """Remainder of the first-order Taylor polynomial falls with the square of the step."""
    remainder = [np.abs(function(s) - function(0.0) - s * rate).max() for s in (h, 0.5 * h, 0.25 * h)]
    orders = np.log2(np.array(remainder[:-1]) / remainder[1:])
    assert np.all(np.abs(orders - 2.0) < 0.1), (remainder, orders)


@pytest.fixture(scope="module")
def body() -> Body:
    return tension_body(bar_mesh((2, 3, 2), (4.0, 9.0, 2.0), air=("x1", "z1"), clamp=("y0", "y1"), distortion=0.2))


def deformation(body: Body, stretch: float) -> np.ndarray:
    """Far from homogeneous, with shear."""
    x = body.mesh.nodes
    gradient = np.array([[-0.3 * stretch, 0.2 * stretch, 0.0], [0.1 * stretch, stretch, -0.1], [0.0, 0.05, -0.4 * stretch]])
    return np.asarray(x @ gradient.T + 0.04 * np.sin(x @ np.array([[1.0, 0.3, 0.2], [0.4, 0.7, 1.1], [0.2, 1.3, 0.6]])))


def test_conditions() -> None:
    """All parameters of the heat equation; at constant stress the elastic constants and the expansion too."""
    law = law_of(POINT)
    for given, names in ((None, THERMAL), (law, (*THERMAL, "E", "nu", "theta_ref"))):

        def vector(parameters: Parameters, given: Law | None = given) -> np.ndarray:
            c = heat_conditions(parameters)
            c = at_constant_stress(c, law_of(parameters)) if given is not None else c
            return np.array([c.kappa, c.c0, *(value for name in ("air", "clamp") for value in c.films[name])])

        rates = condition_rates(POINT, names, given)
        rows = np.array([rates.kappa, rates.c0, *(row for name in ("air", "clamp") for row in rates.films[name])])
        for k, name in enumerate(names):
            expected = differences(lambda h, name=name: vector(moved(name, h)), step_of(name))
            assert rows[:, k] == pytest.approx(expected, rel=1e-8, abs=1e-8), name
        assert np.all(rows[:, len(names) :] == 0.0)
        assert (rows[1, names.index("alpha_exp")] > 0.0) == (given is not None)
    with pytest.raises(StudyError, match="Kappa"):
        condition_rates(POINT, ("Kappa",))


def test_rates_of_facet_sets() -> None:
    rates = condition_rates(POINT, THERMAL).on_sets(("air", "clamp_lower", "clamp_upper"), ("clamp_upper",))
    assert set(rates.films) == {"air", "clamp_lower", "clamp_upper"}
    assert rates.films["clamp_lower"][0][THERMAL.index("alpha_clamp")] == 1.0
    assert not np.any(rates.films["clamp_upper"])


def test_steady_state(body: Body) -> None:
    rest = thermal_geometry(body, np.zeros((body.mesh.n_nodes, 3)))
    theta = steady_temperature(body, rest, heat_conditions(POINT))
    rates = steady_rates(body, rest, heat_conditions(POINT), theta, condition_rates(POINT, THERMAL))
    felt = ("kappa", "alpha_air", "alpha_clamp", "theta_air", "theta_clamp")
    assert np.all(rates[:, [THERMAL.index(name) for name in THERMAL if name not in felt]] == 0.0)
    plain = [lambda h, name=name: steady_temperature(body, rest, heat_conditions(moved(name, h))) for name in felt]
    check_columns(
        steady_rates(body, rest, heat_conditions(POINT), theta, condition_rates(POINT, felt)), plain, [wide_step_of(n) for n in felt]
    )


def test_steady_state_without_exchange(body: Body) -> None:
    """The jaw temperature is the temperature; by a film coefficient there is no derivative."""
    rest, conditions = thermal_geometry(body, np.zeros((body.mesh.n_nodes, 3))), heat_conditions(ADIABATIC)
    theta = steady_temperature(body, rest, conditions)
    rates = steady_rates(body, rest, conditions, theta, condition_rates(ADIABATIC, ("kappa", "theta_clamp")))
    assert np.all(rates[:, 1] == 1.0) and np.all(np.delete(rates, 1, axis=1) == 0.0)
    with pytest.raises(NumericsError, match="alpha_air"):
        steady_rates(body, rest, conditions, theta, condition_rates(ADIABATIC, ("alpha_air",)))


class Sources:
    """An increment of all points, some of which do not flow, with rates of everything along directions named by parameters."""

    def __init__(self, body: Body, names: tuple[str, ...], model: int, closed_form: bool) -> None:
        self.body, self.names, self.model, self.closed_form = body, names, model, closed_form
        random, shape = np.random.default_rng(5), (body.mesh.n_elements, 8)
        alpha, accumulated = random.uniform(0.0, 0.05, shape), random.uniform(0.0, 0.05, shape)
        flow = random.uniform(0.003, 0.01, shape) * (random.uniform(size=shape) > 0.3)
        self.ends = [PointStates(random.uniform(0.9, 1.2, shape), alpha + k * 0.8 * flow, accumulated + k * flow) for k in (0, 1)]
        self.theta = random.uniform(290.0, 320.0, body.mesh.n_nodes)
        unit = np.zeros(padded(len(names)))
        unit[: len(names)] = [1.0 / param(name).scale for name in names]
        self.rates = [PointStateRates(*(0.05 * random.normal(size=(*n, len(unit))) * unit for n in (shape, (*shape, 11)))) for _ in (0, 1)]
        self.rates[1].state[flow == 0.0, LAMBDA] = self.rates[0].state[flow == 0.0, LAMBDA]
        self.theta_rates = 100.0 * random.normal(size=(body.mesh.n_nodes, len(unit))) * unit

    def law(self, parameters: Parameters) -> Law:
        return law_of(parameters, self.model, closed_form=self.closed_form)

    def along(self) -> SourceLaw:
        law = self.law(POINT)
        return source_law(law, directions(POINT, self.names, law))

    def ends_at(self, k: int, s: float) -> list[PointStates]:
        """The points where direction k has gone by s."""
        return [
            PointStates(
                *(x + s * y for x, y in zip(e[:3], (r.dilatation[..., k], r.state[:, :, ALPHA, k], r.state[:, :, LAMBDA, k]), strict=True))
            )
            for e, r in zip(self.ends, self.rates, strict=True)
        ]

    def heat(self, k: int, s: float, *, frozen: bool = False) -> np.ndarray:
        """Heat where direction k has gone by s."""
        ends, out = self.ends if frozen else self.ends_at(k, s), np.zeros(self.body.mesh.n_nodes)
        theta = self.theta + s * self.theta_rates[:, k]
        heat_of_increment(self.body.data, ends[0], ends[1], theta, self.law(moved(self.names[k], s)), out)
        return out


@pytest.mark.parametrize(("model", "closed_form"), [(1, True), (2, True), (2, False)])
def test_heat_sources(body: Body, model: int, closed_form: bool) -> None:
    sources = Sources(body, LAW, model, closed_form)
    moving, frozen = (np.zeros_like(sources.theta_rates) for _ in range(2))
    temperature = ((sources.theta, sources.theta_rates),) * 2
    slopes = source_slopes(body.data, tuple(sources.ends), (sources.theta, sources.theta), sources.along())
    heat_source_rates(body.data, slopes, tuple(sources.rates), temperature, sources.along(), moving)
    frozen_source_rates(body.data, increment_between(*sources.ends), temperature, sources.along(), frozen)
    steps = [step_of(name) for name in LAW]
    check_columns(moving, [lambda s, k=k: sources.heat(k, s) for k in range(len(LAW))], steps)
    check_columns(frozen, [lambda s, k=k: sources.heat(k, s, frozen=True) for k in range(len(LAW))], steps)
    for k, h in enumerate(steps):
        check_order(lambda s, k=k: sources.heat(k, s), moving[:, k], 8.0 * h)
    assert np.abs(moving - frozen).max(axis=0)[: len(LAW)].min() > 0.0


class Step:
    """A step of a body that moves at both ends, along directions of which each has a parameter, a motion, a start and a source."""

    def __init__(self, body: Body, scheme: str, names: tuple[str, ...] = THERMAL, *, moving: bool = True) -> None:
        self.body, self.scheme, self.names, self.moving = body, scheme, names, moving
        random, n = np.random.default_rng(11), body.mesh.n_nodes
        unit = np.zeros(padded(len(names)))
        unit[: len(names)] = [1.0 / param(name).scale for name in names]
        self.u = [deformation(body, stretch) for stretch in (0.2, 0.35)]
        self.u_rates = [0.3 * moving * random.normal(size=(n, 3, len(unit))) * unit for _ in (0, 1)]
        self.theta, self.heat = random.uniform(290.0, 320.0, n), random.uniform(0.0, 5.0, n)
        self.theta_rates, self.heat_rates = (c * random.normal(size=(n, len(unit))) * unit for c in (20.0, 5.0))

    def at(self, k: int, s: float) -> HeatStep:
        """The step where direction k has gone by s."""
        ends = [thermal_geometry(self.body, u + s * rates[:, :, k]) for u, rates in zip(self.u, self.u_rates, strict=True)]
        conditions, geometry = heat_conditions(moved(self.names[k], s)), ends[0].mean_with(ends[1])
        theta, heat = self.theta + s * self.theta_rates[:, k], self.heat + s * self.heat_rates[:, k]
        return heat_step(self.body, geometry, conditions, theta, heat, (0.8, self.scheme))

    def rates(self) -> np.ndarray:
        motion = (self.u[0], self.u_rates[0]), (self.u[1], self.u_rates[1])
        conditions = condition_rates(POINT, self.names)
        return heat_step_rates(self.body, self.at(0, 0.0), self.theta_rates, self.heat_rates, conditions, motion if self.moving else None)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("moving", [True, False])
def test_step(body: Body, scheme: str, moving: bool) -> None:
    step = Step(body, scheme, moving=moving)
    check_columns(step.rates(), [lambda s, k=k: step.at(k, s).theta for k in range(len(THERMAL))], [step_of(n) for n in THERMAL])


@pytest.mark.parametrize("scheme", SCHEMES)
def test_step_has_a_remainder_of_order_2(body: Body, scheme: str) -> None:
    step = Step(body, scheme)
    for k, name in enumerate(THERMAL):
        check_order(lambda s, k=k: step.at(k, s).theta, step.rates()[:, k], step_of(name))


def test_step_with_more_directions_than_lanes(body: Body) -> None:
    """Directions do not see each other: 20 of them in 24 columns, and the motion alone."""
    many = Step(body, "sdirk2", (*THERMAL, *THERMAL, "kappa", "E", "c0", "nu"))
    check_columns(many.rates(), [lambda s, k=k: many.at(k, s).theta for k in range(20)], [step_of(name) for name in many.names])


def test_motion_that_is_rigid_changes_nothing(body: Body) -> None:
    """A rotation of the body alone leaves conduction and films as they are."""
    step = Step(body, "sdirk2", ("E",))
    axis = np.array([[0.0, -0.3, 0.5], [0.3, 0.0, -0.2], [-0.5, 0.2, 0.0]])
    still = np.zeros_like(step.theta_rates)
    spin = []
    for u in step.u:
        rates = np.zeros_like(step.u_rates[0])
        rates[:, :, 0] = (body.mesh.nodes + u) @ axis.T
        spin.append((u, rates))
    solved, none = step.at(0, 0.0), condition_rates(POINT, ("E",))
    assert np.abs(heat_step_rates(body, solved, still, still, none, (spin[0], spin[1]))).max() < 1e-11
    assert np.all(heat_step_rates(body, solved, still, still, none, None) == 0.0)


def synthetic(body: Body, n: int) -> History:
    """A mechanical history with everything in it that a heat run takes: flow, then none, uneven steps."""
    random, shape = np.random.default_rng(2), (body.mesh.n_elements, 8)
    grown = random.uniform(0.0, 0.01, shape)
    time = np.cumsum(random.uniform(0.5, 1.5, n + 1))
    flow = np.minimum(np.arange(n + 1), n - 2)
    points = tuple(PointStates(random.uniform(0.99, 1.01, shape), 0.8 * k * grown, k * grown) for k in flow)
    u = np.array([deformation(body, 0.3 * k / n) for k in range(n + 1)])
    none = np.zeros(n + 1)
    return History(time, u, np.zeros((n + 1, body.mesh.n_nodes)), none, none, none, none, (), points)


def collected(problem: HeatProblem, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    times, theta, rates = [], [], []

    def collect(n: int, temperature: np.ndarray, temperature_rates: np.ndarray) -> None:
        times.append(n)
        theta.append(temperature.copy())
        rates.append(temperature_rates.copy())

    heat_run_rates(problem, POINT, names, collect)
    assert times == list(range(len(problem.time)))
    return np.array(theta), np.array(rates)


@pytest.mark.parametrize("coupling", ["one-way", "full"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_heat_run(body: Body, coupling: str, scheme: str) -> None:
    names = (*THERMAL, "E", "M_y0", "H_exp", "theta_ref")
    problem = heat_problem(body, synthetic(body, 6), MarchSettings(coupling=coupling, heat_scheme=scheme))
    theta, rates = collected(problem, names)
    assert np.array_equal(theta, heat_run(problem, POINT))
    felt = [k for k, name in enumerate(names) if name != "theta_ref" or coupling == "one-way"]
    plain = [lambda s, name=names[k]: heat_run(problem, moved(name, s)) for k in felt]
    for k, function in zip(felt, plain, strict=True):
        expected = differences(function, wide_step_of(names[k]))
        assert rates[..., k] == pytest.approx(expected, rel=0.0, abs=1e-7 * np.abs(expected).max()), names[k]
    assert np.all(np.delete(rates, felt, axis=2) == 0.0)


def test_heat_run_with_a_film_of_its_own(body: Body) -> None:
    """A set with a given film does not follow the parameters of the films."""
    problem = heat_problem(body, synthetic(body, 3), MarchSettings(films={"air": (40.0, 310.0)}))
    _, rates = collected(problem, ("alpha_air", "theta_air", "theta_clamp"))
    assert np.all(rates[..., :2] == 0.0)
    expected = differences(lambda s: heat_run(problem, moved("theta_clamp", s)), 1e-2)
    assert rates[..., 2] == pytest.approx(expected, rel=0.0, abs=1e-7)
    assert np.abs(heat_run(problem, POINT) - heat_run(replace(problem, settings=MarchSettings()), POINT)).max() > 0.1


def test_product_for_many_directions(body: Body) -> None:
    p, x = body.thermal, RANDOM.normal(size=(body.mesh.n_nodes, 24))
    y = multiply_directions(p.row, p.column, body.capacity, x)
    columns = [multiply_symmetric(p.row, p.column, body.capacity, np.ascontiguousarray(c)) for c in x.T]
    assert y == pytest.approx(np.stack(columns, axis=1), rel=1e-12, abs=1e-14)


def test_heat_problem_keeps_the_geometry_of_every_step(body: Body) -> None:
    """Of films only the non-zeros are kept, and nothing is lost."""
    history = synthetic(body, 4)
    problem = heat_problem(body, history, MarchSettings())
    for n in range(4):
        expected = thermal_geometry(body, history.u[n]).mean_with(thermal_geometry(body, history.u[n + 1]))
        kept = problem.geometry(n)
        assert np.array_equal(kept.conduction, expected.conduction)
        for name in ("air", "clamp"):
            assert np.array_equal(kept.film[name], expected.film[name])
            assert np.array_equal(kept.film_area[name], expected.film_area[name])


@pytest.mark.parametrize("used", [1, 3, 7])
def test_products_of_few_columns_are_those_of_all(used: int) -> None:
    """Columns that vanish cost nothing; what they are spared changes no other."""
    body = tension_body(bar_mesh((2, 3, 2), (2.0, 4.0, 1.5), distortion=0.1))
    p, x = body.thermal, np.zeros((body.mesh.n_nodes, 8))
    x[:, RANDOM.permutation(8)[:used]] = RANDOM.normal(size=(len(x), used))
    expected = multiply_directions(p.row, p.column, body.capacity, x)
    assert np.allclose(multiply_some(body, body.capacity, x), expected, rtol=1e-13, atol=1e-13 * np.abs(expected).max())


def test_nodal_heat_of_one_density_and_of_several() -> None:
    """A constant density leaves its volume behind; columns are independent of each other."""
    body = tension_body(bar_mesh((2, 3, 2), (2.0, 4.0, 1.5), distortion=0.1))
    density = RANDOM.normal(size=(body.mesh.n_elements, 8, 3))
    found = nodal_heat(body, density)
    assert np.allclose(found[:, 1], nodal_heat(body, density[:, :, 1]))
    assert np.allclose(found.sum(axis=0), np.einsum("eq,eqk->k", body.data.volume, density))
    first = np.einsum("qa,eq,eqk->eak", body.data.shape, body.data.volume, density)
    nodal = np.zeros_like(found)
    np.add.at(nodal, body.mesh.hexes, first)
    assert np.allclose(found, nodal, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("distortion", [0.0, 0.1])
def test_points_of_the_plane_take_the_heat_of_those_above_one_another(distortion: float) -> None:
    """A density that is the same through the thickness makes the same nodal heat; points that are not above one another stand alone."""
    body = tension_body(bar_mesh((2, 3, 2), (2.0, 4.0, 1.5), distortion=distortion))
    (x, y), plane = body.points, body.plane
    assert len(plane.x) > x.size // 4 if distortion else len(plane.x) == x.size // 4
    density = np.cos(0.3 * x) * np.exp(0.2 * y)
    found = plane.heat @ (np.cos(0.3 * plane.x) * np.exp(0.2 * plane.y))
    assert np.allclose(found, nodal_heat(body, density), rtol=1e-12, atol=1e-14)
    assert y.min() == pytest.approx(-y.max(), abs=0.2) and plane.y.min() < 0.0 < plane.y.max()
    if not distortion:
        assert np.allclose(plane.across, plane.x / 2.0, rtol=1e-12, atol=0.0)


def test_how_far_across_a_point_is_goes_by_the_width_at_its_height() -> None:
    """To the straight edges of a mesh, also beside a hole, and the same where the whole width is meshed."""
    specimen = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
    plane = tension_body(dogbone_mesh(specimen, 2, 60, 1)).plane
    here = half_width(specimen, plane.y)
    parallel = np.abs(plane.y) < 47.0
    assert np.allclose(plane.across[parallel], plane.x[parallel] / 12.5, rtol=1e-12, atol=0.0)
    assert np.abs(plane.across - plane.x / here).max() < 0.005 and here.max() == pytest.approx(17.5)
    for full in (False, True):
        beside = tension_body(plate_with_hole_mesh(specimen, 4.0, MeshSize(n_x=4, n_y=12, n_z=1), full=full)).plane
        assert np.allclose(beside.across, beside.x / 12.5, rtol=1e-12, atol=0.0) and (beside.across.min() < 0.0) == full
