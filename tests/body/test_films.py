"""Films on named facet sets, solution steps between recorded times, and what the march refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from small_bodies import NOMINAL, bar_mesh

from thermofit.body.body import Body, tension_body
from thermofit.body.heat.films import conditions_of
from thermofit.body.solve.loading import solution_times
from thermofit.body.solve.march import History, Loading, MarchSettings, Watch, march
from thermofit.core.errors import StudyError

AREA, LENGTH = 2.0 * 1.0, 20.0


def body(**sets: tuple[str, ...]) -> Body:
    """Bar with facet sets of any name on its faces."""
    mesh = bar_mesh((1, 4, 1), (2.0, LENGTH, 1.0))
    facets = {name: bar_mesh((1, 4, 1), (2.0, LENGTH, 1.0), air=faces).facets["air"] for name, faces in sets.items()}
    return tension_body(type(mesh)(mesh.nodes, mesh.hexes, facets, mesh.node_sets), symmetry=1.0)


def rest(what: Body, **settings: Any) -> History:
    return march(what, NOMINAL, Loading(np.array([0.0, 1.0]), np.zeros(2)), np.array([0.0, 1.0]), MarchSettings(**settings))


def test_parts_of_a_film_are_that_film() -> None:
    """Jaws as two facet sets: the same as one set of both; the balance names them apart."""
    one = rest(body(air=("x1", "z1"), clamp=("y0", "y1")))
    two = rest(body(air=("x1", "z1"), clamp_lower=("y0",), clamp_upper=("y1",)))
    assert two.theta == pytest.approx(one.theta, abs=1e-9)
    assert set(two.balance[0].outflow) == {"air", "clamp_lower", "clamp_upper"}


def test_own_medium_of_a_facet_set() -> None:
    """Lower jaw at 290 K, upper at 310 K, no air: linear temperature, film and conduction in series."""
    films = {"clamp_lower": (236.3, 290.0), "clamp_upper": (500.0, 310.0)}
    what = body(clamp_lower=("y0",), clamp_upper=("y1",))
    history = march(
        what, NOMINAL.replace(alpha_exp=0.0), Loading(np.array([0.0, 1.0]), np.zeros(2)), np.array([0.0, 1.0]), MarchSettings(films=films)
    )
    flux = 20.0 / (1e3 / 236.3 + LENGTH / NOMINAL["kappa"] + 1e3 / 500.0)
    expected = 290.0 + flux * (1e3 / 236.3 + what.mesh.nodes[:, 1] / NOMINAL["kappa"])
    assert history.theta[-1] == pytest.approx(expected, abs=1e-8)
    assert history.balance[0].outflow["clamp_lower"] == pytest.approx(flux * AREA, rel=1e-8)
    assert history.balance[0].outflow["clamp_upper"] == pytest.approx(-flux * AREA, rel=1e-8)


@pytest.mark.parametrize(
    ("sets", "films", "said"),
    [
        ({"water": ("x1",)}, {}, "facet set 'water': no film"),
        ({"air": ("x1",)}, {"aire": (1.0, 300.0)}, "'aire' is no facet set"),
        ({"air": ("x1",)}, {"air": (-1.0, 300.0)}, "must not be negative"),
        ({"air_front": ("x1",)}, {"air_front": (0.0, 300.0)}, "initial temperature"),
    ],
)
def test_films_that_do_not_fit_the_mesh_are_told(sets: dict[str, Any], films: dict[str, Any], said: str) -> None:
    with pytest.raises(StudyError, match=said):
        conditions_of(body(**sets), NOMINAL, films)


def test_negative_beta_is_refused_by_every_run() -> None:
    """With model 1 and model 2, before anything is solved."""
    for model in (1, 2):
        with pytest.raises(StudyError, match=r"beta = -0\.1: expected at least 0"):
            march(
                body(clamp=("y0",)),
                NOMINAL.replace(beta=-0.1),
                Loading(np.array([0.0, 1.0]), np.zeros(2)),
                np.array([0.0, 1.0]),
                MarchSettings(model=model),
            )


def test_solution_times() -> None:
    assert solution_times(1.0, 2.0, float("inf")) == pytest.approx([2.0])
    assert solution_times(1.0, 2.0, 0.4) == pytest.approx([1.0 + 1.0 / 3.0, 1.0 + 2.0 / 3.0, 2.0])
    assert solution_times(0.0, 0.3, 0.1) == pytest.approx([0.1, 0.2, 0.3])
    assert solution_times(0.0, 0.3, 0.1)[-1] == 0.3


def test_solution_steps_between_recorded_times() -> None:
    """The same as recording all of them and leaving some out; the balance of a recorded interval is the sum."""
    what = body(air=("x1",), clamp=("y0", "y1"))
    loading = Loading(np.array([0.0, 1.0, 2.0]), np.array([0.0, 170.0 * AREA, 0.0]))
    seen: list[int] = []
    fine = march(what, NOMINAL, loading, np.linspace(0.0, 2.0, 41), MarchSettings(keep_energy=True))
    some = march(what, NOMINAL, loading, np.linspace(0.0, 2.0, 11), MarchSettings(max_step=0.05, keep_energy=True), Watch(step=seen.append))
    assert np.array_equal(some.time, np.linspace(0.0, 2.0, 11)) and seen == list(range(1, 11))
    assert some.u == pytest.approx(fine.u[::4], abs=1e-9) and some.theta == pytest.approx(fine.theta[::4], abs=1e-6)
    for name in ("work", "dissipated", "thermoelastic", "stored", "internal", "first_law_defect"):
        assert some.total(name) == pytest.approx(fine.total(name), rel=1e-5, abs=1e-6)
    assert some.counts["steps"] == 10 and some.counts["newton_iterations"] == fine.counts["newton_iterations"]
