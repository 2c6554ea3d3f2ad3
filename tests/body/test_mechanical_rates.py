"""Rates of loads and states of elements along parameters, through a history of three steps, against differences of the element pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from small_bodies import NOMINAL, bar_mesh, run_pass

from thermofit.body.element.hex8 import element_data
from thermofit.body.element.responses import responses
from thermofit.body.sensitivity.mechanical_rates import load_rates, update_rates
from thermofit.body.solve.newton import virgin_state
from thermofit.core.parameters import Parameters
from thermofit.law.composition import law_effects
from thermofit.law.page import law_in_step, law_of
from thermofit.law.page_rates import directions, padded
from thermofit.point.relative_rates import rows_of_response
from thermofit.point.state import LAMBDA, N_FULL

EFFECTS = {p.name: p.probe if p.probe is not None else p.neutral for e in law_effects() if e.slot != "dissipation" for p in e.params}
OF_EFFECTS = tuple(name for name, value in EFFECTS.items() if value != 0.0)
NAMES = ("E", "nu", "M_y0", "M_yinf", "H_exp", "H_lin", "F", "G", "H", "L", "M", "N", "alpha_exp", "theta_ref", *OF_EFFECTS)
BASE = NOMINAL.replace(H_lin=20.0, **EFFECTS)
"""Every effect of the law is on."""
MESH = bar_mesh((2, 2, 1), (2.0, 3.0, 1.0), distortion=0.3)
SCALE = np.array([BASE[name] for name in NAMES])


@dataclass(frozen=True)
class Path:
    """Displacements and temperatures of three steps, and how they change along every parameter (per unit of its scale)."""

    u: list[np.ndarray]
    u_rates: list[np.ndarray]
    theta: list[np.ndarray]
    theta_rates: list[np.ndarray]

    def moved(self, k: int, h: float) -> list[tuple[np.ndarray, np.ndarray]]:
        changed = zip(self.u, self.u_rates, self.theta, self.theta_rates, strict=True)
        return [(u + h * du[:, :, k], theta + h * dtheta[:, k]) for u, du, theta, dtheta in changed]


def path(step: float) -> Path:
    """Plastic flow in all points with strain increments of about `step`, the last one unloads a little."""
    random, n, p = np.random.default_rng(1), MESH.n_nodes, len(NAMES)
    gradients = [np.diag([-0.004, 0.012, -0.005]), np.array([[-0.02, 0.004, 0], [0.01, 0.03, 0], [0, 0.003, -0.02]]), None]
    gradients[2] = gradients[1] * 0.9
    start = gradients[0]
    gradients = [start, *(start + step / 0.02 * (g - start) for g in gradients[1:])]
    u = [MESH.nodes @ g.T + step * 0.05 * random.normal(size=(n, 3)) for g in gradients]
    theta = [297.0 + 5.0 * random.normal(size=n) for _ in u]
    return Path(u, [1e-3 * random.normal(size=(n, 3, p)) for _ in u], theta, [random.normal(size=(n, p)) for _ in u])


def differences(history: Path, base: Parameters, model: int, k: int, f_bar: bool) -> list[np.ndarray]:
    """Forces, states and J at the end of the path: central differences of order 4 along parameter k, per unit of its scale."""
    data = element_data(MESH.nodes, MESH.hexes, f_bar=f_bar)

    def end(h: float) -> list[np.ndarray]:
        law = law_in_step(law_of(base.replace(**{NAMES[k]: base[NAMES[k]] + h * SCALE[k]}), model), 2.0)
        state = virgin_state(MESH.n_elements, structure=True)
        for u, theta in history.moved(k, h):
            force, _, state, dilatation = run_pass(data, u, theta, state, law)
        return [force, state, dilatation]

    h = 2e-5
    near = [(a - b) / (2 * h) for a, b in zip(end(h), end(-h), strict=True)]
    far = [(a - b) / (4 * h) for a, b in zip(end(2 * h), end(-2 * h), strict=True)]
    return [(4.0 * a - b) / 3.0 for a, b in zip(near, far, strict=True)]


def rates(history: Path, base: Parameters, model: int, f_bar: bool) -> list[np.ndarray]:
    """The same by direct differentiation, all parameters at once; last axis m >= 14."""
    data = element_data(MESH.nodes, MESH.hexes, f_bar=f_bar)
    law, n_el, m = law_in_step(law_of(base, model), 2.0), MESH.n_elements, padded(len(NAMES))
    along = directions(base, NAMES, law)
    along = along._replace(numbers=along.numbers * np.append(SCALE, np.zeros(m - len(NAMES))))
    state, state_rates = virgin_state(n_el, structure=True), np.zeros((n_el, 8, N_FULL, m))
    filled = [(0, 0), (0, 0), (0, m - len(NAMES))]
    for u, du, theta, dtheta in zip(history.u, history.u_rates, history.theta, history.theta_rates, strict=True):
        u_rates, theta_rates = np.pad(du, filled), np.pad(dtheta, filled[1:])
        _, stiffness, new, _ = run_pass(data, u, theta, state, law, tangent=True)
        response = np.zeros((n_el, rows_of_response(along, law), 8))
        responses(data, (u, theta), (state, new), law, along, response)
        loads, forces, new_rates = np.zeros((n_el, 24, m)), np.zeros((n_el, 24, m)), np.full_like(state_rates, np.nan)
        dilatation = np.zeros((n_el, 8, m))
        load_rates(data, u, (state, new), law, along, response, state_rates, theta_rates, loads)
        rates_n = (u_rates, state_rates, theta_rates)
        update_rates(data, u, (state, new), law, along, response, rates_n, new_rates, dilatation, True, forces)
        by_stiffness = loads + np.einsum("eij,ejm->eim", stiffness, u_rates[MESH.hexes].reshape(n_el, 24, m))
        assert np.abs(by_stiffness - forces).max() < 2e-3 * np.abs(forces).max()  # the stiffness is but the symmetric part
        state, state_rates = new, new_rates
    assert np.all(state[:, :, LAMBDA] > 0.0)
    return [forces, state_rates, dilatation]


def errors(base: Parameters, model: int, f_bar: bool, step: float) -> np.ndarray:
    """Largest error of forces, states and J, relative to the largest rate, (n_parameters, 3)."""
    history = path(step)
    found = rates(history, base, model, f_bar)
    out = []
    for k in range(len(NAMES)):
        expected = differences(history, base, model, k, f_bar)
        out.append([np.abs(f[..., k] - e).max() / np.abs(e).max() for f, e in zip(found, expected, strict=True)])
    return np.array(out)


@pytest.mark.parametrize("model", [1, 2])
@pytest.mark.parametrize("f_bar", [True, False])
def test_rates_are_those_of_the_element_pass(model: int, f_bar: bool) -> None:
    """All parameters of the law, with Hill anisotropy, moving nodes and temperatures, through three steps of history."""
    worst = errors(BASE, model, f_bar, 0.02)
    assert np.all(worst < 2e-7), worst


def test_surplus_columns_stay_exactly_zero() -> None:
    assert all(not r[..., len(NAMES) :].any() for r in rates(path(0.02), BASE, 2, True))
