"""How effects and hardening laws enter the law: within a slot additive terms are summed, then factors multiplied, so that order cannot
matter; of the hardening laws `law.model`, a number, selects one.

The effects are files of their own (thermofit.effects, or a user's). Their formulas are joined here, once per process, in a module that is
written beside the compiled kernels, so that it is cached with them:

    added_yield_stress = sum of the effects of slot yield_stress,  stored_yield_stress = those of them that store what they take (STORED)
    yield_factor       = product of the effects of slot yield_factor,   dissipation_factor = product of those of slot dissipation
    modulus_factor     = product of the effects of slots free_energy and elasticity, factors on the elastic moduli that Lambda moves, and
                         those that theta does
    warm_moduli        = whether one of slot elasticity is on
    backstress_terms   = ((C, gamma), ...) of the effects of slot backstress, each with a backstress of its own; C = 0 where it is off
    restructured       = whether an effect is on that changes the local update itself (slots STRUCTURE)
    asymmetry_factor   = product of the effects of slot asymmetry, factors on the yield stress that know the sense of flow
    capacity_factor    = product of those of slot capacity, factors on c0; compiled for a point, the body calls them as they stand

Every Param of such an effect is a number of the law, called <effect>__<param>. At the neutral value of its amplitude an effect is skipped,
not evaluated to zero: exactly off, at no cost.

Of the hardening laws (law.hardening) there are

    hardening_stress     yield stress of the base law and its derivative by alpha, without H_lin Lambda
    hardening_alpha      alpha after an increment, and its derivative: alpha + dLambda but for model 2
    hardening_energy     psi_pl,  hardening_heat = dissipation of an increment: beta M_y0 dLambda but for model 2
    hardening_along      yield stress of the base law over Lambda in monotonic flow, and its slope; effects.curve gives it to effects
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

# Lanes come with the room, before any of its kernels: those that a body compiled name lanes, so that reading them from the cache would
# otherwise import the module in the midst of type inference, whose np.exp is then no longer the np.exp of its beginning.
import thermofit.core.lanes  # noqa: F401
from thermofit.core.jit import CACHE_FOLDER, by_type
from thermofit.effects import curve
from thermofit.effects.catalogue import Effect, effects
from thermofit.law.hardening.catalogue import SHARED, Hardening, hardening, hardening_laws

SUMS = ("yield_stress",)
FACTORS = ("yield_factor", "dissipation")
STRUCTURE = ("backstress", "free_energy", "elasticity", "asymmetry")
"""Slots whose effects change the local update itself, not only numbers in it."""
_HEAD = '''"""Joined formulas of effects; written by thermofit.law.composition."""
from thermofit.core.jit import kernel
from thermofit.effects.catalogue import effect
from thermofit.law.hardening.catalogue import hardening
'''


def number_of(param_name: str) -> str:
    """Name of a Param of an effect among the numbers of the law."""
    return param_name.replace(".", "__")


def law_effects() -> tuple[Effect, ...]:
    """Effects that act in the law of a material point, of a coupon and of a body alike, in a fixed order."""
    return effects((*SUMS, *FACTORS, *STRUCTURE))


def capacity_effects() -> tuple[Effect, ...]:
    """Effects of slot capacity that a point has as well: those of the catalogue. A user's is called with arrays and need not compile."""
    return tuple(e for e in effects(("capacity",)) if not e.of_user)


EFFECT_PARAMS: tuple[str, ...] = tuple(name for e in (*law_effects(), *capacity_effects()) for name in e.names)
"""Names of all Params of effects among the numbers of the law."""
CAPACITIES: tuple[str, ...] = tuple(p.name for e in capacity_effects() for p in e.amplitudes)
"""Names of those that change the heat capacity of a point."""
BACKSTRESSES: tuple[str, ...] = tuple(e.name for e in effects(("backstress",)))
"""Names of the effects that have a backstress each, in the order of `backstress_terms`."""
STRUCTURAL: tuple[str, ...] = tuple(p.name for e in effects(STRUCTURE) for p in e.params)
"""Names of all Params of effects that change the local update."""
AMPLITUDES: tuple[str, ...] = tuple(p.name for e in law_effects() for p in e.amplitudes)
"""Names of those Params that switch an effect of the mechanics."""
EFFECT_NUMBERS: tuple[str, ...] = tuple(number_of(name) for name in EFFECT_PARAMS)
"""The same as numbers of the law."""


_GIVEN = {"free_energy": "accumulated, law", "elasticity": "theta, law", "asymmetry": "sense, law", "capacity": "theta, law.theta_ref"}
"""What a function is called with before its Params, by slot; all others with (accumulated, rate, theta, law)."""


def _is_on(e: Effect) -> str:
    """Condition under which an effect is looked at."""
    return " or ".join(f"law.{number_of(p.name)} != {p.neutral!r}" for p in e.amplitudes)


