"""What a material card says: the yield curve of the identified law, Hill's constants, heat, the range that the test visited, the effects.

A table of yield stress holds the law along axis 2 of the sheet, the direction of the load where the material axes are not turned. By the
yield surface (4.19) flow along it begins at sigma = M_y / sqrt(F + H); since sigma d(eps_p) = M_y dLambda, the plastic strain along it is
eps_p = sqrt(F + H) Lambda; of another surface phi of unit tension takes the place of sqrt(F + H). Every other direction follows from the
ratios of the surface. Stress is in MPa, strain
logarithmic. The law gives Kirchhoff stress; Cauchy stress, which other programmes take, is smaller by (1 - 2 nu) sigma / E, about 0.1 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermofit.body.heat.conduction import at_constant_stress, heat_conditions
from thermofit.core.parameters import Parameters
from thermofit.core.slots import Slots
from thermofit.effects.catalogue import FILE_SLOTS, effects
from thermofit.law.composition import FACTORS, SUMS, modulus_factor, warm_moduli
from thermofit.law.hardening.catalogue import LINEAR, hardening
from thermofit.law.page import along_tension, hardening_variable, law_in_step, law_of, released_energy, yield_stress_at_rate
from thermofit.law.surface.catalogue import DEFAULT, surface
from thermofit.records.artefact import Record

IN_TABLE = (*SUMS, "yield_factor", "elasticity")
"""Slots of effects that the tables of yield stresses and of moduli hold."""
IN_HEAT = FACTORS[1:]
"""Slots of effects that the share of plastic work which becomes heat holds."""
EXTRAPOLATED_TO = 1.0
"""Plastic strain to which a table goes on beyond what the test has visited, by the law."""
_POINTS = 60
_BEYOND = 40
_SMALLEST = 1e-4
_SAME = 1e-9
"""Relative difference of yield stresses from which a rate or a temperature counts."""


@dataclass(frozen=True)
class Visited:
    """What the test went through: largest plastic strain along the load, plastic strain rates 1/s and temperatures K, each (low, high), and
    in words where the strain is from."""

    strain: float
    rate: tuple[float, float]
    temperature: tuple[float, float]
    source: str

    @property
    def middle_rate(self) -> float:
        """The rate that a table without rates refers to, 1/s."""
        return float(np.sqrt(self.rate[0] * self.rate[1]))

    @property
    def middle_temperature(self) -> float:
        """The temperature that a table without temperatures refers to, K."""
        return 0.5 * (self.temperature[0] + self.temperature[1])


@dataclass(frozen=True)
class FlowCurve:
    """Yield stress MPa (n,) over plastic strain (n,) along axis 2, at a plastic strain rate 1/s and a temperature K."""

    rate: float
    theta: float
    strain: np.ndarray
    stress: np.ndarray


@dataclass(frozen=True)
class ActingEffect:
    """An effect of the identified model: its formula, values of its Params by name, and whether the card holds it."""

    name: str
    formula: str
    values: Mapping[str, float]
    held: bool


@dataclass(frozen=True)
class Card:
    """A material in N, mm, s, K: constants, standard errors by name, yield curves, heat and range of validity.

    `capacity` is that of constant stress, mJ/(mm^3 K): programmes without the heat of elastic expansion need it. `heat_share` is the part
    of the plastic work that became heat up to the largest strain of the test. `moduli`: temperature K and Young's modulus MPa there, one
    pair where it does not change.
    """

    name: str
    parameters: Parameters
    sigma: Mapping[str, float]
    law: str
    formula: str
    moduli: tuple[tuple[float, float], ...]
    curves: tuple[FlowCurve, ...]
    capacity: float
    heat_share: float
    visited: Visited
    effects: tuple[ActingEffect, ...]
    angle: float
    slots: Slots = Slots()
    surface: str = DEFAULT
    surface_formula: str = ""

    @property
    def transformed(self) -> tuple[float, ...] | None:
        """Exponent and the coefficients of both transformations in the axes of the law, in the order of `law.surface.catalogue.NUMBERS`,
        scaled so that phi is the stress of tension along axis 2; None for a quadratic surface."""
        yields = surface(self.surface)
        if yields.quadratic:
            return None
        a, *c = yields.number_values(self.parameters)
        along, _ = along_tension(self.parameters, self.slots)
        return (a, *(value / along for value in c))

    @property
    def hill(self) -> tuple[float, float, float, float, float, float]:
        """Constants of (11-22)^2, (33-11)^2, (22-33)^2, 2 (12)^2, 2 (23)^2, 2 (13)^2; the yield stress along axis 2 is that of the
        table."""
        p = self.parameters
        size = p["F"] + p["H"]
        constants = tuple(float(p[name]) / size for name in ("F", "G", "H", "L", "M", "N"))
        return constants  # type: ignore[return-value]

    @property
    def isotropic(self) -> bool:
        """True where the surface is that of von Mises."""
        return self.transformed is None and bool(np.allclose(self.hill, (0.5, 0.5, 0.5, 1.5, 1.5, 1.5), rtol=1e-9))

    @property
    def of_rates(self) -> bool:
        """Whether the table has several rates."""
        return len({c.rate for c in self.curves}) > 1

    @property
    def of_temperatures(self) -> bool:
        """Whether the table has several temperatures."""
        return len({c.theta for c in self.curves}) > 1

    @property
    def young(self) -> float:
        """The one Young's modulus in MPa of a programme that takes one: at the temperature of its curve."""
        theta, moduli = np.array(self.moduli).T
        return float(np.interp(self.reference.theta, theta, moduli))

    @property
    def reference(self) -> FlowCurve:
        """The one curve of a programme that takes one."""
        middle = (self.visited.middle_rate, self.visited.middle_temperature)
        return min(self.curves, key=lambda c: abs(np.log(c.rate / middle[0])) + abs(c.theta / middle[1] - 1.0))


