"""All yield surfaces: one file each in this folder, found by themselves, known by the name of the file.

A surface is an equivalent stress phi(S) in MPa, homogeneous of degree one in the deviatoric stress: flow begins where phi = sigma_y, in the
direction N = dphi/dS. Axis 1 of the law is the width of the sheet, axis 2 its rolling direction, axis 3 its thickness. A file gives

    PARAMS      names of Params of the base law (Hill's F to N) and Params of its own, called <surface>.<param>
    LITERATURE  names of its Params with values of a published material, where a start of it helps
    FORMULA, SOURCE, MEANING (what a study file says of its Params, by name)

and is one of two kinds:

    quadratic   (no `numbers`): phi^2 = S : G : S with the Hill tensor of (4.19); all kernels hold it, Params that it lacks are neutral
    transformed numbers(*Params) -> NUMBERS of law.transformed: an exponent and two linear transformations of the stress deviator;
                compiled, with all that calls it, when such a surface is first used

Further a file may give FITTED, names that a fit frees where the study says nothing, and `turned` (values by name) -> values of the same
sheet where its axes 1 and 2 change places; without it nothing changes.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Param, declare
from thermofit.core.slots import checked_file, held_by

DEFAULT = "hill"
"""The surface of a study that names none."""
HILL = ("F", "G", "H", "L", "M", "N")
"""Params of the Hill tensor (4.19)."""
COEFFICIENTS = ("12", "13", "21", "23", "31", "32", "44", "55", "66")
"""Places of the nine coefficients of a transformation, axes of the law: 44 is that of 23, 55 of 13, 66 of 12 (Barlat et al. 2005)."""
NUMBERS: tuple[str, ...] = ("surface_a", *(f"surface_{n}_c{at}" for n in (1, 2) for at in COEFFICIENTS))
"""Numbers of the law page that belong to a transformed surface: exponent, first and second transformation."""
_NO_SURFACES = ("catalogue",)
_REQUIRED = ("PARAMS", "FORMULA", "SOURCE", "MEANING")


@dataclass(frozen=True)
class Surface:
    """One surface: its name, the number that the law page knows it by, and its file."""

    name: str
    number: int
    file: ModuleType

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its Params."""
        return tuple(p if isinstance(p, str) else p.name for p in self.file.PARAMS)

    @property
    def own(self) -> tuple[Param, ...]:
        """Params that no other surface has."""
        return tuple(p for p in self.file.PARAMS if isinstance(p, Param))

    @property
    def quadratic(self) -> bool:
        """True for one that the Hill tensor holds, and with it all kernels."""
        return not hasattr(self.file, "numbers")

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names that a fit frees where nothing else is said."""
        return tuple(getattr(self.file, "FITTED", ()))

    def number_values(self, values: Any) -> tuple[Any, ...]:
        """Values of `NUMBERS`; `values[name]` gives that of a Param."""
        return tuple(self.file.numbers(*(values[name] for name in self.names)))

    def turned(self, values: Mapping[str, float]) -> dict[str, float]:
        """Changes of values of the same sheet with respect to axes 1 and 2 that have changed places."""
        return dict(self.file.turned(values)) if hasattr(self.file, "turned") else {}

    def exchanged(self, names: Iterable[str], other: Surface) -> tuple[str, ...]:
        """Names of what is fitted without Params that only the other surface has, and with what this one frees where it freed any."""
        names = tuple(names)
        if self.name == other.name:
            return names
        gone = {name for name in other.names if name not in self.names}
        freed = self.fitted if gone & set(names) else ()
        return tuple(dict.fromkeys((*(name for name in names if name not in gone), *freed)))


_SURFACES: dict[str, Surface] = {}


def surfaces() -> tuple[Surface, ...]:
    """All surfaces, by number."""
    return tuple(sorted(_SURFACES.values(), key=lambda one: one.number))


def surface(which: str | int) -> Surface:
    """The surface of that name or number. StudyError where there is none."""
    return held_by(which, _SURFACES.values(), "yield surface")


def surface_of_file(file: ModuleType, name: str, number: int) -> Surface:
    """The surface that a module declares. StudyError that names what is missing or wrong."""
    where = checked_file(file, name, "yield surface", _REQUIRED, lambda p: p in HILL)
    if not hasattr(file, "numbers") and any(isinstance(p, Param) for p in file.PARAMS):
        raise StudyError(f"{where}: numbers is missing beside Params of its own; expected numbers(*Params) -> exponent, 18 coefficients")
    if hasattr(file, "numbers") and any(isinstance(p, str) for p in file.PARAMS):
        raise StudyError(f"{where}: PARAMS holds names of Hill's tensor beside numbers; expected Params called {name}.<param> alone")
    return Surface(name, number, file)


def _discover() -> None:
    package = importlib.import_module(__package__)
    names = sorted(info.name for info in pkgutil.iter_modules(package.__path__) if info.name not in _NO_SURFACES)
    names = [DEFAULT, *(name for name in names if name != DEFAULT)]
    for number, name in enumerate(names):
        _SURFACES[name] = surface_of_file(importlib.import_module(f"{__package__}.{name}"), name, number)
        declare(_SURFACES[name].own)


_discover()
