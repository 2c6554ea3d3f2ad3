"""All effects: one file each, found by themselves; files of a user take part in the same way.

An effect is a module with SLOT, PARAMS, FORMULA, SOURCE and one function named like the slot. PARAMS holds its Params, called
<effect>.<param>, the amplitude first: at its neutral value the effect is exactly off, whatever the others are. Modules whose PARAMS are
names (text) belong to the base model.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

from thermofit.core.digest import effect_files
from thermofit.core.errors import StudyError
from thermofit.core.parameters import AT, Param, Parameters, bare_name, declare
from thermofit.effects.base import BASE as BASE_EFFECTS

MATERIAL = ("free_energy", "elasticity", "yield_stress", "yield_factor", "backstress", "asymmetry", "dissipation")
HEAT = ("heat_source", "surface_flux", "boundary_temperature", "capacity", "conductivity", "initial_temperature")
HEATING = (*HEAT, "dissipation")
"""Slots of effects that act in the heat equation and nowhere else: the mechanics feels them through the temperature alone."""
KINEMATICS = ("kinematics",)
"""Motion of the specimen that its model does not have; it acts on the displacements before any instrument."""
AXIAL = ("axial_temperature",)
"""Temperature of the sections of a row, which a heating holds; only rows of sections feel it."""
LOAD = ("load",)
"""Between the machine's record of force and crosshead and what acts on the end of the specimen."""
BASE = ("base",)
"""Mechanisms of the base law itself (effects.base), which act in its kernels and not through a function of their own."""
MEASUREMENT = ("emission", "reflection", "optics", "sensor", "camera")
"""Stations of the measuring chain in their physical order; `camera` is that of the displacements."""
FILE_SLOTS = (*MATERIAL, *HEAT, *AXIAL, *LOAD, *KINEMATICS, *MEASUREMENT)
"""Slots that an effect file may act in."""
SLOTS = (*BASE, *FILE_SLOTS)
NO_EFFECTS = ("base", "catalogue", "curve", "scene")
_REQUIRED = ("SLOT", "PARAMS", "FORMULA", "SOURCE")
PLACE_AND_TIME = ("time", "x", "y")
"""Arguments before the Params of a heat source that depends on nothing else, in the stead of (theta, accumulated, rate, time, x, y)."""
ACROSS = "across"
"""The fourth argument of a heat source of place and time that knows how far across the specimen it is: x over half the width there."""
HEIGHT = "y"
"""The fourth argument of a surface flux that depends on the place along the load, behind (theta, time, surroundings)."""
ON_FACETS = ("surface_flux", "boundary_temperature")
"""Slots of effects that act on facet sets, which the module constant ON names."""
FACET_KINDS = ("air", "clamp")


