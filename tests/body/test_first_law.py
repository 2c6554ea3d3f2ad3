"""First law of the whole specimen: change of internal energy = work of the load + heat that came in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from reference import reference_table
from small_bodies import LOADING, NOMINAL, SPECIMEN, bar_mesh, run_pass

from thermofit.body.body import Body, tension_body
from thermofit.body.element.energy import internal_energy_of
from thermofit.body.element.hex8 import element_data
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.body.solve.newton import virgin_state
from thermofit.law.page import internal_energy, law_of
from thermofit.point.state import ALPHA, LAMBDA

Told = Callable[[str, object], None]


@pytest.fixture(scope="module")
def dogbone() -> Body:
    return tension_body(dogbone_mesh(SPECIMEN, 2, 12, 1))


def defect(history: History) -> float:
    """First-law defect over the work, steps counted by their size."""
    return sum(abs(step.first_law_defect) for step in history.balance) / history.total("work")


@pytest.mark.parametrize("f_bar", [True, False])
def test_internal_energy_of_a_body_is_that_of_its_points(f_bar: bool) -> None:
    """Random plastic states of a distorted block against the law at every point, F_bar written out in numpy."""
    mesh, law = bar_mesh((2, 2, 2), (2.0, 3.0, 1.5), distortion=0.2), law_of(NOMINAL)
    data, random = element_data(mesh.nodes, mesh.hexes, f_bar=f_bar), np.random.default_rng(4)
    u = mesh.nodes * np.array([-0.01, 0.03, -0.015]) + 0.01 * random.uniform(-1.0, 1.0, mesh.nodes.shape)
    theta = random.uniform(290.0, 310.0, mesh.n_nodes)
    _, _, state, dilatation = run_pass(data, u, theta, virgin_state(8), law)
    assert state[:, :, LAMBDA].max() > 0.01
    total = 0.0
    for e in range(8):
        for q in range(8):
            f = np.eye(3) + u[mesh.hexes[e]].T @ data.gradient[e, q]
            f = f * (dilatation[e, q] / np.linalg.det(f)) ** (1.0 / 3.0)
            fe, j, s = f @ state[e, q, :9].reshape(3, 3), float(np.linalg.det(f)), state[e, q]
            at = float(data.shape[q] @ theta[mesh.hexes[e]])
            total += data.volume[e, q] * internal_energy(float(np.sum(fe * fe)), np.log(j), j, at, s[ALPHA], s[LAMBDA], law)
    assert internal_energy_of(data, u, theta, state, dilatation, law) == pytest.approx(total, rel=1e-11)


@pytest.mark.parametrize("model", [1, 2])
def test_first_law_over_the_measured_force_history(model: int, record_property: Told) -> None:
    """One step per row, as an identification has them: 2e-4 of the work (holds, unloading and cooling included)."""
    table = reference_table("force_history.csv")
    body = tension_body(dogbone_mesh(SPECIMEN, 3, 20, 1))
    history = march(
        body, NOMINAL, Loading(table["time_s"], table["force_N"]), table["time_s"], MarchSettings(model=model, keep_energy=True)
    )
    assert history.total("work") > 1e5
    assert sum(sum(step.outflow.values()) for step in history.balance) > 0.3 * history.total("work")
    record_property(f"first law over the measured history, model {model}, defect over the work (< 1e-4)", f"{defect(history):.1e}")
    assert defect(history) < 1e-4


@pytest.mark.parametrize("model", [1, 2])
def test_first_law_is_met_with_order_2_in_the_step(dogbone: Body, model: int, record_property: Told) -> None:
    """What remains is the trapezoid of the work where a step passes from elastic to plastic."""
    times = np.arange(0.0, 61.0)
    defects = []
    for longest in (1.0, 0.5, 0.25):
        history = march(dogbone, NOMINAL, LOADING, times, MarchSettings(model=model, max_step=longest, keep_energy=True))
        defects.append(defect(history))
        if longest < 0.4:
            assert defects[-1] < 2e-4
    orders = np.log2(np.array(defects[:-1]) / defects[1:])
    record_property(f"first law, model {model}, order in the step (2)", round(float(orders[-1]), 2))
    assert np.all(orders > 1.7), (defects, orders)


def test_first_law_of_an_elastic_cycle_and_of_a_hold(dogbone: Body) -> None:
    """No plastic flow: a hundredth of the permille of the largest work."""
    loading = Loading(np.array([0.0, 10.0, 20.0, 30.0]), np.array([0.0, 2400.0, 2400.0, 0.0]))
    history = march(dogbone, NOMINAL, loading, np.linspace(0.0, 30.0, 31), MarchSettings(coupling_tolerance=1e-7, keep_energy=True))
    largest = max(np.cumsum([step.work for step in history.balance]))
    assert history.largest_multiplier[-1] == 0.0 and largest > 100.0
    assert np.abs([step.first_law_defect for step in history.balance]).sum() < 1e-5 * largest


def test_one_way_coupling_meets_the_first_law_up_to_its_missing_expansion(dogbone: Body) -> None:
    history = march(dogbone, NOMINAL, LOADING, np.arange(0.0, 60.1, 0.25), MarchSettings(coupling="one-way", keep_energy=True))
    assert 1e-6 < defect(history) < 2e-3
