"""How effects enter the law: within a slot additive terms are summed, then factors multiplied, so that order cannot matter.

The effects are files of their own (thermofit.effects, or a user's). Their formulas are joined here, once per process, in a module that is
written beside the compiled kernels, so that it is cached with them:

    added_yield_stress = sum of the effects of slot yield_stress,  stored_yield_stress = those of them that store what they take (STORED)
    yield_factor       = product of the effects of slot yield_factor,   dissipation_factor = product of those of slot dissipation
    modulus_factor     = product of the effects of slot free_energy, factors on the elastic moduli that Lambda moves
    backstress_terms   = ((C, gamma), ...) of the effects of slot backstress, each with a backstress of its own; C = 0 where it is off
    asymmetry_factor   = product of the effects of slot asymmetry, factors on the yield stress that know the sense of flow
    capacity_factor    = product of those of slot capacity, factors on c0; compiled for a point, the body calls them as they stand

Every Param of such an effect is a number of the law, called <effect>__<param>. At the neutral value of its amplitude an effect is skipped,
not evaluated to zero: exactly off, at no cost.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from pathlib import Path
from types import ModuleType

from thermofit.core.jit import CACHE_FOLDER
from thermofit.effects.catalogue import Effect, effects

SUMS = ("yield_stress",)
FACTORS = ("yield_factor", "dissipation")
POINT_ONLY = ("backstress", "free_energy", "asymmetry")
"""Slots that the point driver has and the finite element body has not."""
_HEAD = '''"""Joined formulas of effects; written by thermofit.law.composition."""
from thermofit.core.jit import kernel
from thermofit.effects.catalogue import effect
'''


def number_of(param_name: str) -> str:
    """Name of a Param of an effect among the numbers of the law."""
    return param_name.replace(".", "__")


def body_effects() -> tuple[Effect, ...]:
    """Effects of the law that the finite element body has as well, in a fixed order."""
    return effects((*SUMS, *FACTORS))


def law_effects() -> tuple[Effect, ...]:
    """Effects that act in the law of a point, in a fixed order."""
    return effects((*SUMS, *FACTORS, *POINT_ONLY))


def capacity_effects() -> tuple[Effect, ...]:
    """Effects of slot capacity that a point has as well: those of the catalogue. A user's is called with arrays and need not compile."""
    return tuple(e for e in effects(("capacity",)) if not e.of_user)


EFFECT_PARAMS: tuple[str, ...] = tuple(name for e in (*law_effects(), *capacity_effects()) for name in e.names)
"""Names of all Params of effects among the numbers of the law."""
CAPACITIES: tuple[str, ...] = tuple(p.name for e in capacity_effects() for p in e.amplitudes)
"""Names of those that change the heat capacity of a point."""
BACKSTRESSES: tuple[str, ...] = tuple(e.name for e in effects(("backstress",)))
"""Names of the effects that have a backstress each, in the order of `backstress_terms`."""
AMPLITUDES: tuple[str, ...] = tuple(p.name for e in law_effects() for p in e.amplitudes)
"""Names of those Params that switch an effect of the mechanics."""
EFFECT_NUMBERS: tuple[str, ...] = tuple(number_of(name) for name in EFFECT_PARAMS)
"""The same as numbers of the law."""


_GIVEN = {"free_energy": "accumulated, law", "asymmetry": "sense, law", "capacity": "theta, law.theta_ref"}
"""What a function is called with before its Params, by slot; all others with (accumulated, rate, theta, law)."""


def _is_on(e: Effect) -> str:
    """Condition under which an effect is looked at."""
    return " or ".join(f"law.{number_of(p.name)} != {p.neutral!r}" for p in e.amplitudes)


def _call(e: Effect) -> str:
    numbers = ", ".join(f"law.{number_of(name)}" for name in e.names)
    return f"_{e.name}({_GIVEN.get(e.slot, 'accumulated, rate, theta, law')}, {numbers})"