@dataclass(frozen=True)
class Effect:
    """One mechanism: its slot, its Params (amplitude first), formula and source in words, and the function that acts in the slot."""

    name: str
    slot: str
    params: tuple[Param, ...]
    formula: str
    source: str
    act: Callable[..., Any]
    stored: bool = False
    """True for hardening whose work is stored in the material, not dissipated (slot yield_stress)."""
    reciprocal: bool = False
    """True where the data are linear in one over the amplitude."""
    on: tuple[str, ...] = ()
    """Kinds of facet sets, "air" or "clamp", that it acts on (slots surface_flux, boundary_temperature)."""
    span: float = 0.0
    """K; the temperatures at which the specimens flow must lie so far apart for the effect to be told from others (SPAN). Only coupon
    records can; 0: it needs none."""
    last: bool = False
    """True for one that names nothing: it takes what no other effect explains."""
    twin: Callable[[Parameters], dict[str, float]] | None = None
    """New values, from those of all parameters, of its Params and of others that say the same with both exchanged; None where nothing else
    is of its form."""
    of_user: bool = False
    """True where it stands in a file of the user's, not in the catalogue."""
    of_place: Callable[..., Any] | None = None
    """The function of (time, x, y, across, *params) of a heat source that depends on nothing else, `across` being x over half the width
    of the specimen; None of others. `act` is that of them all, and takes it in the middle of the width."""

    @property
    def amplitude(self) -> Param:
        """The Param that switches the effect."""
        return self.params[0]

    @property
    def amplitudes(self) -> tuple[Param, ...]:
        """Params that switch the effect: all without `scan`. It is off where all of them are neutral."""
        return tuple(p for p in self.params if not p.scan)

    def is_on(self, parameters: Parameters) -> bool:
        """Whether any of its amplitudes is not neutral."""
        return any(parameters[p.name] != p.neutral for p in self.amplitudes)

    @property
    def exponents(self) -> tuple[Param, ...]:
        """Params that are fitted once the amplitude is known: those of which several values are scanned, and those that follow."""
        return tuple(p for p in self.params if len(p.scan) > 1 or p.follows)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the Params."""
        return tuple(p.name for p in self.params)


EFFECTS: dict[str, Effect] = {}


def effects(slots: tuple[str, ...] = SLOTS) -> tuple[Effect, ...]:
    """Effects of the given slots, in the order of the slots, then by name."""
    found = [effect for effect in EFFECTS.values() if effect.slot in slots]
    return tuple(sorted(found, key=lambda effect: (slots.index(effect.slot), effect.name)))


def effect(name: str) -> Effect:
    """The effect of that name; <effect>@<experiment> is that of one experiment alone. StudyError where there is none."""
    bare, at, experiment = name.partition(AT)
    if bare not in EFFECTS:
        raise StudyError(f"effect '{bare}' is not known; known are {', '.join(sorted(EFFECTS))}")
    found = EFFECTS[bare]
    if not at:
        return found
    return replace(found, name=name, params=tuple(replace(p, name=f"{p.name}{AT}{experiment}") for p in found.params))


def effect_of_param(name: str) -> Effect:
    """The effect that a Param <effect>.<param>, or <effect>.<param>@<experiment>, belongs to. StudyError where there is none."""
    bare, at, experiment = name.partition(AT)
    return effect(f"{bare.partition('.')[0]}{at}{experiment}")


def is_of_effect(name: str) -> bool:
    """True for the name of a Param that belongs to an effect, not to the base law or one of its hardening laws."""
    return "." in bare_name(name) and bare_name(name).partition(".")[0] in EFFECTS


def effect_of(module: ModuleType, name: str) -> Effect | None:
    """The effect that a module declares, None for a module of the base model. StudyError that names what is missing or wrong."""
    where = module.__file__ or name
    if missing := [key for key in _REQUIRED if not hasattr(module, key)]:
        raise StudyError(
            f"{where}: {missing[0]} is missing; an effect file gives {', '.join(_REQUIRED)} and a function named like its slot"
        )
    slot, params = module.SLOT, module.PARAMS
    if slot not in FILE_SLOTS:
        raise StudyError(f"{where}: SLOT is {slot!r}; expected one of {', '.join(FILE_SLOTS)}")
    if params and all(isinstance(p, str) for p in params):
        return None
    for p in params:
        if not isinstance(p, Param) or p.name.partition(".")[0] != name:
            raise StudyError(f"{where}: PARAMS holds {p!r}; expected Param('{name}.<param>', unit, neutral, lower, upper, scale, meaning)")
    if not params or params[0].probe is None:
        raise StudyError(f"{where}: the first of PARAMS is the amplitude and needs a probe, a value at which the effect is plainly visible")
    act = getattr(module, slot, None)
    if act is None:
        raise StudyError(f"{where}: no function '{slot}' found; expected one that acts in the slot {slot}")
    on = getattr(module, "ON", ())
    if slot in ON_FACETS and (not isinstance(on, tuple) or not on or not set(on) <= set(FACET_KINDS)):
        raise StudyError(f"{where}: ON is {on!r}; expected a tuple of {', '.join(FACET_KINDS)}: the facet sets that the effect acts on")
    stored = bool(getattr(module, "STORED", False))
    span = float(getattr(module, "SPAN", 0.0))
    last = bool(getattr(module, "LAST", False))
    twin = getattr(module, "twin", None)
    takes = tuple(inspect.signature(act).parameters) if slot in HEAT else ()
    of_place = act if slot == "heat_source" and takes[:3] == PLACE_AND_TIME else None
    if of_place is not None:
        of_place = of_place if takes[3:4] == (ACROSS,) else partial(_all_across, of_place)
        act = partial(_whatever_flows, of_place)
    elif slot == "surface_flux" and takes[3:4] != (HEIGHT,):
        act = partial(_at_any_height, act)
    return Effect(
        name,
        slot,
        tuple(params),
        module.FORMULA,
        module.SOURCE,
        act,
        stored=stored,
        on=on,
        span=span,
        last=last,
        twin=twin,
        of_place=of_place,
    )


def _all_across(of_place: Callable[..., Any], time: Any, x: Any, y: Any, across: Any, *numbers: Any) -> Any:
    """A heat source that does not ask how far across it is, called as those that do."""
    return of_place(time, x, y, *numbers)


def _whatever_flows(of_place: Callable[..., Any], theta: Any, accumulated: Any, rate: Any, time: Any, x: Any, y: Any, *numbers: Any) -> Any:
    """A heat source of place and time, called as all of them are, where nothing says how wide the specimen is: in its middle."""
    return of_place(time, x, y, 0.0 * x, *numbers)


def _at_any_height(flux: Callable[..., Any], theta: Any, time: Any, surroundings: Any, y: Any, *numbers: Any) -> Any:
    """A surface flux that is the same along the load, called as all of them are."""
    return flux(theta, time, surroundings, *numbers)


def load_effect(path: Path) -> Effect:
    """Take in the effect of a user's file; its name is that of the file. StudyError where the file does not hold one."""
    name = path.stem
    spec = importlib.util.spec_from_file_location(f"thermofit_user_effect_{name}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise StudyError(f"{path}: no Python file found; expected an effect file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # compiled kernels name it when they are read from the cache
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise StudyError(f"{path}: the effect file does not run ({type(error).__name__}: {error}); correct it") from error
    found = effect_of(module, name)
    if found is None:
        raise StudyError(f"{path}: PARAMS holds names; expected Param objects called {name}.<param>")
    found = replace(found, of_user=True)
    _take(found)
    return found


def _take(found: Effect) -> None:
    declare(found.params)
    EFFECTS[found.name] = found


def _in_the_kernels(*_: Any) -> Any:
    """Stands for the function of an effect of the base law."""
    raise StudyError("an effect of the base law has no function of its own: its Params act in the kernels")


def _discover() -> None:
    for e in BASE_EFFECTS:
        EFFECTS[e.name] = Effect(e.name, BASE[0], e.params, e.formula, e.source, _in_the_kernels, reciprocal=e.reciprocal)
    package = importlib.import_module("thermofit.effects")
    for info in sorted(pkgutil.iter_modules(package.__path__), key=lambda i: i.name):
        if info.name in NO_EFFECTS:
            continue
        found = effect_of(importlib.import_module(f"thermofit.effects.{info.name}"), info.name)
        if found is not None:
            _take(found)


_discover()
for _path in effect_files():
    load_effect(_path)
