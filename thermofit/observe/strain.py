"""Channel strain (2.9): both sides by one scheme, the plane through the displacements of the points near a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from thermofit.core.errors import DataError
from thermofit.observe.comparison import Comparison, Weight, filled, functional_noise, of_stencil, weights
from thermofit.observe.observation import FieldObservation
from thermofit.observe.stencils import Stencil, planes

_DERIVATIVES = ("x,x", "x,y", "y,x", "y,y")
_STRAINS = ("xx", "yy", "xy")


@dataclass(frozen=True)
class StrainScheme:
    """Measure `technical` or `green-lagrange`, components xx, yy, xy, radius of the plane in mm (None: the next ring of points)."""

    measure: str = "technical"
    components: tuple[str, ...] = _STRAINS
    radius: float | None = None


def strains(observation: FieldObservation, scheme: StrainScheme, choice: Weight = "sigma") -> Comparison:
    """Comparison of in-plane strains (n_t, n_s, 3). DataError where no point has a plane."""
    if scheme.measure == "technical":
        return of_stencil(observation, planes(observation.xy, scheme.components, scheme.radius), "strain", choice)
    return _green_lagrange(observation, scheme, choice)


def _green_lagrange(observation: FieldObservation, scheme: StrainScheme, choice: Weight) -> Comparison:
    """E = (H + H^T + H^T H)/2 of the displacement gradient H: not linear, so that its derivative is taken at the prediction."""
    stencil = planes(observation.xy, _DERIVATIVES, scheme.radius)
    m = stencil.matrix.shape[0] // len(_DERIVATIVES)
    number = [_STRAINS.index(name) for name in scheme.components]
    shape = (len(observation.time), len(_DERIVATIVES), m)

    def gradients(field: np.ndarray) -> np.ndarray:
        return stencil.at(filled(observation, field)).reshape(shape)

    seen = gradients(observation.value)
    whole: np.ndarray = np.all(stencil.measured(observation.mask).reshape(shape), axis=1)
    time, kind, point = np.nonzero(np.repeat(whole[:, None], len(number), axis=1))
    if not len(time):
        raise DataError("strain: no point has measured neighbours within the window; widen it, or stages.<stage>.strain.radius")
    take = (time, kind, point)
    value = _measure(seen)[:, number][take]
    sigma, spread = _tangent_noise(observation, stencil, seen, number, take)
    root = np.sqrt(w := weights(choice, value, sigma, kind))

    def residual(error: np.ndarray) -> np.ndarray:
        return root * (_measure(seen + gradients(error))[:, number][take] - value)

    def along(error: np.ndarray, slope: np.ndarray) -> np.ndarray:
        return root * _measure_slope(seen + gradients(error), gradients(slope))[:, number][take]

    place = np.stack([time, stencil.point[:m][point], np.asarray(number)[kind] % 2], axis=1)
    return Comparison("strain", residual, lambda v: spread @ (spread.T @ v), place, sigma, w, "1", along)


def _measure(h: np.ndarray) -> np.ndarray:
    """E_xx, E_yy, E_xy (n_t, 3, m) of H_xx, H_xy, H_yx, H_yy (n_t, 4, m)."""
    xx, xy, yx, yy = (h[:, k] for k in range(4))
    return np.stack([xx + 0.5 * (xx**2 + yx**2), yy + 0.5 * (xy**2 + yy**2), 0.5 * (xy + yx + xx * xy + yx * yy)], axis=1)


def _measure_slope(h: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Derivative of `_measure` at h in the direction d."""
    xx, xy, yx, yy = (h[:, k] for k in range(4))
    a, b, c, e = (d[:, k] for k in range(4))
    return np.stack(
        [a + xx * a + yx * c, e + xy * b + yy * e, 0.5 * (b + c + a * xy + xx * b + c * yy + yx * e)],
        axis=1,
    )


def _tangent_noise(
    observation: FieldObservation, stencil: Stencil, seen: np.ndarray, number: list[int], take: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, csr_array]:
    """Sigma (n,) of the strains at the observed state, and the map from unit noise of the displacements to unit noise of the strains."""
    time, kind, point = take
    m = seen.shape[2]
    rows: csr_array | None = None
    for k in range(4):
        unit = np.zeros_like(seen)
        unit[:, k] = 1.0
        share = _measure_slope(seen, unit)[:, number][time, kind, point]
        part = stencil.matrix[k * m + point] * share[:, None]
        rows = part if rows is None else rows + part
    return functional_noise(observation, csr_array(rows), time)
