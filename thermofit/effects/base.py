"""Effects that the base law already holds: Params that a study may hold fixed at neutral, and that then are as dormant as any effect.

They have no file of their own, because the kernels know their formulas; listed here, they take part in the catalogue as slot `base`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from thermofit.core.parameters import Param, param


@dataclass(frozen=True)
class BaseEffect:
    """One mechanism of the base law: its Params with a probe each, the amplitude first.

    `reciprocal`: the data are linear in one over the amplitude, a resistance, which is nothing at the neutral value.
    """

    name: str
    params: tuple[Param, ...]
    formula: str
    source: str
    reciprocal: bool = False


def _probed(**probes: float) -> tuple[Param, ...]:
    return tuple(replace(param(name), probe=probe) for name, probe in probes.items())


BASE: tuple[BaseEffect, ...] = (
    BaseEffect("linear_hardening", _probed(H_lin=20.0), "K_bar += H_lin Lambda", "thesis (4.6)"),
    # H is not in it: a uniaxial test sees F / (F + H) and M_y / sqrt(F + H), so that H beside F and the yield stresses is a convention.
    BaseEffect("hill_anisotropy", _probed(G=0.6, L=1.8), "G (M33 - M11)^2 + 2 L M12^2 of the yield surface", "thesis (4.19); Hill 1948"),
    BaseEffect("thermal_expansion", _probed(alpha_exp=1e-5), "psi -= 3 alpha_exp K (theta - theta_ref) ln J / J", "thesis (4.4)"),
    BaseEffect("air_convection", _probed(alpha_air=10.0), "q_0 = -alpha_air (theta_air - theta)", "thesis (4.13), 5.5.3"),
    BaseEffect(
        "clamp_conductance", _probed(alpha_clamp=1e3), "q_0 = -alpha_clamp (theta_clamp - theta)", "thesis (4.13), 5.5.3", reciprocal=True
    ),
)
"""All of them, by subject."""
