"""A body driven by the elongation between two of its sections: the same run as by its end, exact derivatives, beyond the load maximum."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from small_bodies import ADIABATIC, NOMINAL, SPECIMEN
from test_newton import necked, run

from thermofit.body.body import Body, tension_body
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.sensitivity.march import Sensitivities, StepRates
from thermofit.body.solve.gauge import GaugeLoading, march_between
from thermofit.body.solve.history import History, MarchSettings, Watch
from thermofit.body.solve.march import Loading, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, load_modes
from thermofit.observe.observation import face_operator

TIME = np.array([0.0, 3, 5, 7, 10, 14, 20, 30, 32, 34, 36, 40, 50, 52, 56])
END = np.interp(TIME, [0.0, 3, 30, 36, 50, 56], [0.0, 0.0, 5.0, 4.6, 8.0, 7.4])
"""Loading, a partial unloading, loading and unloading."""
EXACT = MarchSettings(newton=NewtonSettings(tolerance=2e-9), coupling_tolerance=1e-7)


@cache
def dogbone() -> tuple[Body, np.ndarray]:
    """The reference specimen on few elements, and the weights of the elongation between y = -20 and 20 mm."""
    body = tension_body(dogbone_mesh(SPECIMEN, 2, 12, 1), control="displacement")
    at = face_operator(body.mesh, np.array([[0.0, -20.0], [0.0, 20.0]]))
    weights = np.bincount(at.node.ravel(), (at.weight * np.array([[-1.0], [1.0]])).ravel(), minlength=body.mesh.n_nodes)
    return body, weights


@cache
def by_end() -> History:
    return march(dogbone()[0], NOMINAL, Loading(TIME, END, "displacement", from_rest=True), TIME, EXACT)


def between(elongation: np.ndarray) -> GaugeLoading:
    return GaugeLoading(TIME, elongation, "displacement", True, gauge=dogbone()[1])


def driven(parameters: Parameters, watch: Watch | None = None) -> History:
    e = by_end().u[:, :, 1] @ dogbone()[1]
    return march_between(dogbone()[0], parameters, between(e - e[0]), TIME, EXACT, watch or Watch())


def test_the_run_is_that_of_the_end_which_makes_the_elongation() -> None:
    found, known = driven(NOMINAL), by_end()
    assert found.u == pytest.approx(known.u, abs=2e-6)
    assert found.force == pytest.approx(known.force, abs=0.02)
    assert found.theta == pytest.approx(known.theta, abs=2e-5)


@pytest.mark.parametrize("coupling", ["full", "one-way"])
def test_derivatives_are_of_second_order(coupling: str) -> None:
    """Five parameters at once, along a random direction: what the derivative misses falls with the square of the step."""
    names, body = ("E", "M_y0", "H_exp", "alpha_exp", "c0"), dogbone()[0]
    settings = MarchSettings(newton=EXACT.newton, coupling_tolerance=EXACT.coupling_tolerance, coupling=coupling)
    e = by_end().u[:, :, 1] @ dogbone()[1]
    loading, found = between(e - e[0]), {}

    def collect(n: int, at: StepRates) -> None:
        found[n] = (at.force.copy(), at.u.copy(), at.theta.copy())

    along = np.array([0.7, -1.0, 0.6, 0.8, 0.8]) * np.array([NOMINAL[n] for n in names])
    here = march_between(body, NOMINAL, loading, TIME, settings, Watch(sensitivities=Sensitivities(names, collect, tolerance=1e-5)))
    missed = []
    for step in (4e-3, 2e-3):
        moved = NOMINAL.replace(**{n: NOMINAL[n] + step * d for n, d in zip(names, along, strict=True)})
        there = march_between(body, moved, loading, TIME, settings)
        left = [
            np.linalg.norm(new - old - step * np.array([found[n][k] @ along for n in range(len(TIME))]))
            for k, (new, old) in enumerate(((there.force, here.force), (there.u, here.u), (there.theta, here.theta)))
        ]
        missed.append(left)
    order = np.log2(np.array(missed[0]) / np.array(missed[1]))
    assert np.all(order > 1.8), order
    assert found[5][1].shape == (body.mesh.n_nodes, 3, 5)


def test_a_run_is_differentiated_along_modes_of_its_elongation() -> None:
    """Second-order Taylor test beside a Param of the material. One mode lies before the unloading, where the specimen flows: the force is
    wrong until it flows again. The other is too small a stretch while it is elastic: wrong there alone."""
    names, body = ("M_y0", *load_modes(2)), dogbone()[0]
    modes = np.zeros((len(TIME), 2))
    modes[7], modes[9] = (2e-3, 0.0), (0.0, -1e-3)
    e, found = by_end().u[:, :, 1] @ dogbone()[1], {}

    def moved(by: np.ndarray, watch: Watch | None = None) -> History:
        loading = GaugeLoading(TIME, e - e[0] + modes @ by[1:], "displacement", True, modes=modes, gauge=dogbone()[1])
        return march_between(body, NOMINAL.replace(M_y0=NOMINAL["M_y0"] + by[0]), loading, TIME, EXACT, watch or Watch())

    def collect(n: int, at: StepRates) -> None:
        found[n] = (at.force.copy(), at.u.copy(), at.theta.copy())

    here = moved(np.zeros(3), Watch(sensitivities=Sensitivities(names, collect, tolerance=1e-5)))
    along = np.array([0.5, 1.0, 0.7])
    missed = []
    for step in (0.2, 0.1):
        there = moved(step * along)
        changes = ((there.force, here.force), (there.u, here.u), (there.theta, here.theta))
        slopes = [np.array([found[n][k] @ along for n in range(len(TIME))]) for k in range(3)]
        missed.append([np.linalg.norm(new - old - step * slope) for (new, old), slope in zip(changes, slopes, strict=True)])
    order = np.log2(np.array(missed[0]) / np.array(missed[1]))
    assert np.all(order > 1.8), order
    force = np.array([found[n][0] for n in range(len(TIME))])
    flowing = np.abs(force[7, 1])
    assert np.abs(force[8:10, 1]).min() > 20.0 * flowing and np.abs(force[12:, 1]).max() < 2.0 * flowing
    assert np.abs(force[9, 2]) > 40.0 and np.abs(np.delete(force[:, 2], 9)).max() < 0.05 * np.abs(force[9, 2])


SEEN = {"u": 1e-3, "theta": 1e-2, "force": 4.0}
"""Noise of what is seen: mm, K, N."""


def usual(scatter: float = 0.0) -> tuple[np.ndarray, GaugeLoading]:
    """The same test in steps of half a second, as a study would have them; `scatter`: standard deviation mm of measured sections."""
    time = np.linspace(0.0, 56.0, 113)
    e = np.interp(time, TIME, by_end().u[:, :, 1] @ dogbone()[1])
    e += scatter * np.random.default_rng(1).normal(size=len(e)) * (time > 0.0)
    return time, GaugeLoading(time, e - e[0], "displacement", True, gauge=dogbone()[1])


def differentiated(loading: GaugeLoading, tolerance: float) -> tuple[History, dict[str, np.ndarray]]:
    """The run, and the derivatives (n_t, ..., 5) of every field by five parameters."""
    kept: list[StepRates] = []

    def collect(n: int, at: StepRates) -> None:
        kept.append(StepRates(at.u.copy(), at.theta.copy(), at.force.copy()))

    asked = Sensitivities(("E", "M_y0", "H_exp", "alpha_exp", "c0"), collect, tolerance=tolerance)
    run = march_between(dogbone()[0], NOMINAL, loading, loading.time, watch=Watch(sensitivities=asked))
    return run, {field: np.array([getattr(at, field) for at in kept]) for field in SEEN}


def test_one_sweep_differentiates_most_steps() -> None:
    """Sections cost no second sweep: the direction of the end asks for none. Each step took two before. As loosely as a study asks,
    derivatives of every field are those of a tight tolerance to 1e-3 of their largest."""
    _, loading = usual()
    (run, loose), (_, tight) = (differentiated(loading, tolerance) for tolerance in (0.02, 1e-6))
    assert run.counts["sensitivity_sweeps"] <= 1.4 * run.counts["steps"]
    for field, known in tight.items():
        axes = tuple(range(known.ndim - 1))
        assert np.all(np.abs(loose[field] - known).max(axis=axes) <= 1e-3 * np.abs(known).max(axis=axes)), field


def test_derivatives_between_sections_that_scatter_are_exact_beside_the_noise() -> None:
    """Sections that scatter by a micrometre: all that is seen together, in units of its noise, to 1e-3 by every parameter. The force, which
    c0 moves by no more than 15 N where it is twice as large, to 5 % by that."""
    _, loading = usual(1e-3)
    (run, loose), (_, tight) = (differentiated(loading, tolerance) for tolerance in (0.02, 1e-6))
    assert run.counts["sensitivity_sweeps"] <= 1.4 * run.counts["steps"]
    off, known = (
        sum((of(f) ** 2).reshape(-1, 5).sum(axis=0) for f in SEEN) ** 0.5
        for of in (lambda f: (loose[f] - tight[f]) / SEEN[f], lambda f: tight[f] / SEEN[f])
    )
    assert np.all(off <= 1e-3 * known), off / known
    by_capacity = [of["force"][..., -1] for of in (loose, tight)]
    assert np.abs(by_capacity[1]).max() * NOMINAL["c0"] < 20.0
    assert np.linalg.norm(by_capacity[0] - by_capacity[1]) <= 0.05 * np.linalg.norm(by_capacity[1])


def test_sections_are_placed_to_a_fiftieth_of_the_noise() -> None:
    """Three parts in a thousand of the tolerance, as a share of the length: not more exactly, for that would cost further equilibria."""
    (time, loading), weights = usual(), dogbone()[1]
    length, runs = float(np.ptp(dogbone()[0].mesh.nodes[:, 1])), []
    for tolerance, least, most in ((1e-5, 3e-9, 3e-8), (1e-6, 0.0, 3e-9), (1e-9, 0.0, 1e-9)):
        run = march_between(dogbone()[0], NOMINAL, loading, time, MarchSettings(newton=NewtonSettings(tolerance=tolerance)))
        e = run.u[:, :, 1] @ weights
        assert least < np.abs(e - e[0] - loading.value).max() / length <= most
        runs.append(run)
    for field, noise in SEEN.items():
        assert np.abs(getattr(runs[0], field) - getattr(runs[-1], field)).max() <= 0.02 * noise, field


def test_sections_beside_the_neck_lead_beyond_the_load_maximum() -> None:
    """A necked bar of 30 mm between sections at 5 and 25 mm: the force falls as under its end."""
    known = run(necked("displacement"), [0.0, 1.0], [0.0, 6.0], steps=40)
    body = necked("displacement")
    y = body.mesh.nodes[:, 1]
    weights = np.isclose(y, 25.0) / np.isclose(y, 25.0).sum() - np.isclose(y, 5.0) / np.isclose(y, 5.0).sum()
    e = known.u[:, :, 1] @ weights
    found = march_between(body, ADIABATIC, GaugeLoading(known.time, e - e[0], "displacement", False, gauge=weights), known.time)
    assert found.force[-1] < 0.95 * found.force.max()
    assert found.force == pytest.approx(known.force, abs=1e-4 * known.force.max())


def test_an_elongation_that_no_end_makes_says_so() -> None:
    """Weights of nothing: the elongation does not follow the end."""
    body, weights = dogbone()
    nothing = GaugeLoading(TIME, 0.01 * TIME, "displacement", True, gauge=0.0 * weights)
    with pytest.raises(NumericsError, match="sections"):
        march_between(body, NOMINAL, nothing, TIME, MarchSettings(max_cuts=0))
