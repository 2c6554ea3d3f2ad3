"""What all directions of a differentiated step share: the responses of all points at its converged end."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from thermofit.core.jit import kernel
from thermofit.fem.element import ElementData
from thermofit.fem.element_lanes import element_kinematics
from thermofit.fem.element_stiffness import ELEMENT_ROWS
from thermofit.material.lanes_memory import lane_workspace, set_row
from thermofit.material.law import Law
from thermofit.material.law_rates import Directions, pressure_gradients, pressure_values, yield_gradients
from thermofit.material.point import ALPHA, LAMBDA
from thermofit.material.rates import (
    ALPHA_BY_ALPHA,
    ALPHA_BY_GAMMA,
    BY_ALPHA,
    BY_GAMMA,
    BY_LAMBDA,
    BY_THETA,
    GRADIENTS,
    K_LOG_J,
    K_THETA,
    PRESSURE,
    ROWS,
    responses_of_points,
)

_CHUNKS = 64
States = tuple[np.ndarray, np.ndarray]
"""States (n_el, 8, 11) before and after the step."""


def responses(
    data: ElementData, fields: tuple[np.ndarray, np.ndarray], states: States, law: Law, along: Directions, out: np.ndarray
) -> None:
    """Response of all points at the converged end of a step into out (n_el, 8, n_response); fields = (u (n_np, 3) mm, theta (n_np,) K)."""
    u, theta = fields
    before, after = (s.reshape(-1, s.shape[2]) for s in states)
    flat = out.reshape(-1, out.shape[2])
    log_j = np.empty(len(flat))
    log_dilatations(data, u, log_j.reshape(-1, 8))
    points = np.ascontiguousarray(theta[data.hexes] @ data.shape.T).reshape(-1)
    pressure, by_pressure = pressure_values(log_j, points, law), pressure_gradients((log_j, points), law, along.in_pressure)
    gamma = after[:, LAMBDA] - before[:, LAMBDA]
    sigma, alpha = yield_gradients((before[:, ALPHA], before[:, LAMBDA], gamma, points), law, along.in_yield)
    flat[:, PRESSURE] = pressure
    flat[:, K_LOG_J], flat[:, K_THETA] = by_pressure[:2]
    flat[:, BY_ALPHA], flat[:, BY_LAMBDA], flat[:, BY_GAMMA] = sigma[:3]
    flat[:, ALPHA_BY_ALPHA], flat[:, ALPHA_BY_GAMMA] = alpha[0], alpha[2]
    flat[:, BY_THETA] = sigma[3]
    flat[:, GRADIENTS:] = np.concatenate([by_pressure[2:], sigma[4:], alpha[4:]]).T
    _responses(data, u, states[0], states[1], law, out)


@kernel(parallel=True)
def log_dilatations(data: ElementData, u: np.ndarray, out: np.ndarray) -> None:
    """ln J that the material sees at every point, out (n_el, 8)."""
    n_el = data.hexes.shape[0]
    for chunk in prange(_CHUNKS):
        w = lane_workspace(ELEMENT_ROWS)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            _, j = element_kinematics(data, e, u, w)
            set_row(out, e, math.log(j))


@kernel(parallel=True)
def _responses(data: ElementData, u: np.ndarray, state_n: np.ndarray, state: np.ndarray, law: Law, out: np.ndarray) -> None:
    n_el = data.hexes.shape[0]
    for chunk in prange(_CHUNKS):
        w, point = lane_workspace(ELEMENT_ROWS), lane_workspace(ROWS)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            f, _ = element_kinematics(data, e, u, w)
            responses_of_points(f, state_n[e], state[e], law, point, out[e])
