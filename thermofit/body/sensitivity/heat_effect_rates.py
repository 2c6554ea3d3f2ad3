"""Rates of what heat effects do in a step, along many directions at once (direct differentiation).

With a rate written x', theta_m' that of the temperature about which the step is linear, and p a number of an effect, the linearised flux
changes at fixed theta by

    [q + s (theta - theta_m)]' = q_p + (s_theta theta_m' + s_p) (theta - theta_m),     s = dq/dtheta(theta_m),

factors by f' = f_theta theta_m' + f_p, and media by their change_p. First derivatives are made by complex step; those of the slope s, by a
central difference of complex steps in theta. A dormant effect takes part through its numbers alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from thermofit.body.body import Body, ThermalGeometry, about_middle
from thermofit.body.element.hex8 import ElementData
from thermofit.body.heat.effects import Acting, HeatEffects, Media, Moment, mean_flux, slope_of, stage_media
from thermofit.body.heat.equation import at_points
from thermofit.body.heat.sources import Flow, Instants, instants, nodal_heat, of_place, of_state, power_by_place, power_by_state
from thermofit.body.sensitivity.lanes import multiply_directions
from thermofit.body.sensitivity.shape_rates import add_conduction_rates, add_film_rates
from thermofit.body.solve.linear import multiply_symmetric
from thermofit.core.errors import NumericsError
from thermofit.law.page_rates import STEP, padded

_WARMER = 1e-3
"""K; step of the difference of slopes by theta: a flux may bend within a tenth of a kelvin, and slopes are exact to rounding."""
_AROUND = np.array([0.0, _WARMER, -_WARMER])
_FACTORS = ("capacity", "conductivity")
LOADS = (*_FACTORS, "surface_flux", "boundary_temperature")
"""Slots of effects that change the matrices of a step or what its films and fluxes bring."""
Moved = tuple[HeatEffects | None, ...]
"""Per direction the effects with their numbers moved by i h; None where the direction moves none of them."""


def felt(effect: HeatEffects | None) -> HeatEffects | None:
    """The effects, if any of their numbers is moved."""
    if effect is None:
        return None
    own = any(np.imag(x) != 0.0 for acting in effect.by_slot.values() for e in acting for x in e.numbers)
    reference = np.imag(effect.theta_ref) != 0.0 and any(effect.of(slot) for slot in _FACTORS)
    return effect if own or reference else None


@dataclass(frozen=True)
class Along:
    """What the rates are taken of and along: effects that are on, films with the rates (m,) of their media, and the moved effects."""

    effect: HeatEffects | None
    films: Media
    media: Mapping[str, np.ndarray]
    moved: Moved

    @property
    def nothing(self) -> bool:
        """True where no effect is on and none is asked for."""
        return self.effect is None and not any(self.moved)

    @property
    def m(self) -> int:
        """Number of directions, filled up."""
        return len(next(iter(self.media.values())))

    def felt_by(self, slots: Sequence[str]) -> np.ndarray:
        """Directions (k,) that effects of some slots act on: all where an effect is on, for it feels the temperature."""
        if self.effect is not None:
            return np.arange(self.m)
        return np.array([k for k, e in enumerate(self.moved) if e is not None and any(e.of(slot) for slot in slots)], dtype=int)

    def only(self, columns: np.ndarray) -> Along:
        """The same along some of the directions, filled up."""
        if len(columns) == self.m:
            return self
        media = {name: np.zeros(padded(len(columns))) for name in self.media}
        for name, rates in media.items():
            rates[: len(columns)] = self.media[name][columns]
        return replace(self, media=media, moved=tuple(self.moved[k] for k in columns))

    def directions(self, slot: str, facets: str = "") -> list[tuple[int, HeatEffects, complex]]:
        """Directions that effects of a slot feel: column, effects, and the medium of the facet set, moved."""
        found = []
        for column, moved in enumerate(self.moved):
            warmer = self.effect is not None and slot == "surface_flux" and self.media[facets][column] != 0.0
            effect = moved if moved is not None else self.effect if warmer else None
            if effect is not None and slot in effect.by_slot and effect.of(slot, facets):
                medium = complex(self.films[facets][1], STEP * self.media[facets][column]) if facets else 0.0j
                found.append((column, effect, medium))
        return found


@dataclass(frozen=True)
class LoadRates:
    """Rates along m directions: of the factors (n_np, m); per facet set q_p and s' (n_np, m); of the media (2, n_np, m)."""

    factors: Mapping[str, np.ndarray] = field(default_factory=dict)
    flux: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    media: Mapping[str, np.ndarray] = field(default_factory=dict)


Timing = tuple[Moment, float, tuple[float, float]]
"""Where a step stands, its length in s, and the parts of it at which its two stages end."""