def _call(e: Effect) -> str:
    numbers = ", ".join(f"law.{number_of(name)}" for name in e.names)
    return f"_{e.name}({_GIVEN.get(e.slot, 'accumulated, rate, theta, law')}, {numbers})"


def _function(name: str, members: list[Effect], product: bool) -> str:
    own = {"modulus_factor": "accumulated, theta", "asymmetry_factor": "sense", "capacity_factor": "theta"}
    arguments = own.get(name, "accumulated, rate, theta")
    nothing = " + ".join(f"0.0 * {a}" for a in (arguments if name in own else "accumulated").split(", "))
    lines = [
        "@kernel(forceinline=True)",
        f"def {name}({arguments}, law):",
        f"    value = {'1.0 + ' if product else ''}{nothing}",
    ]
    for e in members:
        operation = "*" if product else "+"
        lines += [
            f"    if {_is_on(e)}:",
            f"        value = value {operation} {_call(e)}",
        ]
    return "\n".join([*lines, "    return value", "", ""])


def _terms(members: list[Effect]) -> str:
    """Source of `backstress_terms`. A term that is off recalls all the same: what it would hold is known, and so is its influence."""
    lines = ["@kernel(forceinline=True)", "def backstress_terms(accumulated, rate, theta, law):", "    zero = 0.0 * accumulated * law.mu"]
    for k, e in enumerate(members):
        lines += [
            f"    given = {_call(e)}",
            f"    modulus_{k}, recall_{k} = zero, zero + given[1]",
            f"    if {_is_on(e)}:",
            f"        modulus_{k} = zero + given[0]",
        ]
    pairs = "".join(f"(modulus_{k}, recall_{k}), " for k in range(len(members)))
    return "\n".join([*lines, f"    return ({pairs})", "", ""])


def _as_tuples() -> str:
    """Source of `effect_numbers`, `hardening_numbers` and `no_effects`: all numbers of effects, or of the hardening law, from an array,
    and zeros in stead of those of effects. Written out, because the compiler builds a tuple from a loop by copying it once per entry."""
    parts = []
    for name, n in (("effect_numbers", len(EFFECT_NUMBERS)), ("hardening_numbers", len(SHARED))):
        entries = "".join(f"numbers[{k}], " for k in range(n))
        parts.append(f"@kernel(forceinline=True)\ndef {name}(numbers):\n    return ({entries})\n\n\n")
    zeros = "0.0j, " * len(EFFECT_NUMBERS)
    parts.append(f"@kernel(forceinline=True)\ndef no_effects():\n    return ({zeros})\n\n\n")
    return "".join(parts)


_OF_HARDENING = {
    "hardening_stress": ("alpha", "yield_stress", "alpha", ""),
    "hardening_alpha": ("alpha_n, d_lambda", "hardening_variable", "alpha_n, d_lambda, law.closed_form", "alpha_n + d_lambda, 1.0"),
    "hardening_energy": ("alpha", "stored_energy", "alpha", ""),
    "hardening_heat": (
        "alpha_n, alpha, d_lambda",
        "dissipated_energy",
        "alpha_n, alpha, d_lambda, law.closed_form, law.beta",
        "law.beta * law.M_y0 * d_lambda",
    ),
    "hardening_along": ("accumulated", "monotonic", "accumulated", ""),
}
"""Of each function of the hardening laws: its arguments before the law, that of the law's file, what this one is called with before its
numbers, and what holds for laws whose files do not have it; empty: all have it (`monotonic` is `yield_stress` where it is not given)."""
_SHORT, _OTHERS = (tuple(law for law in hardening_laws() if law.small == small) for small in (True, False))


def _in_file(law: Hardening, function: str) -> str:
    """Name of the function of a law's file that does the work of `function`, empty where none does."""
    other = {"monotonic": "yield_stress"}.get(function, "")
    return function if hasattr(law.file, function) else other


def _chosen(name: str) -> str:
    """Source of short_<name>, that of a Law of the thesis, of any_<name>, that of an AnyLaw, which calls one function of all its laws, and
    of kind_of_<name>, which chooses between them by the type of a law."""
    arguments, function, given, usual = _OF_HARDENING[name]
    lines = [f"def short_{name}({arguments}, law):", *_branches(_SHORT, function, given, "law.", usual), "", ""]
    lines += [f"def kind_of_{name}({arguments}, law):", f"    return any_{name} if {SHARED[0]!r} in law.fields else short_{name}", "", ""]
    called = f"def any_{name}({arguments}, law):"
    if usual and not any(_in_file(law, function) for law in _OTHERS):
        return "\n".join([*lines, called, f"    return {usual}", "", ""])
    flags = tuple(flag for flag in ("closed_form", "beta") if f"law.{flag}" in given)
    names = ("model", *flags, *dict.fromkeys(field for law in _OTHERS for field in law.fields))
    lines += ["@kernel", f"def _any_{name}({arguments}, {', '.join(names)}):"]
    lines += [*_branches(_OTHERS, function, given.replace("law.", ""), "", usual.replace("law.", "")), "", ""]
    lines += [called, f"    return _any_{name}({arguments}, {', '.join(f'law.{field}' for field in names)})", "", ""]
    return "\n".join(lines)


