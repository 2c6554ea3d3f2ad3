"""All hardening laws: one file each in this folder, found by themselves, known by the name of the file.

A law is the yield stress sigma_y(alpha) of plastic flow in MPa, from M_y0 at alpha = 0, which every law has. It gives

    PARAMS          names of Params of the base law (core.parameters) and Params of its own, called <law>.<param>; M_y0 first
    yield_stress    (alpha, *numbers) -> sigma_y and its derivative by alpha
    stored_energy   (alpha, *numbers) -> psi_pl, mJ/mm^3
    search          (largest stress MPa, largest strain) -> start and bounds by name;  METALS: the same where no test was looked at
    first_guess     (Lambda, sigma_y) of a curve, each (n,) -> values by name
    FORMULA, SOURCE, MEANING (what a study file says of them, by name)

and, where it differs from what is usual,

    numbers         (*Params) -> the numbers that yield_stress takes beside M_y0, whose names are NUMBERS; usually the Params themselves
    FITTED          names that a fit frees (usually all of PARAMS);  RAISES: names that lift the curve, all multiplied by one factor
    ASCENDING       chains of names whose values must rise, and WHY
    hardening_variable, dissipated_energy, monotonic (yield_stress over Lambda in monotonic flow), dissipation_remark
                    of a law whose alpha is not Lambda (model2)
    MODEL           its number in the thesis;  SMALL: a few operations on numbers of the base law, which all kernels hold; the others are
                    compiled, with all that calls them, when one of them is first used

The functions are plain formulas of numbers, arrays, complex numbers and lanes alike: no `if` on alpha; law.composition compiles them.
Linear hardening, H_lin Lambda, is added to every law by the law page. Strains, alpha and Lambda have no unit.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Param, declare
from thermofit.core.slots import checked_file, held_by

LINEAR = "H_lin"
"""The Param of the linear hardening that any law may have besides."""
SHARED = tuple(f"hardening_{k}" for k in range(1, 17))
"""Numbers of the law page that belong to whichever law is selected: kernels compile no slower for one more law."""
_NO_LAWS = ("catalogue", "curves")
_REQUIRED = ("PARAMS", "FORMULA", "SOURCE", "METALS", "MEANING", "yield_stress", "stored_energy", "search", "first_guess")


@dataclass(frozen=True)
class Hardening:
    """One law: its name, the number that the kernels know it by (1 and 2 are the models of the thesis), and its file."""

    name: str
    number: int
    file: ModuleType

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its Params, M_y0 first."""
        return tuple(p if isinstance(p, str) else p.name for p in self.file.PARAMS)

    @property
    def own(self) -> tuple[Param, ...]:
        """Params that no other law has."""
        return tuple(p for p in self.file.PARAMS if isinstance(p, Param))

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names that a fit frees where nothing else is said."""
        return tuple(getattr(self.file, "FITTED", self.names))

    @property
    def fields(self) -> tuple[str, ...]:
        """Fields of the law page's Law that hold the numbers which its functions take after alpha: those of the base law, then `SHARED`."""
        shared = len(getattr(self.file, "NUMBERS", self.own))
        return (*(p for p in self.file.PARAMS if isinstance(p, str)), *SHARED[:shared])

    @property
    def small(self) -> bool:
        """True for a law that all kernels hold."""
        return hasattr(self.file, "SMALL")

    @property
    def raises(self) -> tuple[str, ...]:
        """Names of what lifts the curve when all of them are multiplied by one factor above 1."""
        return tuple(getattr(self.file, "RAISES", ("M_y0",)))

    @property
    def ascending(self) -> tuple[tuple[str, ...], ...]:
        """Chains of names whose values must rise."""
        return tuple(getattr(self.file, "ASCENDING", ()))

    def own_values(self, values: Any) -> tuple[Any, ...]:
        """Values of its numbers that stand in `SHARED`; `values[name]` gives that of a Param."""
        if hasattr(self.file, "numbers"):
            return tuple(self.file.numbers(*(values[name] for name in self.names)))
        return tuple(values[p.name] for p in self.own)

    def number_values(self, values: Any) -> tuple[Any, ...]:
        """Values of the numbers that its functions take after alpha; `values[name]` gives that of a Param."""
        return (*(values[p] for p in self.file.PARAMS if isinstance(p, str)), *self.own_values(values))

    def along(self, numbers: Iterable[Any], accumulated: Any) -> Any:
        """Yield stress in MPa after the plastic multiplier Lambda of monotonic flow (any shape), by its numbers, without H_lin Lambda."""
        return getattr(self.file, "monotonic", self.file.yield_stress)(accumulated, *numbers)[0]

    def curve(self, values: Any, accumulated: np.ndarray) -> np.ndarray:
        """Yield stress in MPa at Lambda (any shape) in monotonic flow, linear hardening included; `values[name]` gives that of a Param."""
        return np.asarray(self.along(self.number_values(values), accumulated) + values[LINEAR] * accumulated)

    def above(self, name: str) -> str | None:
        """The Param that the named one must exceed, None where there is none."""
        return next((low for chain in self.ascending for low, high in pairwise(chain) if high == name), None)

    def error(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Name of the first Param that does not exceed the one that it must exceed, and what is wrong; None where all do."""
        for chain in self.ascending:
            for low, high in pairwise(chain):
                if not values[high] > values[low]:
                    unit = " MPa" if next((p.unit for p in self.own if p.name == high), "MPa") == "MPa" else ""
                    why = getattr(self.file, "WHY", "it must rise")
                    return high, f"is {values[high]:g}{unit}; expected more than {low} = {values[low]:g}{unit} ({why})"
        return None

    def doubts(self, values: Any) -> str | None:
        """What is doubtful about the dissipation by these values, None where nothing is."""
        remark = getattr(self.file, "dissipation_remark", None)
        return None if remark is None else remark(values)

    def exchanged(self, names: Iterable[str], other: Hardening) -> tuple[str, ...]:
        """Names of what is fitted, with what this law frees in place of what the other one frees."""
        if set(self.fitted) == set(other.fitted):
            return tuple(names)
        out: list[str] = []
        for name in names:
            out += self.fitted if name in other.fitted else (name,)
        return tuple(dict.fromkeys(out))


_LAWS: dict[str, Hardening] = {}


def hardening_laws() -> tuple[Hardening, ...]:
    """All laws, by number."""
    return tuple(sorted(_LAWS.values(), key=lambda law: law.number))


def hardening(which: str | int) -> Hardening:
    """The law of that name or number. StudyError where there is none."""
    return held_by(which, _LAWS.values(), "hardening law")


def law_of_file(file: ModuleType, name: str, number: int) -> Hardening:
    """The law that a module declares. StudyError that names what is missing or wrong."""
    where = checked_file(file, name, "hardening law", _REQUIRED, lambda p: isinstance(p, str))
    if not file.PARAMS or file.PARAMS[0] != "M_y0":
        raise StudyError(f"{where}: PARAMS begins with {file.PARAMS[:1]}; expected 'M_y0', the yield stress at alpha = 0")
    if hasattr(file, "SMALL") and (hasattr(file, "NUMBERS") or not all(isinstance(p, str) for p in file.PARAMS)):
        raise StudyError(f"{where}: SMALL is given beside Params of its own; expected PARAMS that are names of the base law, or no SMALL")
    if len(getattr(file, "NUMBERS", ())) > len(SHARED):
        raise StudyError(f"{where}: {len(file.NUMBERS)} NUMBERS found; expected at most {len(SHARED)}")
    return Hardening(name, number, file)


def _discover() -> None:
    package = importlib.import_module(__package__)
    names = sorted(info.name for info in pkgutil.iter_modules(package.__path__) if info.name not in _NO_LAWS)
    files = {name: importlib.import_module(f"{__package__}.{name}") for name in names}
    of_thesis = {name: file.MODEL for name, file in files.items() if hasattr(file, "MODEL")}
    others = (name for name in names if name not in of_thesis)
    numbered = {**of_thesis, **{name: k for k, name in enumerate(others, start=1 + max(of_thesis.values()))}}
    for name, file in files.items():
        _LAWS[name] = law_of_file(file, name, numbered[name])
        declare(_LAWS[name].own)


_discover()
