"""Heat sources among the effects: their power at the points of integration over a step, and the nodal heat that it makes.

A source that depends on place and time alone is the same at points above one another, through the thickness. It is asked once for each
of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermofit.body.body import Body
from thermofit.body.element.hex8 import ElementData
from thermofit.body.heat.effects import INSTANTS, Acting, HeatEffects, Moment
from thermofit.body.heat.equation import at_points
from thermofit.core.jit import kernel

Flow = tuple[np.ndarray, np.ndarray]
"""Lambda at the points at the start of a step, and its change in it, each (n_el, 8)."""
Instants = tuple[tuple[float, Flow, float], ...]
"""Weight, Lambda with its rate, each (n_el, 8), and time of the instants over which a mean of a step is taken."""


def instants(flow: Flow, moment: Moment, length: float) -> Instants:
    """Instants of a step in which Lambda grows evenly."""
    rate = flow[1] / length
    return tuple((weight, (flow[0] + part * flow[1], rate), moment.start + part * length) for weight, part in INSTANTS)


def of_state(sources: Sequence[Acting]) -> tuple[Acting, ...]:
    """Those of the sources that depend on more than place and time."""
    return tuple(e for e in sources if e.of_place is None)


def of_place(sources: Sequence[Acting]) -> tuple[Acting, ...]:
    """Those of the sources that depend on place and time alone."""
    return tuple(e for e in sources if e.of_place is not None)


def power_by_state(body: Body, sources: Sequence[Acting], theta: np.ndarray, when: Instants) -> np.ndarray:
    """Mean power (n_el, 8) in mW/mm^3 over the instants of a step of sources that depend on more than place and time; theta (n_el, 8) K."""
    total, (x, y) = np.zeros_like(theta), body.points
    for weight, (accumulated, rate), time in when:
        for e in sources:
            total = total + weight * e.act(theta, accumulated, rate, time, x, y, *e.numbers)
    return np.asarray(total)


def power_by_place(body: Body, sources: Sequence[Acting], when: Instants) -> np.ndarray:
    """Mean power (n_d,) in mW/mm^3 over the instants of a step of the sources that depend on place and time alone, at the points of the
    plane."""
    plane = body.plane
    total = np.zeros(len(plane.x))
    for weight, _, time in when:
        for e in sources:
            if e.of_place is not None:
                total = total + weight * e.of_place(time, plane.x, plane.y, plane.across, *e.numbers)
    return np.asarray(total)


def nodal_heat(body: Body, density: np.ndarray) -> np.ndarray:
    """Nodal heat int N_a density dV, (n_np, ...), of densities (n_el, 8, ...) at the points."""
    several = np.ascontiguousarray(density.reshape(*density.shape[:2], -1))
    out = np.zeros((body.mesh.n_nodes, several.shape[2]))
    _add_nodal_heat(body.data, several, out)
    return out.reshape(body.mesh.n_nodes, *density.shape[2:])


@kernel
def _add_nodal_heat(data: ElementData, density: np.ndarray, out: np.ndarray) -> None:
    """out (n_np, k) += int N_a density dV of densities (n_el, 8, k)."""
    for e in range(density.shape[0]):
        for q in range(8):
            for a in range(8):
                share, node = data.volume[e, q] * data.shape[q, a], data.hexes[e, a]
                for k in range(density.shape[2]):
                    out[node, k] += share * density[e, q, k]


def source_heat(body: Body, effect: HeatEffects | None, flow: Flow, moment: Moment | None, length: float) -> np.ndarray | None:
    """Nodal heat (n_np,) mJ that the sources set free in a step; None where there are none."""
    if effect is None or moment is None or not effect.of("heat_source"):
        return None
    sources, now = effect.of("heat_source"), instants(flow, moment, length)
    heat: np.ndarray = np.zeros(body.mesh.n_nodes)
    if felt := of_state(sources):
        heat += nodal_heat(body, length * power_by_state(body, felt, at_points(body.data, moment.middle), now))
    if still := of_place(sources):
        heat += body.plane.heat @ (length * power_by_place(body, still, now))
    return heat