def load_rates(body: Body, along: Along, when: Timing, middle_rates: np.ndarray | None) -> LoadRates:
    """LoadRates of a step; middle_rates (n_np, m) are those of theta_m, None where it does not move."""
    factors = {slot: f for slot in _FACTORS if (f := _factor_rates(body, along, slot, when[0].middle, middle_rates)) is not None}
    flux, media = {}, {}
    for name in along.films:
        found = _flux_rates(body, along, name, when, middle_rates)
        if found is not None:
            flux[name] = found
        changes = along.directions("boundary_temperature", name)
        if changes:
            media[name] = np.zeros((2, body.mesh.n_nodes, along.m))
            for column, effect, _ in changes:
                change = stage_media(effect, name, about_middle(body)[1], when[0], when[1:])
                media[name][:, :, column] = change.imag / STEP
    return LoadRates(factors, flux, media)


def _factor_rates(body: Body, along: Along, slot: str, theta: np.ndarray, middle_rates: np.ndarray | None) -> np.ndarray | None:
    """f' (n_np, m) of a slot; None where there is none."""
    moved, out = along.directions(slot), np.zeros((body.mesh.n_nodes, along.m))
    by_theta = None if along.effect is None else along.effect.factor(slot, theta + 1j * STEP)
    if by_theta is not None and middle_rates is not None:
        out += (by_theta.imag / STEP)[:, None] * middle_rates
    for column, effect, _ in moved:
        factor = effect.factor(slot, theta)
        if factor is not None:
            out[:, column] += factor.imag / STEP
    return out if moved or by_theta is not None else None


def _flux_rates(body: Body, along: Along, name: str, when: Timing, middle_rates: np.ndarray | None) -> tuple[np.ndarray, np.ndarray] | None:
    """q_p and s' (n_np, m) on a facet set; None where nothing acts."""
    moment, length, _ = when
    theta, y = moment.middle, about_middle(body)[1]
    moved, here = along.directions("surface_flux", name), along.effect
    on = body.films[name].nodes
    at_three, y_on = theta[on] + _AROUND[:, None], y[on]
    by_number, slope = np.zeros((2, body.mesh.n_nodes, along.m))
    acts = here is not None and bool(here.of("surface_flux", name))
    if here is not None and acts and middle_rates is not None:
        at = (name, along.films[name][1], y)
        curvature = slope_of(here, at, theta + _WARMER, moment, length) - slope_of(here, at, theta - _WARMER, moment, length)
        slope += (curvature / (2.0 * _WARMER))[:, None] * middle_rates
    for column, effect, medium in moved:
        flux = mean_flux(effect, (name, medium, y_on), at_three, moment, length).imag / STEP
        by_number[on, column] = flux[0]
        slope[on, column] += (flux[1] - flux[2]) / (2.0 * _WARMER)
    return (by_number, slope) if moved or acts else None


def capacity_supply(body: Body, factor: np.ndarray, y: np.ndarray) -> np.ndarray:
    """C_f' y (n_np, m), mm^3 K, for the rates (n_np, m) of the factor and y (n_np,)."""
    p = body.thermal
    first = factor * multiply_symmetric(p.row, p.column, body.capacity, y)[:, None]
    return np.asarray(0.5 * (first + multiply_some(body, body.capacity, factor * y[:, None])))


