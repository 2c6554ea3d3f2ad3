"""A parameter of a yield surface comes back from the displacements of a virtual tension test, by its shoulders."""

from __future__ import annotations

import numpy as np
import pytest
from published_surfaces import AA2090_T3
from small_bodies import NOMINAL, SPECIMEN

from thermofit.body.body import tension_body
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.sensitivity.march import Sensitivities, StepRates
from thermofit.body.solve.march import Loading, MarchSettings, Watch, march
from thermofit.core.parameters import Parameters
from thermofit.core.slots import Slots

NOISE = 5e-4
"""mm"""
TIMES = np.linspace(0.0, 40.0, 17)
PULL = Loading(np.array([0.0, 40.0]), np.array([0.0, 6200.0]))
CASES = {
    "hosford": ({"hosford.a": 7.0}, {"hosford.a": 4.5}),
    "yld2004": (AA2090_T3, {"yld2004.c1_23": 0.92, "yld2004.c2_12": 1.1}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_recovers_what_was_planted(name: str) -> None:
    """Gauss-Newton on noisy displacements of the visible face, together with the initial yield limit: every parameter within four of its
    standard errors, which are a small part of where the fit began."""
    values, start = CASES[name]
    truth, settings = NOMINAL.replace(F=0.5, **values), MarchSettings(model=Slots(1, name))
    body = tension_body(dogbone_mesh(SPECIMEN, 3, 24, 1))
    face = np.flatnonzero(np.isclose(body.mesh.nodes[:, 2], body.mesh.nodes[:, 2].max()))
    names = ("M_y0", *start)

    def run(parameters: Parameters, asked: tuple[str, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
        found: list[np.ndarray] = []

        def collect(n: int, at: StepRates) -> None:
            found.append(np.array(at.u)[face][:, :2, : len(asked)])

        watch = Watch(sensitivities=Sensitivities(asked, collect)) if asked else Watch()
        u = march(body, parameters, PULL, TIMES, settings, watch).u[:, face][:, :, :2]
        return u, np.stack(found) if found else np.empty(0)

    clean, _ = run(truth)
    measured = clean + NOISE * np.random.default_rng(3).normal(size=clean.shape)
    here = truth.replace(**start, M_y0=1.01 * truth["M_y0"])
    for _ in range(6):
        u, rates = run(here, names)
        jacobian = rates.reshape(-1, len(names)) / NOISE
        step = np.linalg.lstsq(jacobian, (measured - u).ravel() / NOISE, rcond=None)[0]
        sigma = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
        here = here.replace(**{n: here[n] + float(d) for n, d in zip(names, step, strict=True)})
        if np.all(np.abs(step) < 0.1 * sigma):
            break
    u, _ = run(here)
    assert np.sqrt(np.mean(((u - measured) / NOISE) ** 2)) == pytest.approx(1.0, abs=0.03)
    for n, s in zip(names, sigma, strict=True):
        assert abs(here[n] - truth[n]) < 4.0 * s, (n, here[n], truth[n], s)
        assert n == "M_y0" or s < 0.5 * abs(start[n] - truth[n]), (n, s)
