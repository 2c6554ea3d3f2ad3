"""The measuring chain: what the instruments make of the fields of the specimen, effect by effect in the order of their slots.

    emission -> reflection -> optics -> sensor     temperatures
    camera                                         displacements

Effects at their neutral value are left out, so that a chain without effects is the field itself. Derivatives are made by complex step:
every effect is a formula of numpy that takes complex numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from thermofit.core.errors import DataError
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import Effect, effects
from thermofit.effects.scene import Scene

INFRARED = ("emission", "reflection", "optics", "sensor")
CAMERA = ("camera",)
_STEP = 1e-30
_NEIGHBOURS = 9


def chain(slots: tuple[str, ...], parameters: Parameters) -> tuple[Effect, ...]:
    """Effects of the slots that are switched on: a free Param, or an amplitude that is not neutral.

    An effect may have several amplitudes (shifts, rotation, scale): all Params without `scan`.
    """
    on = set(parameters.free)
    return tuple(e for e in effects(slots) if on & set(e.names) or e.is_on(parameters))


def seen(field: np.ndarray, scene: Scene, links: Sequence[Effect], parameters: Parameters) -> np.ndarray:
    """The field at the end of the chain `links`; temperatures (n_t, n_s), displacements (n_t, n_s, 2)."""
    for link in links:
        field = link.act(field, scene, *(parameters[name] for name in link.names))
    return field


def seen_along(
    field: np.ndarray, slope: np.ndarray, scene: Scene, links: Sequence[Effect], parameters: Parameters, name: str = ""
) -> np.ndarray:
    """Derivative of `seen` where the field changes at the rate `slope` (same shape) and the Param `name` at the rate one."""
    value = field + 1j * _STEP * slope
    for link in links:
        value = link.act(value, scene, *(parameters[n] + 1j * _STEP * (n == name) for n in link.names))
    return np.asarray(np.imag(value) / _STEP)


def gradients(xy: np.ndarray) -> tuple[csr_array, csr_array]:
    """Operators (n_s, n_s) that give the derivatives by x and y of a field at scattered points xy (n_s, 2) mm.

    At every point the plane of least squares through its nearest neighbours. DataError where the points lie on a line.
    """
    n = len(xy)
    if n == 1:
        return csr_array((1, 1)), csr_array((1, 1))
    count = min(_NEIGHBOURS, n)
    _, near = cKDTree(xy).query(xy, k=count)
    away = xy[near] - xy[:, None, :]
    moment = np.einsum("ski,skj->sij", away, away)
    size = np.trace(moment, axis1=1, axis2=2)
    flat = np.linalg.det(moment) < 1e-9 * size**2
    if flat.any():
        x, y = xy[int(np.argmax(flat))]
        raise DataError(f"observation points: those around ({x:.3g}, {y:.3g}) mm lie on a line; widen the evaluation window")
    weight = np.einsum("sij,skj->ski", np.linalg.inv(moment), away)
    row = np.repeat(np.arange(n), count)
    operators = []
    for axis in range(2):
        value = weight[:, :, axis]
        full = csr_array((value.ravel(), (row, near.ravel())), shape=(n, n))
        operators.append(csr_array(full - csr_array((value.sum(axis=1), (np.arange(n), np.arange(n))), shape=(n, n))))
    return operators[0], operators[1]


def scene_of(time: np.ndarray, xy: np.ndarray, u: np.ndarray, load: np.ndarray, theta_air: float) -> Scene:
    """Scene of points xy (n_s, 2) mm that move by u (n_t, n_s, 2) mm under a load (n_t,)."""
    by_x, by_y = gradients(xy)
    stretch = 1.0 + (by_y @ u[:, :, 1].T).T
    largest = float(np.abs(load).max())
    share = load / largest if largest > 0.0 else np.zeros_like(load)
    return Scene(time, xy + u, np.log(np.maximum(stretch, 1e-3)), share, by_x, by_y, theta_air)
