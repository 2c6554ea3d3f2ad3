"""One material point in tests: update, stress and tangent in one call, nominal law, uniaxial driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scalar_update import local_tangent, local_update, piola_stress, point_work

from thermofit.core.jit import kernel
from thermofit.core.parameters import Parameters
from thermofit.law.composition import STRUCTURE, law_effects
from thermofit.law.page import Law, law_in_step, law_of
from thermofit.point.lanes_memory import column, lane_workspace, row, set_row
from thermofit.point.lanes_point import kirchhoff_stress, set_spatial_stiffness, update_lanes
from thermofit.point.lanes_rows import POINT_ROWS, STIFFNESS
from thermofit.point.lanes_tensor import set_symmetric_rows, tensor_rows
from thermofit.point.state import PLASTIC

NOMINAL = Parameters.of(
    {
        **{"E": 68396.66, "nu": 0.34, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "H_lin": 0.0},
        **{"F": 0.35, "G": 0.5, "H": 0.5, "L": 1.5, "M": 1.5, "N": 1.5, "alpha_exp": 20.21e-6, "kappa": 133.45, "c0": 2.22, "beta": 0.79},
        **{"alpha_air": 14.72, "alpha_clamp": 236.3, "theta_air": 297.4, "theta_clamp": 296.7, "theta_ref": 296.7},
    }
)
ANISOTROPIC = NOMINAL.replace(F=0.31, G=0.62, H=0.45, L=1.2, M=1.9, N=1.45)
PROBES = {
    p.name: p.probe if p.probe is not None else p.neutral for effect in law_effects() if effect.slot not in STRUCTURE for p in effect.params
}
"""Every effect at its probe that puts numbers into the law; those that change the update itself have tests of their own."""
VIRGIN = np.array([1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0, 0, 0])
WORK = point_work()
"""Scratch: filled anew by every update."""


@dataclass(frozen=True)
class Answer:
    """What one update returns: status, P (3, 3) MPa, new state, A = dP/dF (9, 9) MPa."""

    status: int
    stress: np.ndarray
    state: np.ndarray
    tangent: np.ndarray

    @property
    def fp_inv(self) -> np.ndarray:
        """F_p^-1."""
        return self.state[:9].reshape(3, 3)


PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


@kernel
def _points(f: np.ndarray, theta: np.ndarray, state_n: np.ndarray, law: Law, state: np.ndarray, stress: np.ndarray, c: np.ndarray) -> int:
    """f (3, 3, 8), theta (8, 1), states (8, n), tau (6, 8), c (6, 6, 8)."""
    w = lane_workspace(POINT_ROWS)
    status = update_lanes(tensor_rows(f, 0), column(theta, 0), state_n, law, w, state)
    if status >= 0:
        set_symmetric_rows(stress, 0, kirchhoff_stress(law, w))
        set_spatial_stiffness(status, law, w)
        for m in range(36):
            set_row(c, m, row(w, STIFFNESS + m))
    return status


def in_lanes(f: np.ndarray, law: Law, states: np.ndarray, theta: np.ndarray) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Status, new states (8, n), tau (8, 3, 3) and c (8, 3, 3, 3, 3) of deformation gradients f (8, 3, 3)."""
    state, stress, c = np.full(states.shape, np.nan), np.empty((6, 8)), np.empty((6, 6, 8))
    status = _points(np.ascontiguousarray(f.transpose(1, 2, 0)), theta[:, None], states, law, state, stress, c)
    place = np.empty((3, 3), dtype=int)
    for m, (i, j) in enumerate(PAIRS):
        place[i, j] = place[j, i] = m
    return status, state, np.moveaxis(stress[place], -1, 0), np.moveaxis(c[place][:, :, place], -1, 0)


def update(f: np.ndarray, law: Law, state: np.ndarray = VIRGIN, theta: float = 296.7) -> Answer:
    """Update of one point as a body does it, in lanes; the old state stays as it was."""
    f = np.ascontiguousarray(f, dtype=float)
    status, new, tau, c = in_lanes(np.tile(f, (8, 1, 1)), law, np.tile(state, (8, 1)), np.full(8, theta))
    if status < 0:
        return Answer(status, np.full((3, 3), np.nan), new[0], np.full((9, 9), np.nan))
    inverse = np.linalg.inv(f)
    a = np.einsum("ik,jl->ijkl", np.eye(3), tau[0]) + c[0]
    tangent = np.einsum("Jj,Ll,ijkl->iJkL", inverse, inverse, a).reshape(9, 9)
    return Answer(min(status, PLASTIC), tau[0] @ inverse.T, new[0], tangent)


def scalar(f: np.ndarray, law: Law, state: np.ndarray = VIRGIN, theta: float = 296.7) -> Answer:
    """The same by the second implementation."""
    f = np.ascontiguousarray(f, dtype=float)
    new, p, a = np.empty(11), np.full((3, 3), np.nan), np.full((9, 9), np.nan)
    status = local_update(f, theta, state, law, WORK, new)
    if status >= 0:
        piola_stress(f, law, WORK, p)
        local_tangent(status, law, WORK, a)
    return Answer(status, p, new, a)


def laws(parameters: Parameters = ANISOTROPIC) -> list[Any]:
    """Both models, and model 2 with backward Euler, as pytest parameters."""
    return [
        pytest.param(law_of(parameters.replace(H_lin=35.0), 1), id="model1"),
        pytest.param(law_of(parameters, 2), id="model2"),
        pytest.param(law_of(parameters, 2, closed_form=False), id="model2-euler"),
        pytest.param(law_in_step(law_of(parameters.replace(**PROBES), 2), 2.5), id="model2-effects"),
    ]


def random_gradient(seed: int, size: float) -> np.ndarray:
    """I + size * random (3, 3), volume change reduced to a twentieth: mostly isochoric, as plastic strain is."""
    f = np.eye(3) + size * np.random.default_rng(seed).uniform(-1.0, 1.0, (3, 3))
    j = float(np.linalg.det(f))
    assert j > 0.0
    return f * j ** (-0.95 / 3.0)


def deformed_state(law: Law, seed: int = 5) -> np.ndarray:
    """A state after plastic shear: F_p not symmetric, not the identity."""
    answer = update(random_gradient(seed, 0.06), law)
    assert answer.status == 1
    return answer.state


def uniaxial(stretch: float, law: Law, state: np.ndarray, theta: float, lateral: tuple[float, float]) -> tuple[Answer, np.ndarray]:
    """Stress along 2 only: the lateral stretches that make P_11 = P_33 = 0, by Newton with the tangent."""
    x = np.array(lateral)
    for _ in range(30):
        f = np.diag([x[0], stretch, x[1]])
        answer = update(f, law, state, theta)
        assert answer.status >= 0
        residual = answer.stress[[0, 2], [0, 2]]
        if np.abs(residual).max() < 1e-9:
            return answer, f
        x = x - np.linalg.solve(answer.tangent[np.ix_([0, 8], [0, 8])], residual)
    raise AssertionError("no lateral equilibrium")