def card_of(name: str, parameters: Parameters, verified: Record, tests: Sequence[Record] = ()) -> Card:
    """The card of the verified model of a run; `tests`: the records of its experiments, where there are several."""
    config = verified.config
    which = Slots(config.get("hardening") or config["model"], config.get("yield_surface", DEFAULT))
    law_file, yields = hardening(which.hardening), surface(which.surface)
    visited = visited_by((verified, *tests), parameters, which)
    used = {n: p.sigma for n, p in verified.parameters.items() if p.sigma is not None}
    linear = f" + H_lin Lambda, H_lin = {parameters[LINEAR]:.6g} MPa" if parameters[LINEAR] else ""
    law = law_of(parameters, which)
    return Card(
        name=name,
        parameters=parameters,
        sigma=used,
        law=law_file.name,
        formula=law_file.file.FORMULA + linear,
        moduli=_moduli(parameters, which, visited),
        curves=_curves(parameters, which, visited),
        capacity=float(at_constant_stress(heat_conditions(parameters), law).c0),
        heat_share=heat_share(parameters, which, visited),
        visited=visited,
        effects=_acting(parameters),
        angle=float(config.get("material_axes", {}).get("angle", 0.0)),
        slots=which,
        surface=yields.name,
        surface_formula=yields.file.FORMULA,
    )


Which = int | str | Slots
"""Hardening law, or with it the yield surface."""


def flow_curve(parameters: Parameters, which: Which, strain: np.ndarray, rate: float, theta: float) -> FlowCurve:
    """Yield stress along axis 2 at plastic strains (n,) of monotonic flow, at one plastic strain rate in 1/s and one temperature in K."""
    law, (along, _) = law_of(parameters, which), along_tension(parameters, which)
    stress = np.empty(len(strain))
    for n, value in enumerate(strain):
        multiplier = float(value) / along
        alpha = hardening_variable(0.0, multiplier, law)[0]
        stress[n] = yield_stress_at_rate(alpha, multiplier, rate / along, theta, law) / along
    return FlowCurve(rate, theta, strain, stress)


def _strains(largest: float) -> np.ndarray:
    """Plastic strains of a table: fine where the curve bends, the largest one of the test among them, then on by the law."""
    inside = np.concatenate([[0.0], np.geomspace(min(_SMALLEST, 0.1 * largest), largest, _POINTS)])
    if largest >= EXTRAPOLATED_TO:
        return inside
    return np.concatenate([inside, np.geomspace(largest, EXTRAPOLATED_TO, _BEYOND + 1)[1:]])


def _curves(parameters: Parameters, which: Which, visited: Visited) -> tuple[FlowCurve, ...]:
    """One curve, or one for each rate and temperature at which the law differs within what the test has visited."""
    strain = _strains(visited.strain)
    rates, temperatures = [visited.middle_rate], [visited.middle_temperature]

    def differs(first: FlowCurve, second: FlowCurve) -> bool:
        return bool(np.any(np.abs(first.stress - second.stress) > _SAME * first.stress))

    at_middle = [flow_curve(parameters, which, strain, rate, temperatures[0]) for rate in visited.rate]
    if visited.rate[1] > visited.rate[0] and differs(*at_middle):
        rates = list(np.geomspace(*visited.rate, 5))
    hot = [flow_curve(parameters, which, strain, rates[0], theta) for theta in visited.temperature]
    if visited.temperature[1] > visited.temperature[0] and differs(*hot):
        temperatures = list(np.linspace(*visited.temperature, 3))
    return tuple(flow_curve(parameters, which, strain, float(rate), float(theta)) for theta in temperatures for rate in rates)


