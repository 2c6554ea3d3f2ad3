"""Param and Parameters: one number of the law, and the named vector of all of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import StudyError


@dataclass(frozen=True)
class Param:
    """One number of the law: `neutral` switches it off where that is possible, `scale` is its usual size.

    `lower` and `upper` are the physical bounds: a study may narrow them, never widen them.
    """

    name: str
    unit: str
    neutral: float
    lower: float
    upper: float
    scale: float
    meaning: str
    probe: float | None = None
    """A value at which the effect of this Param is plainly visible; None for those of the base law."""
    scan: tuple[float, ...] = ()
    """Values tried for a Param that cannot be felt while its effect is off (an exponent, a time); empty for an amplitude."""
    scan_of: str = ""
    """What the values of `scan` are shares of: "time" of the time between begin and end of the test (a moment), "duration" of its length,
    "strain" of the largest plastic strain Lambda, "place" of the observed height between its lower and upper end (a y), "length" of that
    height; empty: they are values."""
    follows: bool = False
    """True for a Param of which one value is tried, and which is fitted as soon as the amplitude is known; else one value is kept."""
    logarithmic: bool = False
    """True where the order of magnitude is what is known: it is fitted by its logarithm."""
    limiting: bool = False
    """True where the bounds are the ends of a family of forms, such as a window with sharp ends: a value there is a form as any other, and
    no sign that the data ask for more."""
    prior: float | None = None
    """Standard error, in `unit`, of what was declared (by a thermocouple, or as neutral): a departure from it counts against it in a joint
    fit. None: nothing was."""
    acts: tuple[str, ...] = ()
    """Where a Param of the base law acts: "stress" of a uniaxial test, strain and yield "across" the load, thermal "expansion", "heat" made
    and held at a point, "conduction", "film" to the surroundings, "reference" state, "coupon": its heat balance and sensor. Of an effect
    the slot says it."""


_INF = float("inf")
AT = "@"
"""Between a parameter and the experiment that alone it belongs to: alpha_air@second."""

THERMOCOUPLE = 0.1
"""Standard error of a declared temperature of air or jaws, K."""

LAW: tuple[Param, ...] = (
    Param("E", "MPa", 69000.0, 1.0, 1e7, 7e4, "Young's modulus", acts=("stress",)),
    Param("nu", "1", 0.33, 0.0, 0.499, 0.3, "Poisson's ratio", acts=("across",)),
    Param("M_y0", "MPa", 130.0, 1e-3, 1e5, 1e2, "initial yield limit (4.19)", acts=("stress",)),
    Param("M_yinf", "MPa", 290.0, 1e-3, 1e5, 3e2, "exponential hardening limit (4.6), (4.28)", acts=("stress",)),
    Param("H_exp", "1", 11.0, 1e-3, 1e4, 1e1, "exponential saturation speed (4.6), (4.27)", acts=("stress",)),
    Param("H_lin", "MPa", 0.0, 0.0, 1e5, 1e2, "linear hardening modulus (4.6)", acts=("stress",)),
    Param("F", "1", 0.5, 1e-3, 1e2, 0.5, "Hill parameter of (M11 - M22)^2 (4.19)", acts=("across",)),
    Param("G", "1", 0.5, 1e-3, 1e2, 0.5, "Hill parameter of (M33 - M11)^2 (4.19)", acts=("across",)),
    Param("H", "1", 0.5, 1e-3, 1e2, 0.5, "Hill parameter of (M22 - M33)^2 (4.19)", acts=("across",)),
    Param("L", "1", 1.5, 1e-3, 1e2, 1.5, "Hill parameter of M12 (4.19)", acts=("across",)),
    Param("M", "1", 1.5, 1e-3, 1e2, 1.5, "Hill parameter of M23 (4.19)", acts=("across",)),
    Param("N", "1", 1.5, 1e-3, 1e2, 1.5, "Hill parameter of M13 (4.19)", acts=("across",)),
    Param("alpha_exp", "1/K", 0.0, 0.0, 1e-3, 2e-5, "thermal expansion coefficient (4.4)", acts=("expansion",)),
    Param("kappa", "mW/(mm K)", 150.0, 1e-3, 1e5, 1.5e2, "thermal conductivity (4.12)", acts=("conduction",)),
    Param("c0", "mJ/(mm^3 K)", 2.4, 1e-3, 1e2, 2.0, "heat capacity at constant elastic deformation (4.3)", acts=("heat",)),
    Param("beta", "1", 1.0, 0.0, 1e2, 1.0, "dissipation factor (4.5), not a Taylor-Quinney factor", acts=("heat",)),
    Param("alpha_air", "W/(m^2 K)", 0.0, 0.0, 1e5, 1e1, "film coefficient to the air (4.13)", acts=("film",)),
    Param("alpha_clamp", "W/(m^2 K)", 1e8, 0.0, 1e9, 1e2, "contact coefficient to the jaws (4.13)", acts=("film",)),
    Param("theta_air", "K", 297.0, 200.0, 1000.0, 1.0, "air temperature (4.13)", acts=("film", "coupon"), prior=THERMOCOUPLE),
    Param("theta_clamp", "K", 297.0, 200.0, 1000.0, 1.0, "jaw temperature (4.13)", acts=("film",), prior=THERMOCOUPLE),
    Param("theta_ref", "K", 297.0, 200.0, 1000.0, 1.0, "stress-free reference temperature theta_0 (4.3)", acts=("reference",)),
    Param("tau", "s", 1e12, 1e-3, 1e12, 1e2, "time constant of the heat loss of a coupon", acts=("coupon",)),
    Param("lag", "s", 0.0, 0.0, 1e3, 1.0, "time constant of the temperature sensor on a coupon", acts=("coupon",)),
)

NAMES: tuple[str, ...] = tuple(param.name for param in LAW)
_BY_NAME = {param.name: param for param in LAW}
OF_EFFECTS: dict[str, Param] = {}
_LOAD_MODE = "load mode "


def acting(*where: str) -> tuple[str, ...]:
    """Names of the Params of the base law that act in any of these places (`Param.acts`)."""
    return tuple(p.name for p in LAW if set(p.acts) & set(where))


THERMOCOUPLES: tuple[str, ...] = tuple(p.name for p in LAW if p.prior is not None)
"""Temperatures that are declared with a standard error."""


def load_modes(n: int) -> tuple[str, ...]:
    """Names of n changes of what drives a run, along which it can be differentiated as along Params. They have no value."""
    return tuple(f"{_LOAD_MODE}{k}" for k in range(n))


def load_mode(name: str) -> int:
    """Which change of what drives a run the name stands for, -1 where it is that of a Param."""
    return int(name.removeprefix(_LOAD_MODE)) if name.startswith(_LOAD_MODE) else -1


def declare(params: Iterable[Param]) -> None:
    """Make the Params of an effect known, named <effect>.<param>. StudyError for a name without a dot, or declared with other content."""
    for one in params:
        if "." not in one.name or one.name in _BY_NAME:
            raise StudyError(f"parameter '{one.name}' of an effect: expected a name of the form <effect>.<param>")
        if OF_EFFECTS.setdefault(one.name, one) != one:
            raise StudyError(f"parameter '{one.name}' is declared twice with different content; give the effect another name")


def known_names() -> tuple[str, ...]:
    """Names of all Params: those of the base law, then those of the effects."""
    return (*NAMES, *OF_EFFECTS)


def is_known(name: str) -> bool:
    """True for the name of a Param, also where it is that of one experiment (<param>@<experiment>)."""
    bare = bare_name(name)
    return bare in _BY_NAME or bare in OF_EFFECTS


def bare_name(name: str) -> str:
    """The name without the experiment."""
    return name.partition(AT)[0]


def param(name: str) -> Param:
    """The Param of that name; StudyError where there is none."""
    found = _BY_NAME.get(name) or OF_EFFECTS.get(name)
    if found is None and AT in name:
        return replace(param(bare_name(name)), name=name)
    if found is None:
        raise StudyError(f"parameter '{name}' is not known; known are {', '.join(known_names())}")
    return found


def physical_bounds(name: str) -> tuple[float, float]:
    """Lower and upper physical bound of the Param of that name."""
    return param(name).lower, param(name).upper


def units_of(names: Iterable[str]) -> tuple[str, ...]:
    """Units of the named Params."""
    return tuple(param(name).unit for name in names)


@dataclass(frozen=True)
class Parameters:
    """Named vector of all Params and which are free. Immutable: `replace` returns a new one.

    `values` holds every Param of the base law and those of effects that are not neutral; any other Param reads as its neutral value,
    that of one experiment as the common one.
    """

    values: Mapping[str, float]
    free: tuple[str, ...] = ()

    @staticmethod
    def of(values: Mapping[str, float], free: Iterable[str] = ()) -> Parameters:
        """Parameters from given values; what is not given is neutral. StudyError for an unknown name."""
        free = tuple(free)
        for name in (*values, *free):
            param(name)
        full = {p.name: float(values.get(p.name, p.neutral)) for p in LAW}
        full |= {name: float(v) for name, v in values.items() if name not in full and (AT in name or v != param(name).neutral)}
        return Parameters(full, tuple(free))

    def __getitem__(self, name: str) -> float:
        if name in self.values:
            return self.values[name]
        return self[bare_name(name)] if AT in name else param(name).neutral

    def given(self) -> tuple[str, ...]:
        """Names of the base law, then of the Params of effects that are free or not neutral."""
        extra = [name for name in (*self.values, *self.free) if name not in _BY_NAME]
        return (*NAMES, *dict.fromkeys(extra))

    def replace(self, **changes: float) -> Parameters:
        """A copy with some values changed."""
        return Parameters.of({**self.values, **changes}, self.free)

    def with_free(self, free: Iterable[str]) -> Parameters:
        """A copy with other free names."""
        return Parameters.of(self.values, free)

    def vector(self) -> np.ndarray:
        """Values of the free parameters, in the order of `free`, shape (n_free,)."""
        return np.array([self[name] for name in self.free])

    def with_vector(self, x: np.ndarray) -> Parameters:
        """A copy with the free values taken from x, shape (n_free,)."""
        return self.replace(**{name: float(v) for name, v in zip(self.free, x, strict=True)})
