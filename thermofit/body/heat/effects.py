"""Effects of the heat problem: what the files of the catalogue (slots of HEAT) add to a step of the heat equation.

    surface_flux(theta, time, surroundings, *params)              outward flux, mW/mm^2 of current area, on the facet sets of ON; where
                                                                  it depends on the height
                                                                  surface_flux(theta, time, surroundings, y, *params)
    boundary_temperature(y, time, elapsed, *params)               change of the medium's temperature, K, on the facet sets of ON
    heat_source(theta, accumulated, rate, time, x, y, *params)    power, mW/mm^3 of reference volume; where it depends on place and
                                                                  time alone heat_source(time, x, y, *params), or
                                                                  heat_source(time, x, y, across, *params), x over half the width
    capacity(theta, theta_ref, *params)                           factor of c0
    conductivity(theta, theta_ref, *params)                       factor of kappa
    initial_temperature(x, y, length, *params)                    excess over the steady temperature at the first time, K

x, y mm are reference coordinates, y from the middle of the body. All take arrays and allow complex numbers. What depends on the
temperature is taken about that of the middle of the step (theta_m), so that the scheme stays of order 2; fluxes keep their slope:

    q(theta) = q(theta_m) + dq/dtheta(theta_m) (theta - theta_m).

Factors f and fluxes act at the nodes: (K_f theta)_a = sum_b (f_a + f_b)/2 K_ab (theta_b - theta_a), C_f = (f C + C f)/2, and
q_a int N_a da. They keep the symmetry of the matrices and the balance of heat, and the order 2 in the mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from thermofit.body.body import Body, ThermalGeometry, about_middle
from thermofit.body.solve.linear import multiply_symmetric
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import HEAT, effects
from thermofit.law.page_rates import STEP

Number = Any
"""A float, or a complex number where a derivative is taken."""
_GAUSS = np.polynomial.legendre.leggauss(4)
INSTANTS: tuple[tuple[float, float], ...] = tuple((0.5 * float(w), 0.5 + 0.5 * float(s)) for s, w in zip(*_GAUSS, strict=True))
"""Weights and instants, as parts of a step, of means over it."""


@dataclass(frozen=True)
class Acting:
    """One effect with the values of its Params."""

    name: str
    act: Callable[..., Any]
    on: tuple[str, ...]
    numbers: tuple[Number, ...]
    of_place: Callable[..., Any] | None = None
    """The function of (time, x, y, across, *numbers) of a heat source that depends on nothing else."""


@dataclass(frozen=True)
class HeatEffects:
    """The effects of the heat problem that are on, by slot; theta_ref K."""

    by_slot: Mapping[str, tuple[Acting, ...]]
    theta_ref: Number

    def of(self, slot: str, facets: str = "") -> tuple[Acting, ...]:
        """Effects of a slot; with the name of a facet set only those that act on it ("clamp_lower" is of the kind "clamp")."""
        found = self.by_slot.get(slot, ())
        return tuple(e for e in found if facets.partition("_")[0] in e.on) if facets else found

    def factor(self, slot: str, theta: np.ndarray) -> np.ndarray | None:
        """Product of the factors of slot capacity or conductivity at theta (n,) K; None where there are none."""
        found = self.of(slot)
        if not found:
            return None
        out = np.ones_like(theta)
        for e in found:
            out = out * e.act(theta, self.theta_ref, *e.numbers)
        if np.any(out.real <= 0.0):
            raise NumericsError(f"{found[0].name}: the factor of slot {slot} falls to {out.real.min():.3g}; it must stay positive")
        return out

    def flux(self, facets: str, theta: np.ndarray, time: float, surroundings: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Outward flux of all effects on a facet set at nodes y mm (n_np,) from the middle, mW/mm^2 (n_np,)."""
        return np.asarray(sum(e.act(theta, time, surroundings, y, *e.numbers) for e in self.of("surface_flux", facets)))

    def medium_change(self, facets: str, y: np.ndarray, time: float, first: float) -> np.ndarray:
        """Change of the temperature of the medium at a facet set, K (n_np,)."""
        found = self.of("boundary_temperature", facets)
        return np.asarray(sum((e.act(y, time, time - first, *e.numbers) for e in found), start=np.zeros_like(y)))

    def initial(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Excess over the steady temperature, K (n_np,)."""
        length = float(np.ptp(y))
        return np.asarray(sum((e.act(x, y, length, *e.numbers) for e in self.of("initial_temperature")), start=np.zeros_like(y)))


def heat_effects(parameters: Parameters) -> HeatEffects | None:
    """The effects of the heat problem that are on; None where there are none."""
    found: dict[str, tuple[Acting, ...]] = {}
    for e in effects(HEAT):
        if e.is_on(parameters):
            acting = Acting(e.name, e.act, e.on, tuple(parameters[name] for name in e.names), e.of_place)
            found[e.slot] = (*found.get(e.slot, ()), acting)
    return HeatEffects(found, parameters["theta_ref"]) if found else None


@dataclass(frozen=True)
class Moment:
    """Where a step stands: first time of the test and start of the step in s, temperature theta_m (n_np,) K about which it is linear."""

    first: float
    start: float
    middle: np.ndarray


@dataclass(frozen=True)
class Loads:
    """What the effects do in a step of `length` s: nodal factors (n_np,) of c0 and kappa (None: 1), per facet set the outward flux and its
    slope at theta_m (n_np,) in mW/mm^2 and per K, and the change of the medium's temperature at both stages (2, n_np) K."""

    moment: Moment
    length: float
    capacity: np.ndarray | None = None
    conductivity: np.ndarray | None = None
    flux: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    media: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def linearised(self) -> bool:
        """True where the matrices of the step depend on theta_m."""
        return bool(self.flux) or self.capacity is not None or self.conductivity is not None

    def flux_at(self, facets: str, theta: np.ndarray) -> np.ndarray:
        """Linearised outward flux at theta (n_np,) K, mW/mm^2."""
        q, slope = self.flux[facets]
        return np.asarray(q + slope * (theta - self.moment.middle))


Media = Mapping[str, tuple[Number, Number]]
"""Film coefficient and medium temperature of every facet set."""


def loads_of(body: Body, effect: HeatEffects, films: Media, moment: Moment, step: tuple[float, tuple[float, float]]) -> Loads:
    """Loads of a step = (length s, parts of it at which its two stages end)."""
    length = step[0]
    _, y = about_middle(body)
    flux, media = {}, {}
    for facets, (_, medium) in films.items():
        if effect.of("surface_flux", facets):
            q = mean_flux(effect, (facets, medium, y), moment.middle, moment, length)
            flux[facets] = (q, slope_of(effect, (facets, medium, y), moment.middle, moment, length))
        if effect.of("boundary_temperature", facets):
            media[facets] = stage_media(effect, facets, y, moment, step)
    capacity, conductivity = (effect.factor(slot, moment.middle) for slot in ("capacity", "conductivity"))
    return Loads(moment, length, capacity, conductivity, flux, media)


def stage_media(effect: HeatEffects, facets: str, y: np.ndarray, moment: Moment, step: tuple[float, tuple[float, float]]) -> np.ndarray:
    """Change of the medium's temperature at the ends of both stages (2, n_np) K."""
    return np.stack([effect.medium_change(facets, y, moment.start + part * step[0], moment.first) for part in step[1]])


Facets = tuple[str, Number, np.ndarray]
"""Name of a facet set, temperature of its medium in K, and y (n_np,) of the nodes."""


def mean_flux(effect: HeatEffects, facets: Facets, theta: np.ndarray, moment: Moment, length: float) -> np.ndarray:
    """Mean of the outward flux at theta (..., n_np) over a step, mW/mm^2: lamps may be switched within it."""
    name, medium, y = facets
    flat = theta.reshape(-1)
    total, several, drifts = np.zeros_like(flat), len(flat) // len(y), bool(effect.of("boundary_temperature", name))
    surroundings, height = np.full(len(flat), medium), np.tile(y, several)
    for weight, part in INSTANTS:
        time = moment.start + part * length
        if drifts:
            surroundings = np.tile(medium + effect.medium_change(name, y, time, moment.first), several)
        total = total + weight * effect.flux(name, flat, time, surroundings, height)
    return total.reshape(theta.shape)


def slope_of(effect: HeatEffects, facets: Facets, theta: np.ndarray, moment: Moment, length: float) -> np.ndarray:
    """Derivative of `mean_flux` by theta, by complex step."""
    return np.asarray(mean_flux(effect, facets, theta + 1j * STEP, moment, length).imag / STEP)


def weighted_conduction(body: Body, conduction: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """K_f (n_slots,) of a conduction matrix whose rows sum to zero."""
    p = body.thermal
    out = 0.5 * (factor[p.row] + factor[p.column]) * conduction
    diagonal = p.row == p.column
    out[diagonal] -= 0.5 * multiply_symmetric(p.row, p.column, conduction, factor)[p.row[diagonal]]
    return np.asarray(out)


def weighted_capacity(body: Body, factor: np.ndarray) -> np.ndarray:
    """C_f (n_slots,), mm^3."""
    p = body.thermal
    return np.asarray(0.5 * (factor[p.row] + factor[p.column]) * body.capacity)


def add_slopes(body: Body, geometry: ThermalGeometry, loads: Loads, matrix: np.ndarray) -> None:
    """matrix (n_slots,) += the slopes of the fluxes, mW/K."""
    diagonal = body.thermal.row == body.thermal.column
    rows = body.thermal.row[diagonal]
    for name, (_, slope) in loads.flux.items():
        matrix[diagonal] += (geometry.film_area[name] * slope)[rows]


def inflow_of(body: Body, geometry: ThermalGeometry, coefficients: Mapping[str, float], loads: Loads) -> np.ndarray:
    """Nodal power (2, n_np) in mW that the loads bring in beside what their slopes take at theta; `coefficients` of films, mW/(mm^2 K)."""
    p = body.thermal
    out = np.zeros((2, body.mesh.n_nodes))
    for name, change in loads.media.items():
        for stage in (0, 1):
            out[stage] += coefficients[name] * multiply_symmetric(p.row, p.column, geometry.film[name], change[stage])
    for name in loads.flux:
        out -= geometry.film_area[name] * loads.flux_at(name, np.zeros(body.mesh.n_nodes))
    return out


def power_of(geometry: ThermalGeometry, coefficients: Mapping[str, float], loads: Loads, stage: int, theta: np.ndarray) -> dict[str, float]:
    """Power in mW that leaves through each facet set at theta beside that of its film with the medium as it was."""
    power = dict.fromkeys((*loads.media, *loads.flux), 0.0)
    for name, change in loads.media.items():
        power[name] -= coefficients[name] * float(geometry.film_area[name] @ change[stage])
    for name in loads.flux:
        power[name] += float(geometry.film_area[name] @ loads.flux_at(name, theta))
    return power