def _moduli(parameters: Parameters, which: Which, visited: Visited) -> tuple[tuple[float, float], ...]:
    """Young's modulus at temperatures that the test has visited, before any flow; at the middle one alone where it does not change."""
    law, (low, high) = law_of(parameters, which), visited.temperature
    if not warm_moduli.py_func(law):
        return ((visited.middle_temperature, parameters["E"]),)
    thetas = np.linspace(low, high, 5) if high > low else np.array([low])
    return tuple((float(theta), float(parameters["E"] * modulus_factor(0.0, float(theta), law))) for theta in thetas)


def heat_share(parameters: Parameters, which: Which, visited: Visited) -> float:
    """Dissipated energy over plastic work of monotonic flow up to the largest strain of the test, at its middle rate and temperature."""
    along, theta, rate = along_tension(parameters, which)[0], visited.middle_temperature, visited.middle_rate
    multiplier = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 400)]) * visited.strain / along
    work = dissipated = before = 0.0
    for n in range(1, len(multiplier)):
        step = float(multiplier[n] - multiplier[n - 1])
        law = law_in_step(law_of(parameters, which), step * along / rate)
        alpha = hardening_variable(before, step, law)[0]
        dissipated += released_energy(before, alpha, step, float(multiplier[n]), theta, law)
        middle = hardening_variable(before, 0.5 * step, law)[0]
        work += step * yield_stress_at_rate(middle, float(multiplier[n]) - 0.5 * step, rate / along, theta, law)
        before = alpha
    return float(dissipated / work)


def _acting(parameters: Parameters) -> tuple[ActingEffect, ...]:
    """Effects whose amplitude is not neutral, beside the base law."""
    acting = [e for e in effects(FILE_SLOTS) if e.is_on(parameters)]
    held = (*IN_TABLE, *IN_HEAT)
    return tuple(ActingEffect(e.name, e.formula, {p.name: parameters[p.name] for p in e.params}, e.slot in held) for e in acting)


def visited_by(verified: Sequence[Record], parameters: Parameters, which: Which = 2) -> Visited:
    """Range of the tests by the model of their verification: of a specimen under cameras the mean strain of its window, of records of
    coupons what each went through, flow of all cycles added up."""
    windows = [found for record in verified if (found := _in_window(record, parameters)) is not None]
    coupons = [found for record in verified for found in _in_records(record, along_tension(parameters, which)[0])]
    if not windows and not coupons:
        return _visited(np.zeros(1), np.zeros(0), np.array([parameters["theta_ref"]]), "this run holds no curve: nothing is known")
    plastic, rate, theta = (np.concatenate(values) for values in zip(*windows, *coupons, strict=True))
    told = ["mean of the evaluation window; a neck goes further"] if windows else []
    told += [f"{len(coupons)} records, flow added up"] if coupons else []
    return _visited(plastic, rate, theta, "; ".join(told))


_Course = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Plastic strains along the load, their rates in 1/s, and temperatures in K, each (n,)."""


def _in_window(record: Record, parameters: Parameters) -> _Course | None:
    folder = "curves/stress_stretch"
    if not record.has(f"{folder}/step_stretch"):
        return None
    stretch, time = (record[f"{folder}/step_{key}"].value for key in ("stretch", "time"))
    stress = record[f"{folder}/step_stress"].value * stretch
    plastic = np.maximum.accumulate(np.log(stretch) - stress / parameters["E"])
    thetas = [record[f"theta/{key}"].value for key in ("value", "predicted") if record.has(f"theta/{key}")]
    seen = np.concatenate([t[np.isfinite(t)] for t in thetas]) if thetas else np.array([parameters["theta_ref"]])
    return plastic, np.diff(plastic) / np.diff(time), seen


def _in_records(record: Record, along: float) -> Iterator[_Course]:
    for name in sorted(n.rpartition("/")[0] for n in record.names if n.startswith("curves/") and n.endswith("/accumulated")):
        plastic, time = along * record[f"{name}/accumulated"].value, record[f"{name}/time"].value
        yield plastic, np.diff(plastic) / np.diff(time), record[f"{name}/theta"].value


_LITTLE = 0.05
"""Share of the largest plastic strain rate below which a test does not flow to speak of."""


def _visited(plastic: np.ndarray, rate: np.ndarray, theta: np.ndarray, source: str) -> Visited:
    flowing = rate[np.isfinite(rate) & (rate > 0.0)]
    flowing = flowing[flowing > _LITTLE * flowing.max()] if flowing.size else np.array([1e-3])
    low, high = (float(v) for v in np.quantile(flowing, (0.05, 0.95)))
    largest = max(float(np.max(plastic, initial=0.0)), _SMALLEST)
    return Visited(largest, (low, high), (float(theta.min()), float(theta.max())), source)
