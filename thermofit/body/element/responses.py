"""What all directions of a differentiated step share: the responses of all points at its converged end."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from thermofit.body.element.hex8 import ElementData
from thermofit.body.element.lanes import element_kinematics, prefetch_element
from thermofit.body.element.stiffness import ELEMENT_ROWS
from thermofit.core.jit import kernel
from thermofit.law.page import Law
from thermofit.law.page_rates import Directions, set_pressure, set_pressure_gradients, set_yield_gradients
from thermofit.point.lanes_memory import lane_workspace, prefetch_rows, set_row
from thermofit.point.rates import (
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
    response_size,
    responses_of_points,
)
from thermofit.point.relative_rates import STIFF, curvature_row, relative_responses_of_points, set_law_rows
from thermofit.point.state import ALPHA, LAMBDA

_CHUNKS = 64
States = tuple[np.ndarray, np.ndarray]
"""States (n_el, 8, n) before and after the step."""


def responses(
    data: ElementData, fields: tuple[np.ndarray, np.ndarray], states: States, law: Law, along: Directions, out: np.ndarray
) -> None:
    """Response of all points at the converged end of a step into out (n_el, n_response, 8); fields = (u (n_np, 3) mm, theta (n_np,) K).

    Derivatives of the yield stress stand there only if any point flows.
    """
    u, theta = fields
    before, after = states
    points = np.ascontiguousarray(theta[data.hexes] @ data.shape.T)
    gamma, at = after[:, :, LAMBDA] - before[:, :, LAMBDA], GRADIENTS + len(along.in_pressure)
    if np.any(gamma > 0.0):
        n = len(along.in_yield)
        sigma = [out[:, k] for k in (BY_ALPHA, BY_LAMBDA, BY_GAMMA, BY_THETA, *range(at, at + n))]
        alpha = [out[:, ALPHA_BY_ALPHA], None, out[:, ALPHA_BY_GAMMA], None, *(out[:, k] for k in range(at + n, at + 2 * n))]
        set_yield_gradients((before[:, :, ALPHA], before[:, :, LAMBDA], gamma, points), law, along.in_yield, (sigma, alpha))
    log_j, base, curved = np.empty(gamma.shape), 0, 0
    if along.structured:
        base = response_size(len(along.in_pressure), len(along.in_yield))
        curved = curvature_row(along)
        set_law_rows(before, after, points, law, along, out)
    _responses(data, u, before, after, law, (base, len(along.in_structure), curved), along.in_surface, out, log_j)
    set_pressure(log_j, points, law, out[:, PRESSURE])
    set_pressure_gradients((log_j, points), law, along.in_pressure, [out[:, k] for k in (K_LOG_J, K_THETA, *range(GRADIENTS, at))])
    if along.structured:
        for k in (PRESSURE, K_LOG_J, K_THETA, *range(GRADIENTS, at)):
            out[:, k] *= out[:, base + STIFF]


@kernel(parallel=True)
def _responses(
    data: ElementData,
    u: np.ndarray,
    state_n: np.ndarray,
    state: np.ndarray,
    law: Law,
    further: tuple[int, int, int],
    in_surface: np.ndarray,
    out: np.ndarray,
    log_j: np.ndarray,
) -> None:
    """The responses but for the derivatives of the law page, and ln J (n_el, 8) that the material sees.

    further = (first row of `relative_rates`, 0 where nothing of it is wanted; its number of active numbers; first row of the curvature of
    the surface). in_surface: active numbers of a transformed surface.
    """
    n_el = data.hexes.shape[0]
    for chunk in prange(_CHUNKS):
        w, point = lane_workspace(ELEMENT_ROWS), lane_workspace(ROWS)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            prefetch_element(data, e + 1, state_n, state)
            prefetch_rows(out, (e + 1) * out.shape[1], GRADIENTS, 1)
            f, j = element_kinematics(data, e, u, w)
            set_row(log_j, e, math.log(j))
            if further[0] > 0:
                relative_responses_of_points(f, state_n[e], state[e], law, further, in_surface, point, out[e])
            else:
                responses_of_points(f, state_n[e], state[e], law, point, out[e])
