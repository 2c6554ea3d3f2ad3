"""The law page against closed forms, quadrature and the free energy of the thesis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from point_tools import ANISOTROPIC, NOMINAL, update
from scipy.integrate import quad, solve_ivp

from thermofit.core.parameters import Parameters
from thermofit.law.hardening.model2 import beta_bounds
from thermofit.law.page import (
    Law,
    dissipated_energy,
    hardening_variable,
    hill_gradient,
    law_of,
    pressure_factor,
    thermoelastic_heat,
    yield_stress,
)

B, M_Y0, M_YINF = NOMINAL["H_exp"], NOMINAL["M_y0"], NOMINAL["M_yinf"]


def accumulated(d_lambda: float, steps: int, law: Law) -> float:
    """alpha after d_lambda in equal steps from zero."""
    alpha = 0.0
    for _ in range(steps):
        alpha, _ = hardening_variable(alpha, d_lambda / steps, law)
    return alpha


def test_moduli() -> None:
    law = law_of(NOMINAL)
    E, nu = NOMINAL["E"], NOMINAL["nu"]
    assert law.bulk == pytest.approx(E / (3.0 * (1.0 - 2.0 * nu)), rel=1e-14)
    assert 9.0 * law.bulk * law.mu / (3.0 * law.bulk + law.mu) == pytest.approx(E, rel=1e-14)
    assert law.lame / (2.0 * (law.lame + law.mu)) == pytest.approx(nu, rel=1e-14)


@pytest.mark.parametrize("alpha_n", [0.0, 0.04])
def test_hardening_variable_of_model_2_solves_its_evolution(alpha_n: float) -> None:
    """d alpha / d Lambda = 1 - b alpha (4.15), (4.17): one closed-form step against an ODE solver."""
    solution = solve_ivp(lambda _, a: 1.0 - B * a, (0.0, 0.15), [alpha_n], rtol=1e-12, atol=1e-14)
    assert hardening_variable(alpha_n, 0.15, law_of(NOMINAL))[0] == pytest.approx(solution.y[0, -1], abs=1e-11)


def test_closed_form_does_not_depend_on_the_steps_and_backward_euler_is_of_order_1() -> None:
    """Errata 2: backward Euler converges to the closed form, with an effective exponent b (1 - b dLambda / 2)."""
    exact = (1.0 - math.exp(-B * 0.15)) / B
    for steps in (1, 7, 50):
        assert accumulated(0.15, steps, law_of(NOMINAL)) == pytest.approx(exact, rel=1e-14)
    euler = law_of(NOMINAL, closed_form=False)
    errors = np.array([accumulated(0.15, steps, euler) - exact for steps in (20, 40, 80, 160)])
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all(np.abs(orders - 1.0) < 0.06), orders
    step = 0.15 / 160
    slower = (1.0 - math.exp(-B * (1.0 - 0.5 * B * step) * 0.15)) / B
    assert accumulated(0.15, 160, euler) * B == pytest.approx(slower * B, abs=2e-5)


@pytest.mark.parametrize("closed_form", [True, False])
@pytest.mark.parametrize("model", [1, 2])
@given(st.floats(0.0, 0.08), st.floats(1e-6, 0.1))
def test_hardening_derivatives(model: int, closed_form: bool, alpha_n: float, d_lambda: float) -> None:
    law = law_of(NOMINAL.replace(H_lin=40.0), model, closed_form=closed_form)
    h = 1e-6
    forward, back = hardening_variable(alpha_n, d_lambda + h, law)[0], hardening_variable(alpha_n, d_lambda - h, law)[0]
    assert hardening_variable(alpha_n, d_lambda, law)[1] == pytest.approx((forward - back) / (2 * h), rel=1e-7, abs=1e-9)
    _, by_alpha, by_lambda = yield_stress(alpha_n, 0.1, law)
    assert by_alpha == pytest.approx((yield_stress(alpha_n + h, 0.1, law)[0] - yield_stress(alpha_n - h, 0.1, law)[0]) / (2 * h), rel=1e-6)
    assert by_lambda == pytest.approx((yield_stress(alpha_n, 0.1 + h, law)[0] - yield_stress(alpha_n, 0.1 - h, law)[0]) / (2 * h), rel=1e-6)


@given(st.floats(0.0, 0.5))
def test_both_models_harden_alike(Lambda: float) -> None:
    """(4.27), (4.28): with b = H_exp, h = b (M_yinf - M_y0) the yield stress is one function of Lambda, that of (4.29)."""
    one, two = law_of(NOMINAL, 1), law_of(NOMINAL, 2)
    expected = M_Y0 + (M_YINF - M_Y0) * (1.0 - math.exp(-B * Lambda))
    for law in (one, two):
        assert yield_stress(hardening_variable(0.0, Lambda, law)[0], Lambda, law)[0] == pytest.approx(expected, rel=1e-13)


@given(st.floats(0.0, 0.3), st.floats(0.0, 0.3))
def test_linear_hardening_adds_to_both_models_and_is_exactly_off_at_zero(alpha: float, Lambda: float) -> None:
    for model in (1, 2):
        off, on = law_of(NOMINAL, model), law_of(NOMINAL.replace(H_lin=50.0), model)
        before = yield_stress(alpha, Lambda, off)
        assert before[0] == yield_stress(alpha, 0.0, off)[0] and before[2] == 0.0
        assert yield_stress(alpha, Lambda, on)[0] == pytest.approx(before[0] + 50.0 * Lambda, rel=1e-14)


@pytest.mark.parametrize("beta", [0.0, 0.79, 1.0, 5.0])
@pytest.mark.parametrize("model", [1, 2])
def test_dissipated_energy_is_the_integral_of_the_printed_dissipation(model: int, beta: float) -> None:
    """(4.21) and (4.22) by numerical quadrature over an increment that starts at alpha_n > 0."""
    law = law_of(NOMINAL.replace(beta=beta), model)
    h, alpha_n, d_lambda = B * (M_YINF - M_Y0), 0.02, 0.07

    def printed(x: float) -> float:
        if model == 1:
            return beta * M_Y0
        a = (1.0 - (1.0 - B * alpha_n) * math.exp(-B * x)) / B
        return B * h * a**2 + (1.0 - beta) * B * M_Y0 * a + beta * M_Y0

    expected = quad(printed, 0.0, d_lambda, epsabs=1e-13, epsrel=1e-13)[0]
    alpha, _ = hardening_variable(alpha_n, d_lambda, law)
    assert dissipated_energy(alpha_n, alpha, d_lambda, law) == pytest.approx(expected, rel=1e-12)


def test_dissipation_is_plastic_work_less_stored_energy() -> None:
    """Plastic work sqrt(M:G:M) dLambda = sigma_y dLambda must be what is dissipated and what (4.5), (4.6), (4.7) store."""
    Lambda = 0.11
    for model in (1, 2):
        law = law_of(NOMINAL, model)
        alpha = hardening_variable(0.0, Lambda, law)[0]
        work = quad(lambda x, law=law: yield_stress(hardening_variable(0.0, x, law)[0], x, law)[0], 0.0, Lambda, epsrel=1e-12)[0]
        stored = (1.0 - law.beta) * M_Y0 * alpha
        if model == 1:
            stored += (M_YINF - M_Y0) * (alpha + (math.exp(-B * alpha) - 1.0) / B)
        else:
            stored += 0.5 * B * (M_YINF - M_Y0) * alpha**2
        assert dissipated_energy(0.0, alpha, Lambda, law) == pytest.approx(work - stored, rel=1e-10)


@given(st.floats(0.0, 1.0), st.floats(20.0, 400.0), st.floats(1.05, 6.0), st.floats(0.5, 100.0), st.floats(0.0, 1.0), st.floats(0.0, 0.4))
def test_dissipation_is_not_negative_inside_the_bounds_of_beta(
    share: float, M_y0: float, ratio: float, b: float, start: float, d_lambda: float
) -> None:
    """For beta in [0, beta_u] (4.24), alpha_n in [0, 1/b] and any increment, closed form and backward Euler."""
    upper = beta_bounds(M_y0, ratio * M_y0, b)[1]
    parameters = NOMINAL.replace(M_y0=M_y0, M_yinf=ratio * M_y0, H_exp=b, beta=share * upper)
    for model, closed_form in ((1, True), (2, True), (2, False)):
        law = law_of(parameters, model, closed_form=closed_form)
        alpha, _ = hardening_variable(start / b, d_lambda, law)
        assert dissipated_energy(start / b, alpha, d_lambda, law) >= -1e-12 * M_y0 * (1.0 + share * upper)


def test_backward_euler_dissipation_converges_to_the_closed_form() -> None:
    exact = dissipated_energy(0.0, hardening_variable(0.0, 0.1, law_of(NOMINAL))[0], 0.1, law_of(NOMINAL))
    law = law_of(NOMINAL, closed_form=False)
    errors = []
    for steps in (40, 80, 160):
        alpha, total = 0.0, 0.0
        for _ in range(steps):
            new, _ = hardening_variable(alpha, 0.1 / steps, law)
            total += dissipated_energy(alpha, new, 0.1 / steps, law)
            alpha = new
        errors.append(abs(total - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 1.0) < 0.1), orders


def energy(f: np.ndarray, fp_inv: np.ndarray, theta: float, parameters: Parameters) -> complex:
    """psi_el + psi_coup, (4.2) + (4.4), in mJ/mm^3; accepts complex F."""
    E, nu = parameters["E"], parameters["nu"]
    lame, mu, bulk = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu))
    fe = f @ fp_inv
    j = np.linalg.det(fe)
    log_j = np.log(j)
    elastic = 0.5 * lame * log_j**2 + 0.5 * mu * (np.sum(fe * fe) - 3.0) - mu * log_j
    return elastic - 3.0 * parameters["alpha_exp"] * bulk * (theta - parameters["theta_ref"]) * log_j / j


@pytest.mark.parametrize("theta", [296.7, 330.0])
@pytest.mark.parametrize("seed", range(3))
def test_stress_is_the_derivative_of_the_free_energy(seed: int, theta: float) -> None:
    """P = dpsi/dF (4.8) by complex steps of (4.2) + (4.4), with shear, volume change and F_p not the identity."""
    random = np.random.default_rng(seed)
    f = np.eye(3) + 0.2 * random.uniform(-1.0, 1.0, (3, 3))
    fp_inv = np.eye(3) + 0.1 * random.uniform(-1.0, 1.0, (3, 3))
    fp_inv /= np.linalg.det(fp_inv) ** (1.0 / 3.0)
    state = np.concatenate([fp_inv.ravel(), [0.01, 0.01]])
    expected = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            step = f.astype(complex)
            step[i, j] += 1e-30j
            expected[i, j] = energy(step, fp_inv, theta, ANISOTROPIC).imag / 1e-30
    answer = update(f, law_of(ANISOTROPIC, plastic=False), state, theta)
    assert answer.stress == pytest.approx(expected, rel=1e-12, abs=1e-12 * np.abs(expected).max())
    assert np.array_equal(answer.state, state)


@given(st.floats(0.7, 1.5), st.floats(250.0, 400.0))
def test_pressure_factor_derivative(j: float, theta: float) -> None:
    law = law_of(NOMINAL)
    h = 1e-6
    high, low = (pressure_factor(math.log(j) + s * h, j * math.exp(s * h), theta, law)[0] for s in (1.0, -1.0))
    assert pressure_factor(math.log(j), j, theta, law)[1] == pytest.approx((high - low) / (2 * h), rel=1e-7)


def test_thermoelastic_heat_is_the_mixed_derivative_of_the_energy() -> None:
    """(4.20): theta d2psi/(dF_el dtheta) : dF_el over a finite volume change is -3 alpha K theta d(ln J / J); expansion cools."""
    law, theta = law_of(NOMINAL), 297.0

    def coupling(j: float, at: float) -> float:
        f = j ** (1.0 / 3.0) * np.eye(3)
        return float(np.real(energy(f, np.eye(3), at, NOMINAL)))

    j_n, j = 1.0007, 1.0021
    by_theta = [(coupling(x, theta + 0.5) - coupling(x, theta - 0.5)) for x in (j_n, j)]
    heat = thermoelastic_heat(theta, math.log(j_n) / j_n, math.log(j) / j, law)
    assert heat == pytest.approx(theta * (by_theta[1] - by_theta[0]), rel=1e-8)
    assert heat < 0.0
    assert thermoelastic_heat(theta, 0.0, 0.001, law_of(NOMINAL.replace(alpha_exp=0.0))) == 0.0


@given(st.tuples(*[st.floats(-5.0, 5.0)] * 3))
def test_hill_gradient_is_that_of_the_printed_quadratic_form(a: tuple[float, float, float]) -> None:
    """a : G : a = F (a11 - a22)^2 + G (a33 - a11)^2 + H (a22 - a33)^2 (4.19, errata 4), and G : I = 0."""
    law = law_of(ANISOTROPIC)
    g = hill_gradient(*a, law)
    printed = law.F * (a[0] - a[1]) ** 2 + law.G * (a[2] - a[0]) ** 2 + law.H * (a[1] - a[2]) ** 2
    assert np.dot(g, a) == pytest.approx(printed, rel=1e-12, abs=1e-12)
    assert sum(g) == pytest.approx(0.0, abs=1e-12)
