"""Heat and energy of the effects that change the local update itself: changed moduli, yield stress by the sense of flow, backstress.

With the factor m(Lambda, theta) on all elastic moduli and the backstresses C_i Y_i, the free energy of the law page becomes

    psi = m A + (4.3) + (4.5) + psi_pl + sum C_i |Y_i|_G^2 / 2,      A = (4.2) + (4.4),

so that -(dm/dLambda) A dLambda is dissipated while moduli are lost to flow, the heat of recall (law.backstress) while backstresses forget,
and what a factor f on the yield stress adds to the work of flow. The thermoelastic heat is theta dS,

    S = d(m A)/dtheta = m_theta A - m 3 alpha_exp K ln J / J,      m_theta = dm/dtheta,

which is minus the elastic part of the entropy. The first term is there where moduli change with temperature; in theta dS it holds the heat
that they take up when the material is strained, and what they add to the heat capacity at a given strain, -theta d2(m A)/dtheta2.
"""

from __future__ import annotations

import numpy as np

from thermofit.core.jit import kernel
from thermofit.law.composition import dissipation_factor, modulus_factor
from thermofit.law.page import Law, elastic_energy, thermoelastic_heat, yield_stress_at_rate

_NEAR = 0.01
"""K; half the reach of the difference that makes m_theta: that of a linear m to roundoff, and of a curved one to 1e-8."""


@kernel(forceinline=True)
def modulus_slope(accumulated: float, theta: float, law: Law) -> float:
    """m_theta of the factor m on the moduli, 1/K. By a difference, since its own derivatives are made by complex step."""
    slope: float = (modulus_factor(accumulated, theta + _NEAR, law) - modulus_factor(accumulated, theta - _NEAR, law)) / (2.0 * _NEAR)
    return slope


@kernel(forceinline=True)
def energy_slope(trace: float, log_j: float, accumulated: float, theta: float, law: Law) -> float:
    """S = d(m A)/dtheta, mJ/(mm^3 K), minus the elastic part of the entropy; trace = tr C_el, log_j = ln J."""
    g = log_j / np.exp(log_j)
    free = elastic_energy(trace, log_j, law) + thermoelastic_heat(theta - law.theta_ref, 0.0, g, law)
    rigid: float = modulus_factor(accumulated, theta, law) * thermoelastic_heat(1.0, 0.0, g, law)
    return modulus_slope(accumulated, theta, law) * free + rigid


@kernel(forceinline=True)
def degradation_heat(lost: float, trace: float, log_j: float, g: float, theta: float, law: Law) -> float:
    """Heat of an increment whose flow loses the part `lost` of the moduli, mJ/mm^3; trace = tr C_el, g = ln J / J."""
    return lost * (elastic_energy(trace, log_j, law) + thermoelastic_heat(theta - law.theta_ref, 0.0, g, law))


@kernel(forceinline=True)
def asymmetry_heat(factor: float, alpha: float, accumulated: float, d_lambda: float, theta: float, law: Law) -> float:
    """Heat of an increment, mJ/mm^3, that a factor on the yield stress adds; alpha and `accumulated` at its end."""
    rate = d_lambda * law.per_second
    plain = yield_stress_at_rate(alpha, accumulated, rate, theta, law)
    return (factor - 1.0) * plain * d_lambda * dissipation_factor(accumulated, rate, theta, law)
