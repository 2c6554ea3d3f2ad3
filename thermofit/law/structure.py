"""Heat and energy of the effects that change the local update itself: degraded moduli, yield stress by the sense of flow, backstress.

With the factor m(Lambda) on all elastic moduli and the backstresses C_i Y_i, the free energy of the law page becomes

    psi = m [(4.2) + (4.4)] + (4.3) + (4.5) + psi_pl + sum C_i |Y_i|_G^2 / 2,

so that -dm [(4.2) + (4.4)] is dissipated while moduli are lost, the heat of recall (law.backstress) while backstresses forget, and what a
factor f on the yield stress adds to the work of flow. The thermoelastic heat follows m ln J / J.
"""

from __future__ import annotations

from thermofit.core.jit import kernel
from thermofit.law.composition import dissipation_factor
from thermofit.law.page import Law, elastic_energy, thermoelastic_heat, yield_stress_at_rate


@kernel(forceinline=True)
def degradation_heat(lost: float, trace: float, log_j: float, g: float, theta: float, law: Law) -> float:
    """Heat of an increment that loses the part `lost` of the moduli, mJ/mm^3; trace = tr C_el, g = ln J / J."""
    return lost * (elastic_energy(trace, log_j, law) + thermoelastic_heat(theta - law.theta_ref, 0.0, g, law))


@kernel(forceinline=True)
def asymmetry_heat(factor: float, alpha: float, accumulated: float, d_lambda: float, theta: float, law: Law) -> float:
    """Heat of an increment, mJ/mm^3, that a factor on the yield stress adds; alpha and `accumulated` at its end."""
    rate = d_lambda * law.per_second
    plain = yield_stress_at_rate(alpha, accumulated, rate, theta, law)
    return (factor - 1.0) * plain * d_lambda * dissipation_factor(accumulated, rate, theta, law)