def _branches(laws: tuple[Hardening, ...], function: str, given: str, prefix: str, usual: str) -> list[str]:
    """Source of the choice by number among laws, whose numbers are called `prefix`<field>; the last answer is that of all others."""
    found = [(law, _in_file(law, function)) for law in laws]
    answers = [
        (law.number, f"_{law.name}_{own}({given}, {', '.join(prefix + field for field in law.fields)})") for law, own in found if own
    ]
    last = usual or answers.pop()[1]
    lines = []
    for number, answer in answers:
        lines += [f"    if {prefix}model == {number}:", f"        return {answer}"]
    return [*lines, f"    return {last}"]


def _compiled_laws() -> str:
    """Source that makes kernels of the functions of all hardening laws, each called <law>_<function>."""
    lines = []
    for law in hardening_laws():
        own = (_in_file(law, function) for _, function, _, _ in _OF_HARDENING.values())
        for function in dict.fromkeys(name for name in own if name):
            lines.append(f'_{law.name}_{function} = kernel(inline="always")(hardening({law.name!r}).file.{function})')
    return "\n".join([*lines, "", "", ""])


def source() -> str:
    """The joined formulas as Python text."""
    members = [*law_effects(), *capacity_effects()]
    parts = [_HEAD]
    parts += [f"_{e.name} = kernel(forceinline=True)(effect({e.name!r}).act)\n" for e in members]
    parts.append(_compiled_laws())
    parts += [_chosen(name) for name in _OF_HARDENING]
    parts.append(_function("added_yield_stress", [e for e in members if e.slot == "yield_stress"], False))
    parts.append(_function("stored_yield_stress", [e for e in members if e.slot == "yield_stress" and e.stored], False))
    parts.append(_function("yield_factor", [e for e in members if e.slot == "yield_factor"], True))
    parts.append(_function("dissipation_factor", [e for e in members if e.slot == "dissipation"], True))
    parts.append(_function("modulus_factor", [e for e in members if e.slot in ("free_energy", "elasticity")], True))
    parts.append(_function("asymmetry_factor", [e for e in members if e.slot == "asymmetry"], True))
    parts.append(_function("capacity_factor", [e for e in members if e.slot == "capacity"], True))
    parts.append(_as_tuples())
    parts.append(_terms([e for e in members if e.slot == "backstress"]))
    on = " or ".join(_is_on(e) for e in members if e.slot in STRUCTURE)
    parts.append(f"@kernel(forceinline=True)\ndef restructured(law):\n    return {on}\n\n\n")
    warm = " or ".join(_is_on(e) for e in members if e.slot == "elasticity")
    parts.append(f"@kernel(forceinline=True)\ndef warm_moduli(law):\n    return {warm}\n")
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
warm_moduli = _module.warm_moduli
backstress_terms = _module.backstress_terms
restructured = _module.restructured
effect_numbers = _module.effect_numbers
no_effects = _module.no_effects
asymmetry_factor = _module.asymmetry_factor
capacity_factor = _module.capacity_factor
hardening_numbers = _module.hardening_numbers


def _by_type(name: str) -> Callable[..., Any]:
    """The function of the hardening laws of that name, for kernels and outside them: the type of the law says whether it is of the thesis,
    so that nothing of the other laws is compiled where they are not used, or any."""
    short, of_any = getattr(_module, f"short_{name}"), getattr(_module, f"any_{name}")

    def function(*arguments: Any) -> Any:
        return (of_any if hasattr(arguments[-1], SHARED[0]) else short)(*arguments)

    by_type(function)(getattr(_module, f"kind_of_{name}"))
    return function


hardening_stress = _by_type("hardening_stress")
hardening_alpha = _by_type("hardening_alpha")
hardening_energy = _by_type("hardening_energy")
hardening_heat = _by_type("hardening_heat")
hardening_along = _by_type("hardening_along")


def _along(accumulated: Any, law: Any) -> Any:
    """`hardening_along` outside kernels: Lambda a number, complex or real, or an array."""
    selected = hardening(law.model)
    return selected.along((getattr(law, field) for field in selected.fields), accumulated)


curve.give(_along)
by_type(curve.hardening)(lambda accumulated, law: lambda accumulated, law: hardening_along(accumulated, law)[0])