def conduction_supply(body: Body, conduction: np.ndarray, factor: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """K_f' theta (n_np, m), mm K, for the rates (n_np, m) of the factor; `conduction` (n_slots,) without factor."""
    p, t = body.thermal, theta[:, None]
    out = multiply_some(body, conduction, factor * t)
    out += factor * multiply_symmetric(p.row, p.column, conduction, theta)[:, None]
    out -= t * multiply_some(body, conduction, factor)
    return np.asarray(0.5 * out)


def multiply_some(body: Body, data: np.ndarray, x: np.ndarray) -> np.ndarray:
    """y (n_np, m) = K x for a symmetric matrix with the non-zeros `data` (n_slots,); columns of x that vanish cost nothing."""
    p, used = body.thermal, np.flatnonzero(np.any(x != 0.0, axis=0))
    if padded(len(used)) == x.shape[1]:
        return multiply_directions(p.row, p.column, data, np.ascontiguousarray(x))
    y = np.zeros(x.shape)
    if len(used) == 1:
        y[:, used[0]] = multiply_symmetric(p.row, p.column, data, np.ascontiguousarray(x[:, used[0]]))
    elif len(used) > 1:
        some = np.zeros((len(x), padded(len(used))))
        some[:, : len(used)] = x[:, used]
        y[:, used] = multiply_directions(p.row, p.column, data, some)[:, : len(used)]
    return y


def surface_loss(body: Body, geometry: ThermalGeometry, films: Media, rates: LoadRates, stage: int, excess: np.ndarray) -> np.ndarray:
    """Power (n_np, m) in mW by which the outflow at fixed theta rises; excess = theta - theta_m (n_np,), `films` in mW/(mm^2 K)."""
    out = np.zeros((body.mesh.n_nodes, 1))
    for name, (q, slope) in rates.flux.items():
        out = out + geometry.film_area[name][:, None] * (q + slope * excess[:, None])
    for name, change in rates.media.items():
        out = out - films[name][0] * multiply_some(body, geometry.film[name], change[stage])
    return out


def moving_conduction(
    data: ElementData, motion: tuple[np.ndarray, np.ndarray], theta: np.ndarray, weights: tuple[float, np.ndarray], out: np.ndarray
) -> None:
    """out (2, n_np, m) += kappa (K_f)' theta by the motion (u, u') for both theta (2, n_np); weights = (kappa, factor f (n_np,))."""
    kappa, factor = weights
    scaled = np.ascontiguousarray(np.broadcast_to(factor, theta.shape))
    plain, constant = np.zeros_like(out), np.zeros_like(out)
    add_conduction_rates(data, *motion, np.ascontiguousarray(theta * factor), 0.5 * kappa, out)
    add_conduction_rates(data, *motion, theta, 0.5 * kappa, plain)
    add_conduction_rates(data, *motion, scaled, 0.5 * kappa, constant)
    out += factor[None, :, None] * plain - theta[:, :, None] * constant


def moving_flux(body: Body, name: str, motion: tuple[np.ndarray, np.ndarray], flux: np.ndarray, share: float, out: np.ndarray) -> None:
    """out (2, n_np, m) += share (int N_a da)' q_a by the motion (u, u') for the outward fluxes q (2, n_np) of both stages."""
    area = np.zeros_like(out)
    add_film_rates(body.films[name], body.mesh.nodes + motion[0], motion[1], np.ones_like(flux), share, area)
    out += flux[:, :, None] * area


def source_rates(
    body: Body, along: Along, flow: Flow, flow_rates: Flow | None, when: tuple[Moment, float], middle_rates: np.ndarray
) -> np.ndarray | None:
    """Rates (n_np, m) in mJ of `source_heat`; flow_rates (n_el, 8, m) are those of Lambda at the start and of its change, None where the
    mechanics stays as it is. None where there are no sources."""
    moment, length = when
    felt = () if along.effect is None else of_state(along.effect.of("heat_source"))
    moved = [(column, _moved(there.of("heat_source"))) for column, there, _ in along.directions("heat_source")]
    by_place, by_state = ([(column, mine) for column, sources in moved if (mine := part(sources))] for part in (of_place, of_state))
    if not felt and not by_place and not by_state:
        return None
    now, out = instants(flow, moment, length), np.zeros((body.mesh.n_nodes, along.m))
    if by_place:
        power = np.stack([power_by_place(body, mine, now).imag / STEP for _, mine in by_place], axis=1)
        out[:, [column for column, _ in by_place]] += body.plane.heat @ (length * power)
    if not felt and not by_state:
        return out
    theta = at_points(body.data, moment.middle)
    if felt:
        density = _by_state(body, felt, theta + 1j * STEP, now) * at_points(body.data, middle_rates)
        if flow_rates is not None:
            earlier, faster = (flow[0] + 1j * STEP, flow[1]), (flow[0], flow[1] + 1j * STEP)
            density += _by_state(body, felt, theta, instants(earlier, moment, length)) * flow_rates[0]
            density += _by_state(body, felt, theta, instants(faster, moment, length)) * flow_rates[1]
        out += nodal_heat(body, length * density)
    if by_state:
        own = np.concatenate([_by_state(body, mine, theta, now) for _, mine in by_state], axis=2)
        if np.any(own):
            out[:, [column for column, _ in by_state]] += nodal_heat(body, length * own)
    return out


def _moved(sources: Sequence[Acting]) -> tuple[Acting, ...]:
    """Those of the sources with a number that is moved by i h: the power of the others has no imaginary part."""
    return tuple(e for e in sources if any(np.imag(x) != 0.0 for x in e.numbers))


def _by_state(body: Body, sources: Sequence[Acting], theta: np.ndarray, when: Instants) -> np.ndarray:
    """Derivative (n_el, 8, 1) of the power of sources along what is moved by i h."""
    return np.asarray(power_by_state(body, sources, theta, when).imag[:, :, None] / STEP)


def initial_rates(body: Body, along: Along) -> np.ndarray:
    """Rates (n_np, m) of the excess over the steady temperature."""
    out = np.zeros((body.mesh.n_nodes, along.m))
    for column, effect, _ in along.directions("initial_temperature"):
        out[:, column] = effect.initial(*about_middle(body)).imag / STEP
    return out


def converged(change: np.ndarray, value: np.ndarray) -> bool:
    """True where an iterate of rates (n_np, m) stands still in every column."""
    return bool(np.all(np.abs(change).max(axis=0) <= 1e-10 * np.abs(value).max(axis=0)))


def needed(middle_rates: np.ndarray | None) -> np.ndarray:
    """The rates of theta_m; NumericsError where a caller did not give them although the step is linear about it."""
    if middle_rates is None:
        raise NumericsError("sensitivities: the heat equation is linear about a temperature whose rates were not given")
    return middle_rates