def _function(name: str, members: list[Effect], product: bool) -> str:
    arguments = {"modulus_factor": "accumulated", "asymmetry_factor": "sense", "capacity_factor": "theta"}.get(
        name, "accumulated, rate, theta"
    )
    lines = [
        "@kernel(forceinline=True)",
        f"def {name}({arguments}, law):",
        f"    value = {'1.0 + ' if product else ''}0.0 * {arguments.partition(',')[0]}",
    ]
    for e in members:
        operation = "*" if product else "+"
        lines += [
            f"    if {_is_on(e)}:",
            f"        value = value {operation} {_call(e)}",
        ]
    return "\n".join([*lines, "    return value", "", ""])


def _terms(members: list[Effect]) -> str:
    """Source of `backstress_terms`."""
    lines = ["@kernel(forceinline=True)", "def backstress_terms(accumulated, rate, theta, law):", "    zero = 0.0 * accumulated * law.mu"]
    for k, e in enumerate(members):
        lines += [
            f"    modulus_{k}, recall_{k} = zero, zero",
            f"    if {_is_on(e)}:",
            f"        given = {_call(e)}",
            f"        modulus_{k}, recall_{k} = zero + given[0], zero + given[1]",
        ]
    pairs = "".join(f"(modulus_{k}, recall_{k}), " for k in range(len(members)))
    return "\n".join([*lines, f"    return ({pairs})", "", ""])


def _as_tuples(n: int) -> str:
    """Source of `effect_numbers` and `no_effects`: all numbers of effects from an array, and zeros in their stead. Written out, because the
    compiler builds a tuple from a loop by copying it once per entry."""
    entries = "".join(f"numbers[{k}], " for k in range(n))
    zeros = "0.0j, " * n
    return (
        f"@kernel(forceinline=True)\ndef effect_numbers(numbers):\n    return ({entries})\n\n\n"
        f"@kernel(forceinline=True)\ndef no_effects():\n    return ({zeros})\n\n\n"
    )


def source() -> str:
    """The joined formulas as Python text."""
    members = [*law_effects(), *capacity_effects()]
    parts = [_HEAD]
    parts += [f"_{e.name} = kernel(forceinline=True)(effect({e.name!r}).act)\n" for e in members]
    parts.append("\n\n")
    parts.append(_function("added_yield_stress", [e for e in members if e.slot == "yield_stress"], False))
    parts.append(_function("stored_yield_stress", [e for e in members if e.slot == "yield_stress" and e.stored], False))
    parts.append(_function("yield_factor", [e for e in members if e.slot == "yield_factor"], True))
    parts.append(_function("dissipation_factor", [e for e in members if e.slot == "dissipation"], True))
    parts.append(_function("modulus_factor", [e for e in members if e.slot == "free_energy"], True))
    parts.append(_function("asymmetry_factor", [e for e in members if e.slot == "asymmetry"], True))
    parts.append(_function("capacity_factor", [e for e in members if e.slot == "capacity"], True))
    parts.append(_as_tuples(len(EFFECT_NUMBERS)))
    parts.append(_terms([e for e in members if e.slot == "backstress"]))
    return "".join(parts)


def _written() -> ModuleType:
    """The module of `source`, from a file beside the compiled kernels."""
    text = source()
    name = f"composition_{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    path = Path(CACHE_FOLDER) / f"{name}.py"
    if not path.exists():
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".py")
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(text)
        os.replace(temporary, path)
    spec = importlib.util.spec_from_file_location(f"thermofit_{name}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # compiled kernels name it when they are read from the cache
    spec.loader.exec_module(module)
    return module


_module = _written()
added_yield_stress = _module.added_yield_stress
stored_yield_stress = _module.stored_yield_stress
yield_factor = _module.yield_factor
dissipation_factor = _module.dissipation_factor
modulus_factor = _module.modulus_factor
backstress_terms = _module.backstress_terms
effect_numbers = _module.effect_numbers
no_effects = _module.no_effects
asymmetry_factor = _module.asymmetry_factor
capacity_factor = _module.capacity_factor
