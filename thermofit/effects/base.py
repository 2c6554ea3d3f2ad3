"""Effects that the base law already holds: Params which a study may hold fixed, and which then are as dormant as any effect.

They have no file of their own, because the kernels know them; here they are listed so that a diagnosis can ask for them like for others.
Their influence is that of the Param at the value that it is held at: the neutral one, where the mechanism is off, or any other.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Param, Parameters, param


@dataclass(frozen=True)
class BaseEffect:
    """One mechanism of the base law: Params, amplitude first and each with a probe, and where a study finds it in the model.

    `reciprocal`: the data are linear in one over the Param, the contact resistance, which is zero at the neutral value.
    """

    name: str
    params: tuple[Param, ...]
    formula: str
    source: str
    reciprocal: bool = False

    @property
    def amplitude(self) -> Param:
        """The first Param."""
        return self.params[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the Params."""
        return tuple(p.name for p in self.params)

    def dormant(self, free: Container[str]) -> tuple[str, ...]:
        """Those of its Params that are held fixed where `free` are free."""
        return tuple(name for name in self.names if name not in free)

    def is_off(self, parameters: Parameters) -> bool:
        """Whether the mechanism is absent: its amplitude at the neutral value."""
        return parameters[self.amplitude.name] == self.amplitude.neutral


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
_BY_NAME = {e.name: e for e in BASE}


def base_effect(name: str) -> BaseEffect:
    """The effect of the base law of that name; StudyError where there is none."""
    if name not in _BY_NAME:
        raise StudyError(f"effect '{name}' is not one of the base law; those are {', '.join(_BY_NAME)}")
    return _BY_NAME[name]


def held(free: Container[str]) -> tuple[BaseEffect, ...]:
    """Effects of the base law of which a study holds at least one Param fixed, each with only the Params that it holds."""
    kept = ((e, e.dormant(free)) for e in BASE)
    return tuple(replace(e, params=tuple(p for p in e.params if p.name in names)) for e, names in kept if names)
