"""Eight points in lanes are eight points of the second implementation: state, stress and tangent, elastic, plastic and mixed; failures."""

from __future__ import annotations

import numpy as np
import pytest
from point_tools import ANISOTROPIC, NOMINAL, VIRGIN, Answer, deformed_state, in_lanes, laws, random_gradient, scalar

from thermofit.law.page import Law, law_of
from thermofit.point.state import ALPHA, ELASTIC, INVERTED, LAMBDA, NO_CONVERGENCE, PLASTIC


def spatial(answer: Answer, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """tau = P F^T and c_ijkl = F_jJ F_lL A_iJkL - delta_ik tau_jl."""
    tau = answer.stress @ f.T
    a = np.einsum("jJ,lL,iJkL->ijkl", f, f, answer.tangent.reshape(3, 3, 3, 3))
    return tau, a - np.einsum("ik,jl->ijkl", np.eye(3), tau)


SIZES = {
    "elastic": np.full(8, 4e-4),
    "plastic": np.linspace(0.01, 0.03, 8),
    "mixed": np.array([0.0, 1e-4, 0.02, 5e-4, 3e-3, 0.06, 2e-4, 1e-3]),
    "large": np.linspace(0.05, 0.3, 8),
}


@pytest.mark.parametrize("law", laws())
@pytest.mark.parametrize("case", SIZES)
@pytest.mark.parametrize("virgin", [True, False], ids=["virgin", "deformed"])
def test_lanes_are_points(case: str, law: Law, virgin: bool) -> None:
    """Hill's surface, hot and cold points, F_p the identity or not. The two return maps may stop one iteration apart, which is
    1e-12 of a stress at most; an elastic point differs by rounding alone."""
    theta = np.linspace(250.0, 420.0, 8)
    states = np.stack([VIRGIN if virgin else deformed_state(law, q) for q in range(8)])
    f = np.stack([random_gradient(q + 30, size) @ np.linalg.inv(states[q, :9].reshape(3, 3)) for q, size in enumerate(SIZES[case])])
    status, state, tau, c = in_lanes(f, law, states, theta)
    answers = [scalar(f[q], law, states[q], theta[q]) for q in range(8)]
    kinds = [answer.status for answer in answers]
    assert set(kinds) == {"elastic": {ELASTIC}, "mixed": {ELASTIC, PLASTIC}}.get(case, {PLASTIC})
    assert status > 0 if PLASTIC in kinds else status == ELASTIC
    for q, answer in enumerate(answers):
        expected_tau, expected_c = spatial(answer, f[q])
        accuracy = 1e-15 if answer.status == ELASTIC else 1e-13
        assert tau[q] == pytest.approx(expected_tau, abs=accuracy * law.mu)
        by_difference = 100.0 if law.effective else 1.0  # the slope of effects
        assert c[q] == pytest.approx(expected_c, abs=10.0 * by_difference * accuracy * law.mu)
        assert state[q] == pytest.approx(answer.state, abs=1e-13)
        if answer.status == ELASTIC:
            assert np.array_equal(state[q], states[q])


def test_an_elastic_point_beside_plastic_ones_keeps_its_state_to_the_last_bit() -> None:
    law = law_of(NOMINAL)
    f = np.stack([np.eye(3)] * 7 + [random_gradient(7, 0.05)])
    states = np.tile(VIRGIN, (8, 1))
    for alpha in np.random.default_rng(5).uniform(0.0, 0.09, (20, 8)):
        states[:, ALPHA] = alpha
        status, state, _, _ = in_lanes(f, law, states, np.full(8, 296.7))
        assert status > 0 and np.array_equal(state[:7], states[:7]) and state[7, LAMBDA] > 0.0


def test_plasticity_can_be_left_out() -> None:
    f = np.broadcast_to(np.diag([0.97, 1.08, 0.97]), (8, 3, 3))
    states = np.tile(VIRGIN, (8, 1))
    status, state, _, _ = in_lanes(f, law_of(NOMINAL, plastic=False), states, np.full(8, 300.0))
    assert status == ELASTIC and np.array_equal(state, states)


def test_a_state_on_the_yield_surface_is_elastic() -> None:
    law = law_of(ANISOTROPIC)
    f = np.stack([random_gradient(q, 0.05) for q in range(8)])
    states = np.tile(VIRGIN, (8, 1))
    loaded = in_lanes(f, law, states, np.full(8, 300.0))[1]
    status, again, _, _ = in_lanes(f, law, loaded, np.full(8, 300.0))
    assert np.all(loaded[:, LAMBDA] > 0.0) and status == ELASTIC and np.array_equal(again, loaded)


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        (np.diag([-1.0, 1.0, 1.0]), INVERTED),
        (np.diag([1.0, 0.0, 1.0]), INVERTED),
        (np.full((3, 3), np.nan), INVERTED),
        (np.diag([0.2, 30.0, 0.2]), NO_CONVERGENCE),
    ],
)
@pytest.mark.parametrize("lane", [0, 5])
def test_one_failure_is_told(bad: np.ndarray, expected: int, lane: int) -> None:
    f = np.stack([random_gradient(q, 0.05) for q in range(8)])
    f[lane] = bad
    assert in_lanes(f, law_of(NOMINAL), np.tile(VIRGIN, (8, 1)), np.full(8, 300.0))[0] == expected
